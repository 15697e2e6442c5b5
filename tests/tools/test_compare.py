"""taichi-nmm compare as its users meet it: output, exit codes, kill -9, Ctrl-C."""

import json
import os
import signal
import sqlite3
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import optuna
import pyarrow.parquet as pq
import pytest

from study.comparison import compare
from study.experiment.stores import store_digest
from tests.study import fake_walker
from tests.tools.conftest import Simulator, Tool
from tests.tools.running import start


class Command:
    """The command in a folder of its own, in this process or in another."""

    def __init__(self, folder: Path, tool: Tool) -> None:
        self.folder, self.tool = folder, tool
        self.out = folder / "out"
        self.config = fake_walker.write_config(folder)

    def words(self, **changes: object) -> list[str]:
        options = {"config": self.config, "out": self.out, "workers": 1} | changes
        words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
        return ["compare", "--no-artifacts", *words]

    def run(self, **changes: object) -> int:
        """Exit code of the command."""
        return self.tool(*self.words(**changes))

    def refuses(self, message: str, **changes: object) -> None:
        self.tool.refuses(message, *self.words(**changes))

    def start(self, **changes: object) -> "subprocess.Popen[str]":
        """The command in a process of its own, a tenth of a second a round."""
        return start(*self.words(**changes), trial_s=0.1, stretch=2)

    def rows(self) -> int:
        """Finished trials on the disk."""
        files = (self.out / "arms").glob("*.parquet")
        return sum(pq.read_metadata(file).num_rows for file in files)

    def wait_for_more(self, process: "subprocess.Popen[str]") -> None:
        """Until the process has written a stretch."""
        before, deadline_s = self.rows(), time.monotonic() + 60.0
        while self.rows() == before:
            if process.poll() is not None:
                pytest.fail(f"ended: {process.communicate()[1]}")
            assert time.monotonic() < deadline_s
            time.sleep(0.02)


@pytest.fixture
def command(tmp_path: Path, tool: Tool, simulator: Simulator) -> Command:
    return Command(tmp_path, tool)


def test_json_is_one_object(command: Command) -> None:
    found = command.tool.json(*command.words(trials=3))
    assert found["trials"] == found["trials_computed"] == 27
    assert [arm["arm"] for arm in found["arms"]] == ["dog", "random", "score-first-diverse"]
    assert "studies with a walker" in command.tool.err
    assert "toy/dog/run-002" in optuna.get_all_study_names(found["storage"])


def test_the_table_is_for_people(command: Command) -> None:
    assert command.run(trials=3, arms="dog,random", runs=1) == 0
    lines = command.tool.out.splitlines()
    assert [line.split()[0] for line in lines[1:3]] == ["dog", "random"]
    assert lines[3].startswith("6 trials (6 now")


def test_another_seed_has_a_folder_of_its_own(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(command.folder)
    words = ("--no-artifacts", "--config", command.config, "--workers", 1)
    assert command.tool("compare", *words, "--seed", 7, "--trials", 1, "--arms", "random") == 0
    out = Path("out") / "compare" / "toy-seed-7"
    assert json.loads((out / "experiment.json").read_text())["seed"] == 7
    assert pq.read_metadata(out / "trials.parquet").num_rows == 3


def test_a_store_in_place_of_the_configs(command: Command) -> None:
    """It is what the trials are of: a folder goes on with no other."""
    store = command.folder / "larger"
    fake_walker.write_store(store, samples=400)
    assert command.run(trials=3, arms="dog", store=store) == 0
    facts = json.loads((command.out / "experiment.json").read_text())
    assert facts["stores"] == {"flat": store_digest(store)}
    command.refuses(".*flat", trials=4, arms="dog")
    command.refuses(f"store: '{store}' ", trials=3, store=store)  # its arms read two stores


def test_sessions_that_cannot_be_read_are_refused_before_the_work(command: Command) -> None:
    """The table at the end is made of them, too."""
    one = {"trials": 1, "arms": "random", "runs": 1}
    assert command.run(**one) == 0
    (command.out / "run.json").write_text("{")
    before = {path: path.read_bytes() for path in command.out.glob("*.*")}
    command.refuses("run.json: ", **one)
    assert {path: path.read_bytes() for path in command.out.glob("*.*")} == before


def test_a_password_is_not_printed(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "check_database", lambda *_: None)
    monkeypatch.setattr(compare, "export", lambda *_, **__: None)
    one = {"trials": 1, "arms": "random", "storage": "postgresql+psycopg://me:secret@host/walker"}
    for more in ((), ("--json",)):
        assert command.tool(*command.words(**one), *more) == 0
        said = command.tool.out + command.tool.err
        assert "postgresql+psycopg://***@host/walker" in said and "secret" not in said


@pytest.mark.parametrize("kind", ["foreign", "configuration", "locked", "place"])
def test_a_database_that_is_refused_leaves_no_folder(
    kind: str, command: Command, database: sqlite3.Connection
) -> None:
    place = command.config if kind == "place" else command.folder
    one = {"arms": "random", "trials": 1, "storage": f"sqlite:///{place / 'studies.db'}"}
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


def test_a_missing_ffmpeg_is_refused_before_the_work(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nowhere/ffmpeg")
    words = (word for word in command.words() if word != "--no-artifacts")
    command.tool.refuses("ffmpeg: ", *words)
    assert not command.out.exists()


def test_ctrl_c_keeps_finished_stretches(
    command: Command, simulator: Simulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compare, "STRETCH_TRIALS", 2)
    simulator(fake_walker.stopped_in_call(6))  # in the third stretch
    assert command.run() == 130
    assert "the same command resumes" in command.tool.err
    assert command.rows() == 4 * 9


@pytest.mark.slow
def test_ctrl_c_ends_all_processes(command: Command) -> None:
    process = command.start(trials=100, workers=2)
    command.wait_for_more(process)
    os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to the workers as well
    _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "the same command resumes" in said
    assert "Traceback" not in said
    assert left_over(process.pid) == []


@pytest.mark.campaign
def test_killed_ten_times_and_resumed_is_the_same_table(command: Command) -> None:
    arms = {"arms": "random,dog,score-first-diverse,cmaes-cold,cmaes-warm", "trials": 45}
    rng = np.random.default_rng(0)
    for number in range(10):
        process = command.start(**arms, workers=2 if number % 5 == 0 else 1)
        command.wait_for_more(process)
        time.sleep(rng.uniform(0.0, 0.25))
        process.kill()
        process.communicate()
        assert left_over(process.pid) == []  # workers end with the main process
    assert 0 < command.rows() < 45 * 15
    whole = command.folder / "whole"
    assert command.run(**arms) == 0
    assert command.run(**arms, out=whole) == 0
    parts = (command.out / "trials.parquet").read_bytes()
    assert parts == (whole / "trials.parquet").read_bytes()


def left_over(group: int) -> list[str]:
    """Processes of a group that run on: Python's own tracker ends a moment after the last of us."""
    deadline_s = time.monotonic() + 10.0
    while True:
        left = []
        for file in Path("/proc").glob("[0-9]*/stat"):
            with suppress(OSError):
                state, _, of = file.read_text().rpartition(")")[2].split()[:3]
                left += [file.parent.name] if int(of) == group and state != "Z" else []
        if not left or time.monotonic() > deadline_s:
            return left
        time.sleep(0.05)
