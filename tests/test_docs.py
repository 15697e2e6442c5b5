"""Documents agree with the code: tables, commands, links; and every example on them runs."""

import re
import runpy
from importlib import import_module
from pathlib import Path

import numpy as np
import optuna
import pytest
from PIL import Image

from storage import open_store
from taichi_nmm.parameters import ASYMMETRIES, DEVICE, FIXED, GAINS
from tests.processes import printed
from tests.study import fake_walker
from tests.tools.running import ROOT

DOCS = ROOT / "docs"
README, CONTRIBUTING = ROOT / "README.md", ROOT / "CONTRIBUTING.md"
PAGES = [README, CONTRIBUTING, ROOT / "CHANGELOG.md", *sorted(DOCS.rglob("*.md"))]
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]*)(?:#([^)\s]*))?\)")
NUMBER = r"(?:[-<>\d.%+*() ]|of|to)*\d(?:[-<>\d.%+*() ]|of|to)*"
SEVERAL_NUMBERS = re.compile(rf" *{NUMBER}(?:(?:[;,]| :) {NUMBER})+")
PROGRAM = re.compile(r"python -m (tests\.[\w.]++)(?!` of version)")
pages = pytest.mark.parametrize(
    "page", PAGES, ids=lambda page: str(page.relative_to(ROOT))
)


def code_blocks(page, language="python"):
    """The code of a page in one language, block by block."""
    return re.findall(
        rf"^```{language}\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE
    )


def prose(page):
    """A page without its code."""
    return re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)


def anchors(page):
    """Anchors of headings as GitHub makes them: lower case, words joined by hyphens."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", title).lower().replace(" ", "-") for title in titles
    }


def run_in(folder, *words):
    """What Python prints on these words in a folder, where it finds our packages."""
    return printed(*words, cwd=folder)


@pytest.fixture
def example(tmp_path):
    """The output of a page's code as a file of its own, in a process of its own."""

    def run(page, block=0, change=("", "")):
        code = code_blocks(page)[block]
        assert change[0] in code
        (tmp_path / "example.py").write_text(code.replace(*change))
        return run_in(tmp_path, "example.py")

    return run


@pytest.mark.parametrize("parameter", [*GAINS, *FIXED, *DEVICE], ids=lambda p: p.name)
def test_parameter_table_is_that_of_the_code(parameter):
    p = parameter
    bounds = f"{p.low:.4g} | {p.high:.4g} | {p.default:.4g}"
    row = f"| `{p.name}` | {p.unit} | {bounds} | {p.meaning} | {p.source} |"
    assert row in (DOCS / "walker.md").read_text()


def test_the_bounds_of_asymmetries_are_those_of_the_code():
    page = (DOCS / "walker.md").read_text()
    for gain, asymmetry in zip(GAINS, ASYMMETRIES, strict=True):
        assert asymmetry.low == -asymmetry.high and asymmetry.default == 0.0
        named = f"{asymmetry.high:.3f} of `{gain.name}`"
        assert named in page or (asymmetry.high == 0.5 and gain.low == 0.0)


def test_the_page_of_commands_is_made_from_their_help():
    """`python docs/write_commands.py` writes it anew."""
    writer = runpy.run_path(str(DOCS / "write_commands.py"))
    assert (DOCS / "commands.md").read_text() == writer["page"]()


@pytest.mark.parametrize(
    "tool", sorted(path.name for path in (ROOT / "tools").glob("*.py"))
)
def test_every_tool_is_in_a_document(tool):
    assert any(tool in page.read_text() for page in PAGES)


@pytest.mark.parametrize(
    "module", sorted(set(PROGRAM.findall("".join(map(Path.read_text, PAGES)))))
)
def test_a_program_of_the_tests_that_a_document_names_can_be_run(module):
    assert f"python -m {module}" in (import_module(module).__doc__ or "")


@pages
def test_links_lead_somewhere_and_a_cell_of_a_table_has_one_number(page):
    wrong = []
    for file, anchor in LINK.findall(prose(page)):
        target = page.parent / file if file else page
        made_later = "api" in target.parts  # with the site, which test_site.py looks at
        if "://" not in file and not (
            target.exists() and (not anchor or made_later or anchor in anchors(target))
        ):
            wrong.append(f"{file}#{anchor}")
    assert wrong == []
    rows = re.findall(r"^\|(.*)\|$", prose(page), re.MULTILINE)
    cells = [cell.strip() for row in rows for cell in row.split("|")]
    assert [cell for cell in cells if SEVERAL_NUMBERS.fullmatch(cell)] == []


def test_the_readme_is_short_and_moves():
    text = README.read_text()
    assert len(text.splitlines()) <= 130
    (file,) = re.findall(r"\]\((\S+\.gif)\)", text)
    assert (ROOT / file).stat().st_size < 1e6
    with Image.open(ROOT / file) as picture:
        assert getattr(picture, "n_frames", 1) > 50


