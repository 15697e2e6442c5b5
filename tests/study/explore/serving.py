"""The explorer as a process, and hands on its page."""

from contextlib import contextmanager

from tests.processes import ROOT, serving

WALKS = "window.walk_player?.shown"


@contextmanager
def explorer(folder, *words, errors=None):
    """The address of its page; `words` are options, `errors` takes what it prints of errors."""
    command = ("-m", "taichi_nmm", "explore", folder, "--port", 0, "--no-browser")
    repairs = ("--out", folder.parent / "repairs")
    with serving(*command, *repairs, *words, stderr=errors, cwd=ROOT) as said:
        yield said.readline().split()[1]


@contextmanager
def opened(page, folder, *words):
    """The address of a page whose first gait walks, and which is left before its server ends."""
    with explorer(folder, *words) as address:
        page.goto(address)
        page.wait_for_function(f"window.store_view?.refreshed > 0 && {WALKS} > 0")
        yield address
        page.goto("about:blank")


def change(page, name, attribute, value):
    """What a hand on the model does."""
    page.evaluate(
        "([name, attribute, value]) => { named(name)[attribute] = value }",
        [name, attribute, value],
    )


def walks(page, act):
    """Do something, and wait until another walk is seen."""
    seen = page.evaluate(WALKS)
    act()
    page.wait_for_function(f"{WALKS} > {seen}")


def show_row(page, row):
    """Let a row walk."""
    walks(page, lambda: change(page, "row", "value", row))
