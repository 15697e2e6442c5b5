"""taichi-nmm compare as its users meet it: output, exit codes, kill -9, Ctrl-C."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pyarrow.parquet as pq
import pytest

import taichi_nmm
from storage.databases import studies
from study.comparison import compare
from study.experiment.stores import store_digest
from taichi_nmm.errors import InputError
from tests.study import fake_walker
from tests.tools.running import ROOT, run_tool

PROGRAM = [sys.executable, str(ROOT / "tests" / "tools" / "fake_command.py"), "compare"]


class Command:
    """The command in a folder of its own, in this process or in another."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self.monkeypatch = monkeypatch
        self.config = fake_walker.write_config(folder)

    def arguments(self, *flags: str, **changes: str | int) -> list[str]:
        options = {"config": self.config, "out": self.folder / "out", "workers": 1} | changes
        words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
        return ["--no-artifacts", *words, *flags]

    def run(self, *flags: str, **changes: str | int) -> int:
        """Exit code of the command."""
        return run_tool(self.monkeypatch, "compare", *self.arguments(*flags, **changes))

    def start(self, **changes: str | int) -> subprocess.Popen[bytes]:
        """The command in a process of its own, a tenth of a second a round."""
        environment = os.environ | {"FAKE_TRIAL_S": "0.1", "FAKE_STRETCH": "2"}
        return subprocess.Popen(
            [*PROGRAM, *self.arguments(**changes)],
            env=environment,
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            start_new_session=True,
        )

    def rows(self, out: str = "out") -> int:
        """Finished trials on the disk."""
        files = (self.folder / out / "arms").glob("*.parquet")
        return sum(pq.read_metadata(file).num_rows for file in files)

    def wait_for_more(self, process: subprocess.Popen[bytes], out: str = "out") -> None:
        """Until the process has written a stretch."""
        before, deadline_s = self.rows(out), time.monotonic() + 60.0
        while self.rows(out) == before:
            if process.poll() is not None:
                pytest.fail(f"ended: {process.communicate()[1].decode()}")
            assert time.monotonic() < deadline_s
            time.sleep(0.02)


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
    return Command(tmp_path, monkeypatch)


def test_json_is_one_object(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.run("--json", trials=3) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert found["trials"] == found["trials_computed"] == 27
    assert [arm["arm"] for arm in found["arms"]] == ["dog", "random", "score-first-diverse"]
    assert "studies with a walker" in err
    names = optuna.get_all_study_names(found["storage"])
    assert "toy/dog/run-002" in names


def test_the_table_is_for_people(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.run(trials=3, arms="dog,random", runs=1) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:3]] == ["dog", "random"]
    assert lines[3].startswith("6 trials (6 now")


def test_another_seed_has_a_folder_of_its_own(command: Command) -> None:
    command.monkeypatch.chdir(command.folder)
    options = command.arguments("--seed", "7", trials=1, arms="random")
    place = options.index("--out")
    del options[place : place + 2]
    command.monkeypatch.setattr(command, "arguments", lambda *_, **__: options)
    assert command.run() == 0
    out = Path("out") / "compare" / "toy-seed-7"
    assert json.loads((out / "experiment.json").read_text())["seed"] == 7
    assert pq.read_metadata(out / "trials.parquet").num_rows == 3


def test_a_store_in_place_of_the_configs(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is what the trials are of: a folder goes on with no other."""
    fake_walker.write_store(command.folder / "larger", samples=400)
    store = str(command.folder / "larger")
    assert command.run(trials=3, arms="dog", store=store) == 0
    facts = json.loads((command.folder / "out" / "experiment.json").read_text())
    assert facts["stores"] == {"flat": store_digest(Path(store))}
    capsys.readouterr()
    assert command.run(trials=4, arms="dog") == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and "flat" in said and said.count("\n") == 1
    assert command.run(trials=3, store=store) == 2  # the configuration's arms read two
    assert capsys.readouterr().err.startswith(f"error: store: '{store}' ")


def test_sessions_that_cannot_be_read_are_refused_before_the_work(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table at the end is made of them, too."""
    assert command.run(trials=1, arms="random", runs=1) == 0
    (command.folder / "out" / "run.json").write_text("{")
    before = {path: path.read_bytes() for path in (command.folder / "out").glob("*.*")}
    capsys.readouterr()
    assert command.run(trials=1, arms="random", runs=1) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: run.json: ") and said.count("\n") == 1
    assert {path: path.read_bytes() for path in (command.folder / "out").glob("*.*")} == before


def test_a_password_is_not_printed(
    command: Command, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compare, "check_database", lambda *_: None)
    monkeypatch.setattr(compare, "export", lambda *_, **__: None)
    url = "postgresql+psycopg://me:secret@host/walker"
    for flags in ((), ("--json",)):
        assert command.run(*flags, trials=1, arms="random", storage=url) == 0
    said = capsys.readouterr()
    assert "secret" not in said.out + said.err
    assert said.out.count("postgresql+psycopg://***@host/walker") == 2


def test_a_session_is_noted(command: Command) -> None:
    assert command.run(trials=1) == 0
    assert command.run(trials=1) == 0  # nothing to do: no session
    assert command.run(trials=2) == 0
    sessions = json.loads((command.folder / "out" / "run.json").read_text())["sessions"]
    assert [session["trials"] for session in sessions] == [9, 9]
    assert sessions[0]["machine"]["cores"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"config": "nowhere.toml"}, "config: 'nowhere.toml'"),
        ({"arms": "dog,cat"}, "arm: 'cat'"),
        ({"runs": 0}, "runs: 0"),
        ({"trials": 0}, "trials: 0"),
        ({"seed": -1}, "seed: -1"),
        ({"storage": "oracle://host/db"}, "storage: '***'"),
        ({"arch": "cuda"}, "simulation.arch: 'cuda'"),
    ],
)
def test_bad_input_is_one_line(
    changes: dict[str, Any],
    message: str,
    command: Command,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def require_engine(settings: Any) -> None:
        if settings.arch == "cuda":
            raise InputError("simulation.arch", "cuda", "an architecture of this machine")

    monkeypatch.setattr("taichi_nmm.walker_simulator.require_engine", require_engine)
    assert command.run(**changes) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"error: {message}")
    assert not (command.folder / "out").exists()