@pytest.mark.slow
def test_walks_of_the_readme_and_the_start_page_print_what_is_promised(example):
    said, page = example(README, 1), DOCS / "index.md"
    assert "completed" in said and "(10000, 6)" in said
    assert example(page) == code_blocks(page, "text")[0]


@pytest.mark.slow
def test_the_oven_of_the_readme_does_what_is_said_of_it():
    names = {}
    exec(code_blocks(README)[0], names)
    costs = [trial.value for trial in names["study"].trials]
    best = names["cost"](names["kp"], names["ki"], strength=0.016, lag_s=25.0).min()
    assert min(costs) == pytest.approx(best)
    said = re.findall(r"it costs ([\d.]+)\.\s", README.read_text())
    assert said == [f"{costs[0]:.3f}", f"{best:.3f}"]


@pytest.mark.slow
def test_the_example_of_stores_runs_on_one(tmp_path, example):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "store").symlink_to(ROOT / "tests" / "assets" / "store-v1")
    fake_walker.write_store(tmp_path / "out" / "store-worlds")
    example(DOCS / "store.md")


@pytest.mark.slow
def test_the_samplers_complete_example_runs_in_an_empty_folder(example):
    texts = example(DOCS / "sampler.md"), code_blocks(DOCS / "sampler.md", "text")[0]
    best, promised = (
        float(re.findall(r"best of 20: (\S+)", text)[0]) for text in texts
    )
    assert best == pytest.approx(promised, abs=0.01)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::optuna.exceptions.ExperimentalWarning")
def test_all_examples_of_the_sampler_run_in_their_order(tmp_path, monkeypatch, capsys):
    """Each continues from those before, so they share one namespace."""
    pages = [DOCS / "sampler.md", DOCS / "sampler-reference.md"]
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "__main__"}
    taught, listed = map(code_blocks, pages)
    # the last that is taught is a program to run again
    blocks = [*taught, taught[-1], *listed]
    for number, code in enumerate(blocks):
        exec(compile(code, f"the sampler's pages, block {number}", "exec"), names)
    said = capsys.readouterr().out
    _, *shown = [text for page in pages for text in code_blocks(page, "text")]
    assert len(shown) == 8 and all(text in said for text in shown)
    oven = optuna.load_study(study_name="oven", storage="sqlite:///oven.db")
    rows = [trial.user_attrs["row"] for trial in oven.trials]
    assert len(set(rows)) == len(rows) == 10  # stopped after five, then continued


@pytest.mark.slow
def test_the_page_of_own_simulators_runs_in_an_empty_folder(tmp_path):
    page = DOCS / "own-simulator.md"
    names = ("my_robot.py", "trials.py", "my_cart.py")
    for name, text in zip(names, code_blocks(page), strict=True):
        (tmp_path / name).write_text(text)
    for name, text in zip(
        ("pole.toml", "robots.toml"), code_blocks(page, "toml"), strict=True
    ):
        (tmp_path / name).write_text(text)
    few = "-m taichi_nmm precompute --config pole.toml --samples 16 --out out/few"
    for line in ("my_cart.py", f"{few} --workers 1", "my_robot.py", "trials.py"):
        said = run_in(tmp_path, *line.split())
    assert said == code_blocks(page, "text")[0]
    compared = (
        "-m taichi_nmm compare --config robots.toml --runs 1 --trials 2 --workers 1"
    )
    assert "\nworlds  " in run_in(tmp_path, *compared.split())


@pytest.mark.slow
def test_the_leg_of_the_page_of_robots_fills_a_store(tmp_path):
    page = DOCS / "robots.md"
    (tmp_path / "my_leg.py").write_text(code_blocks(page)[0])
    (tmp_path / "leg.xml").write_text(code_blocks(page, "xml")[0])
    run_in(tmp_path, "my_leg.py")
    lasted = open_store(tmp_path / "out" / "leg").outcomes(
        "bodies", "survived_fraction"
    )
    assert lasted.shape == (64, 8) and np.nanmin(lasted) < 1.0 == np.nanmax(lasted)


@pytest.mark.slow
@pytest.mark.parametrize(
    "duration_s", [10, pytest.param(100, marks=pytest.mark.campaign)]
)
def test_the_body_of_the_controllers_page_walks(example, duration_s):
    page = DOCS / "controller.md"
    said = example(page, change=("data.time < 100.0", f"data.time < {duration_s}.0"))
    walked, distance, speed = map(float, re.findall(r"[\d.]+", said))
    assert walked == duration_s and 1.1 < speed < 1.5
    assert abs(distance - duration_s * speed) < 0.02 * distance
    shown = map(float, re.findall(r"[\d.]+", code_blocks(page, "text")[0]))
    assert next(shown) == 100.0 and list(shown) == pytest.approx(
        [100 * speed, speed], rel=0.05
    )
