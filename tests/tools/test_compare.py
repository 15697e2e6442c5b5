"""taichi-nmm compare as its users meet it: output, exit codes, kill -9, Ctrl-C."""

import json
import os
import signal
from contextlib import suppress
from pathlib import Path

import optuna
import pyarrow.parquet as pq
import pytest

from study.experiment import compare
from study.experiment.experiment import store_digest
from tests.processes import children, until
from tests.study import fake_walker
from tests.tools.conftest import Command
from tests.tools.running import INTERRUPTED, finish, start


class Comparison(Command):
    """The command in a folder of its own, in this process or in another."""

    def start(self, **changes):
        """The command in a process of its own, a tenth of a second a round."""
        return start(*self.words(**changes), trial_s=0.1, stretch=2)

    def rows(self):
        """Finished trials on the disk."""
        files = (self.out / "arms").glob("*.parquet")
        return sum(pq.read_metadata(file).num_rows for file in files)

    def wait_for_more(self, process):
        """Until the process has written a stretch."""
        before = self.rows()
        until(lambda: process.poll() is not None or self.rows() != before, 60.0)
        assert self.rows() != before, f"ended: {process.communicate()[1]}"


@pytest.fixture
def command(tmp_path, tool, simulator):
    config = fake_walker.write_config(tmp_path)
    return Comparison(tool, tmp_path, "compare", config=config, workers=1)


def test_json_is_one_object(command):
    found = command.json(trials=3)
    assert found["trials"] == found["trials_computed"] == 27
    assert [arm["arm"] for arm in found["arms"]] == ["dog", "random", "ranking"]
    assert "studies with a walker" in command.tool.err
    assert "toy/dog/run-002" in optuna.get_all_study_names(found["storage"])
    # Without it a table for people.
    assert (
        command.run(trials=3, arms="dog,random", runs=1, out=command.folder / "table")
        == 0
    )
    lines = command.tool.out.splitlines()
    assert [line.split()[0] for line in lines[1:3]] == ["dog", "random"]
    assert lines[3].startswith("6 trials (6 now")


def test_a_seed_has_its_own_folder(command, monkeypatch):
    monkeypatch.chdir(command.folder)
    assert command.run(out="", seed=7, trials=1, arms="random") == 0
    out = Path("out") / "compare" / "toy-seed-7"
    assert json.loads((out / "experiment.json").read_text())["seed"] == 7
    assert pq.read_metadata(out / "trials.parquet").num_rows == 3


def test_a_store_in_place_of_the_configs(command):
    """It is what the trials are of: a folder goes on with no other."""
    store = command.folder / "larger"
    fake_walker.write_store(store, samples=400)
    assert command.run(trials=3, arms="dog", store=store) == 0
    facts = json.loads((command.out / "experiment.json").read_text())
    assert facts["stores"] == {"flat": store_digest(store)}
    command.refuses(".*flat", trials=4, arms="dog")
    # its arms read two stores
    command.refuses(f"store: '{store}' ", trials=3, store=store)


def test_sessions_that_cannot_be_read_are_refused_before_the_work(command):
    """The table at the end is made of them, too."""
    one = {"trials": 1, "arms": "random", "runs": 1}
    assert command.run(**one) == 0
    (command.out / "run.json").write_text("{")
    before = {path: path.read_bytes() for path in command.out.glob("*.*")}
    command.refuses("run.json: ", **one)
    assert {path: path.read_bytes() for path in command.out.glob("*.*")} == before


def test_a_password_is_not_printed(command, monkeypatch):
    monkeypatch.setattr(compare, "check_database", lambda *_: None)
    monkeypatch.setattr(compare, "export", lambda *_, **__: None)
    one = {
        "trials": 1,
        "arms": "random",
        "storage": "postgresql+psycopg://me:secret@host/walker",
    }
    for more in ((), ("--json",)):
        assert command.tool(*command.words(**one), *more) == 0
        said = command.tool.out + command.tool.err
        assert "postgresql+psycopg://***@host/walker" in said and "secret" not in said


@pytest.mark.parametrize("kind", ["foreign", "configuration", "locked", "place"])
def test_a_refused_database(kind, command, database):
    place = command.folder / "toy.toml" if kind == "place" else command.folder
    one = {
        "arms": "random",
        "trials": 1,
        "storage": f"sqlite:///{place / 'studies.db'}",
    }
    if kind in ("configuration", "locked"):
        seed = {"seed": 8} if kind == "configuration" else {}
        assert command.run(**one, **seed, out=command.folder / "first") == 0
    if kind == "foreign":
        database.execute("CREATE TABLE studies (a)")
    elif kind == "locked":
        database.execute("BEGIN IMMEDIATE")
    before = {path.name for path in command.folder.iterdir()}
    command.refuses("storage: ", **one)
    after = {path.name for path in command.folder.iterdir()}
    assert not {name for name in before ^ after if not name.startswith("studies.db-")}


# Whom which signal ends, and the exit code and the line that the command ends with.
ENDS = {
    "all": (signal.SIGINT, 130, INTERRUPTED),  # as a terminal does
    "a worker": (
        signal.SIGKILL,
        2,
        "error: workers: 'one was killed' cannot be used; allowed: ",
    ),
    "it": (signal.SIGKILL, -signal.SIGKILL, ""),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "victim", ["all", "a worker", pytest.param("it", marks=pytest.mark.campaign)]
)
def test_all_processes_end_and_the_table_is_the_same(victim, command):
    arms = {"arms": "random,dog,ranking,cmaes-cold,cmaes-warm", "trials": 14}
    process = command.start(**arms, workers=2)
    command.wait_for_more(process)
    number, code, line = ENDS[victim]
    if victim == "all":
        os.killpg(process.pid, number)
    else:
        worker, _ = children(process.pid)
        os.kill(process.pid if victim == "it" else worker, number)
    done = finish(process)
    # Workers end with the main process; Python's own tracker does a moment after the
    # last of us.
    until(lambda: left_over(process.pid) == [], 10.0)
    assert done.code == code and done.last.startswith(line)
    assert "Traceback" not in done.error and 0 < command.rows() < 14 * 15
    whole = command.folder / "whole"
    assert command.run(**arms) == command.run(**arms, out=whole) == 0
    found = (command.out / "trials.parquet").read_bytes()
    assert found == (whole / "trials.parquet").read_bytes()


def left_over(group):
    """Processes of a group that run on."""
    left = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, of = file.read_text().rpartition(")")[2].split()[:3]
            left += [file.parent.name] if int(of) == group and state != "Z" else []
    return left