@pytest.mark.parametrize("kind", ["foreign", "configuration", "locked", "place", "URL"])
def test_a_database_that_is_refused_leaves_no_folder(
    kind: str, command: Command, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(studies, "BUSY_TIMEOUT_S", 0.1)
    file = command.folder / "other.db"
    url = {"place": f"sqlite:///{command.config}/a.db", "URL": "foo"}.get(kind, f"sqlite:///{file}")
    if kind in ("configuration", "locked"):
        first = {"seed": 8} if kind == "configuration" else {}
        words = {"storage": url, "out": str(command.folder / "first")}
        assert command.run(arms="random", trials=1, **words, **first) == 0
    with closing(sqlite3.connect(file, isolation_level=None)) as connection:
        connection.execute({"foreign": "CREATE TABLE studies (a)"}.get(kind, "BEGIN IMMEDIATE"))
        before = sorted(path.name for path in command.folder.iterdir())
        capsys.readouterr()
        assert command.run(arms="random", trials=1, storage=url) == 2
    line = capsys.readouterr().err
    assert line.startswith("error: storage: ") and line.count("\n") == 1
    after = {
        path.name for path in command.folder.iterdir() if not path.name.startswith("other.db-")
    }
    assert sorted(after) == [name for name in before if not name.startswith("other.db-")]


def test_a_missing_ffmpeg_is_refused_before_the_work(
    command: Command, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nowhere/ffmpeg")
    arguments = [word for word in command.arguments() if word != "--no-artifacts"]
    monkeypatch.setattr(command, "arguments", lambda *_, **__: arguments)
    assert command.run() == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("error: ffmpeg: ")
    assert not (command.folder / "out").exists()


def test_ctrl_c_keeps_finished_stretches(
    command: Command, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compare, "STRETCH_TRIALS", 2)
    stopping = fake_walker.stopped_in_call(6)  # in the third stretch
    monkeypatch.setitem(vars(taichi_nmm), "simulate", stopping)
    assert command.run() == 130
    assert "the same command resumes" in capsys.readouterr().err
    assert command.rows() == 4 * 9


@pytest.mark.slow
def test_ctrl_c_ends_all_processes(command: Command) -> None:
    process = command.start(trials=100, workers=2)
    command.wait_for_more(process)
    os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to the workers as well
    assert process.wait(30) == 130
    assert process.stderr is not None
    said = process.stderr.read().decode()
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
        process.wait()
        assert process.stderr is not None
        process.stderr.close()
        assert left_over(process.pid) == []  # workers end with the main process
    kept = command.rows()
    assert 0 < kept < 45 * 15
    assert command.run(**arms) == 0
    assert command.run(**arms | {"out": str(command.folder / "whole")}) == 0
    parts, whole = (command.folder / name / "trials.parquet" for name in ("out", "whole"))
    assert parts.read_bytes() == whole.read_bytes()


def left_over(group: int) -> list[int]:
    """Processes of a group that run on: Python's own tracker ends a moment after the last of us."""
    deadline_s = time.monotonic() + 10.0
    while (running := members(group)) and time.monotonic() < deadline_s:
        time.sleep(0.05)
    return running


def members(group: int) -> list[int]:
    """Processes of a group that still run."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[2]) == group and fields[0] != "Z":
            found.append(int(entry.name))
    return found
