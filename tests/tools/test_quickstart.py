"""The front door, with the simulator and the painters replaced; and the line that it ends with."""

import io
import json
import shlex
import subprocess
from contextlib import nullcontext, redirect_stdout
from pathlib import Path

import optuna
import pytest

import taichi_nmm
from storage.databases.studies import only_run, read_studies
from taichi_nmm.parameters import GAIN_NAMES
from tests.study import fake_walker
from tests.tools.running import ROOT, run_tool

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("quickstart")


@pytest.fixture(scope="module")
def lines(folder):
    """What it says, in the root of the repository, run twice: then everything is there."""
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said):
        patch.chdir(ROOT)
        patch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
        # First where a name is imported to: else it would keep the fake.
        strips = "experiment.artifacts.write_strip", "pictures.write_strip"
        for name in (*strips, "pictures.write_gait_cycle"):
            patch.setattr(
                f"study.{name}", lambda path, *_: path.write_bytes(b"drawn") and path
            )
        for _ in range(2):
            assert run_tool(patch, "quickstart", "--out", folder) == 0
    return said.getvalue().splitlines()


def test_it_ends_with_what_was_found_and_where(folder, lines):
    assert lines[-2].endswith(f" explore {folder / 'store'}")
    assert lines[-1].endswith(f"dashboard --storage sqlite:///{folder / 'studies.db'}")
    for place, arm in ((-8, "worlds"), (-7, "dog"), (-6, "random")):
        assert lines[place].startswith(f"rough8/{arm}/run-000: ")
    with read_studies(f"sqlite:///{folder / 'studies.db'}") as storage:
        found = optuna.get_all_study_summaries(storage)
        assert [study.n_trials for study in found] == [30, 30, 30]  # none was run again
        costs = {
            study.study_name.split("/")[1]: study.best_trial.value for study in found
        }
    best = folder / f"{min(costs, key=lambda arm: costs[arm] or 0.0)}-run-000-best.json"
    assert tuple(json.loads(best.read_text())) == GAIN_NAMES and str(best) in lines[-5]
    drawn = {str(path.relative_to(folder)) for path in folder.glob("*/*.png")}
    kinds = ("strip", "gait_cycle")
    assert drawn == {
        f"{name}/{kind}.png" for name in ("found", "reference") for kind in kinds
    }


def test_the_line_for_a_film_makes_a_film(lines, tmp_path):
    """The very line, as a user pastes it; only shorter, and to another folder."""
    title, _, command = lines[-3].partition(": ")
    assert title == "A film of it"
    short = (
        "--duration",
        "2",
        "--movie-seconds",
        "0.3",
        "--out",
        str(tmp_path),
        "--json",
    )
    done = subprocess.run(
        f"{command} {shlex.join(short)}",
        shell=True,
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert Path(json.loads(done.stdout)["pictures"]["movie"]).stat().st_size > 1000


def test_a_store_of_something_else(tmp_path, tool, simulator):
    fake_walker.write_plain_store(tmp_path / "store", samples=20)
    assert tool("quickstart", "--out", tmp_path) == 2
    assert tool.err.startswith("error: samples: 4000 ") and tool.err.count("\n") == 1


@pytest.mark.parametrize("field", ["study", "storage"])
def test_studies_that_cannot_go_on_are_refused_before_the_store_is_made(
    field, database, tmp_path, tool, simulator
):
    """Another process runs one of them; the database is another program's."""
    database.execute("CREATE TABLE studies (title TEXT)")
    taken = only_run(f"sqlite:///{tmp_path / 'studies.db'}", "rough8/dog/run-000")
    with taken if field == "study" else nullcontext():
        tool.refuses(f"{field}: ", "quickstart", "--out", tmp_path)
    assert not (tmp_path / "store").exists()
