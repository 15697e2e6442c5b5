"""Time the explorer as a person meets it: in a headless Chromium, on a store.

    python tools/time_explorer.py out/store

prints a Markdown table: from the command to points on the screen, then medians of 20 of a brush, of
a slider's new animation and of a click that walks, and the memory of the server's processes. Each
ends when the browser has drawn. It needs Chromium and the extra `test`. Exit codes: 0, 2 bad input.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import guarded_imports, run_command

with guarded_imports():
    from storage.store import open_store
    from study.options import Options
    from tests.browser import opened_page
    from tests.study.explore.serving import explorer_process

TIMES = 20
MODEL = "Bokeh.documents[0].get_model_by_name"
DRAWN = "await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
# Milliseconds from an act to the picture after it; `seen` counts what was computed.
TIMED = f"""async ([act, seen]) => {{
    const before = eval(seen), began = performance.now()
    eval(act)
    while (eval(seen) === before) await new Promise((done) => setTimeout(done, 1))
    {DRAWN}
    return performance.now() - began
}}"""


def main() -> None:
    options = parse()
    open_store(options.store)
    with opened_page(1500, 1250) as page:
        measure(page, options.store)


def measure(page: Any, store: Path) -> None:
    began_s = time.perf_counter()
    with explorer_process(store) as (process, address):
        page.goto(address)
        page.wait_for_function("window.store_view?.refreshed > 0")
        page.evaluate(f"async () => {{ {DRAWN} }}")
        first_s = time.perf_counter() - began_s
        page.wait_for_function("window.walk_player?.shown > 0")
        rows = page.evaluate("window.store_view.inside.length")
        found = {
            "a brush": timed(page, brush, "window.store_view.refreshed"),
            "a slider's new animation": timed(page, slide, "window.walk_player.shown"),
            "a click to walking": timed(page, click, "window.walk_player.shown"),
        }
        memory = sum(map(private_bytes, family(process.pid)))
        page.goto("about:blank")
    print(f"{rows:,} rows, medians of {TIMES}\n\n| what | measured |\n|---|--:|")
    print(f"| from the command to points on the screen | {first_s:.1f} s |")
    for what, (middle, most) in found.items():
        print(f"| {what} | {middle:.0f} ms, at most {most:.0f} |")
    print(f"| memory of the server's processes | {memory / 2**20:.0f} MiB |")


def brush(turn: int) -> str:
    return f"{MODEL}('selection').value = 'mean_speed_mps {0.2 + 0.03 * turn}..1.4'"


def slide(turn: int) -> str:
    return f"{MODEL}('gain-K_SOL').value = {8.0 + 0.3 * turn}"


def click(turn: int) -> str:
    return f"{MODEL}('row').value = {100 * turn + 1}"


def timed(page: Any, act: Callable[[int], str], seen: str) -> tuple[float, float]:
    """Median and most of milliseconds; the first turn, which compiles scripts, counts as well."""
    times = [page.evaluate(TIMED, [act(turn), seen]) for turn in range(TIMES)]
    return statistics.median(times), max(times)


def family(pid: int) -> list[int]:
    """A process and its children."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    threads = [path.name for path in Path(f"/proc/{pid}/task").iterdir()]
    for thread in threads:
        children += Path(f"/proc/{pid}/task/{thread}/children").read_text().split()
    return [pid, *(each for child in set(children) for each in family(int(child)))]


def private_bytes(pid: int) -> int:
    """Of a process's memory, what it shares counted in part (Linux's PSS)."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) << 10 for line in lines if line.startswith("Pss:"))


def parse() -> argparse.Namespace:
    parser = Options(__file__)
    parser.add_argument("store", type=Path, metavar="DIR", help="of a store")
    return parser.parse_args()


if __name__ == "__main__":
    run_command(main)
