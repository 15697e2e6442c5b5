"""tools/study.py as its users meet it: every arm, output, exit codes, locks, kill -9."""

import json
import os
import re
import shlex
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest
from optuna.artifacts import get_all_artifact_meta
from optuna.trial import TrialState
from optuna_dashboard import get_note

import taichi_nmm
from storage.databases import studies
from storage.databases.studies import only_run
from storage.store import open_store
from study.experiment.arms import ARMS
from study.experiment.experiment import read_experiment
from study.features import FAMILIES
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, GAINS
from taichi_nmm.result import Result
from taichi_nmm.settings import Settings
from tests.study import fake_walker, synthetic_gait
from tests.tools.running import ROOT, load_command, run_tool

ROUGH8 = ROOT / "configs" / "rough8.toml"


class Command:
    """The command in a folder of its own, in this process."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self.monkeypatch = monkeypatch

    def arguments(self, **changes: str | int) -> list[str]:
        options: dict[str, str | int] = {
            "config": str(ROUGH8),
            "arm": "dog",
            "trials": 4,
            "storage": self.url(),
            "store": str(self.folder / "store"),
            "out": str(self.folder / "out"),
        }
        pairs = (options | changes).items()
        words = [(f"--{name}", str(value)) for name, value in pairs if value != ""]
        return [word for pair in words for word in pair]

    def url(self) -> str:
        return f"sqlite:///{self.folder / 'studies.db'}"

    def run(self, *flags: str, **changes: str | int) -> int:
        """Exit code of the command."""
        return run_tool(self.monkeypatch, "study", *self.arguments(**changes), *flags)

    def rows(self, url: str | None = None) -> list[int]:
        study = optuna.load_study(study_name="rough8/dog/run-000", storage=url or self.url())
        trials = study.get_trials(states=(TrialState.COMPLETE,))
        return [trial.user_attrs["row"] for trial in trials]


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
    fake_walker.write_plain_store(tmp_path / "store")
    return Command(tmp_path, monkeypatch)


def test_json_is_one_object(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.run("--json") == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert found["study"] == "rough8/dog/run-000"
    assert found["trials"] == 4
    assert found["end_reason"] in ("completed", "fell")
    assert err.count("rough8/dog/run-000") == 4  # a line a trial
    gains = json.loads((command.folder / "out" / "dog-run-000-best.json").read_text())
    assert tuple(gains) == GAIN_NAMES
    taichi_nmm.load_gains(str(command.folder / "out" / "dog-run-000-best.json"))


def looked_at(command: Command, number: int) -> tuple[list[Any], str]:
    """Artifacts and note of a trial."""
    study = optuna.load_study(study_name="rough8/dog/run-000", storage=command.url())
    trial = optuna.Trial(study, study.trials[number]._trial_id)
    return get_all_artifact_meta(study.trials[number], storage=study._storage), get_note(trial)


@pytest.fixture
def walks(command: Command) -> list[int]:
    """Walks that can be drawn, and how many were recorded in each call."""
    recorded: list[int] = []
    glimpse = synthetic_gait.walk(0.3, 50.0)

    def simulate(gains: Any, record: Sequence[int] = (), **options: Any) -> Result:
        made = fake_walker.simulate(gains, **options)
        recorded.extend([len(record)] if record else [])
        return replace(made, trajectories=(glimpse,) * len(record))

    command.monkeypatch.setitem(vars(taichi_nmm), "simulate", simulate)
    return recorded


def test_the_best_trial_has_its_picture_in_the_dashboard(
    command: Command, walks: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    """Beside the database, where our dashboard looks; and once."""
    assert command.run("--json") == 0
    best = json.loads(capsys.readouterr().out)["best_trial"]
    (picture,), note = looked_at(command, best)
    file = command.folder / "artifacts" / picture.artifact_id
    assert (picture.filename, picture.mimetype) == ("strip.png", "image/png")
    assert file.read_bytes().startswith(b"\x89PNG")
    assert note.startswith("rough8, run 0: ") and picture.artifact_id in note
    others = set(range(4)) - {best}
    assert not any(looked_at(command, number)[0] for number in others)
    assert command.run() == 0 and walks == [1]
    study = optuna.load_study(study_name="rough8/dog/run-000", storage=command.url())
    assert get_note(study).startswith("## ")  # what the features were worth
    find_artifacts = load_command("dashboard").find_artifacts
    assert find_artifacts(None, command.url(), None) == file.parent


def test_the_lines_that_it_prints_are_taken(
    command: Command, walks: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    """Film and dashboard, as a user pastes them."""
    config = fake_walker.write_config(command.folder)
    changes = {"config": str(config), "store": "", "arm": "random", "run": 2, "seed": 7}
    assert command.run("--json", **changes) == 0
    found = json.loads(capsys.readouterr().out)
    lines = {name: shlex.split(found[name]) for name in ("film", "dashboard")}
    assert [words[1:4] for words in lines.values()] == [
        ["-m", "taichi_nmm", "walk"], ["-m", "taichi_nmm", "dashboard"],
    ]  # fmt: skip
    films: list[Any] = []
    command.monkeypatch.setattr("study.pictures.write_movie", lambda *made: films.append(made))
    for name in ("strip", "gait_cycle"):
        command.monkeypatch.setattr(f"study.pictures.write_{name}", lambda *_: Path("x"))
    out = ("--out", command.folder / "film")
    assert run_tool(command.monkeypatch, *lines["film"][3:], *out) == 0
    experiment = read_experiment(config, None, 7)
    ((path, _, ground, *_),) = films
    assert path == command.folder / "film" / "movie.mp4"
    np.testing.assert_array_equal(ground.height_m, experiment.terrain(2).height_m)
    served: list[None] = []
    command.monkeypatch.setattr(
        "socketserver.BaseServer.serve_forever", lambda *_: served.append(None)
    )
    assert run_tool(command.monkeypatch, *lines["dashboard"][3:], "--port", 0) == 0
    assert served and "artifacts" in capsys.readouterr().out


def test_trials_are_a_total(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.run() == 0
    first = command.rows()
    assert command.run(trials=7) == 0
    assert command.run(trials=7) == 0
    assert "7/7" in capsys.readouterr().err
    assert len(command.rows()) == 7
    assert command.rows()[:4] == first


def test_random_needs_no_store(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.run(arm="random", store="") == 0
    assert "rough8/random/run-000: " in capsys.readouterr().out


def test_what_is_not_said_is_the_configurations(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    """Trials, store and folder; and the study of another run and seed is another one."""
    config = fake_walker.write_config(command.folder / "out")
    command.monkeypatch.chdir(command.folder)
    words = ("--config", config, "--arm", "dog", "--storage", command.url(), "--json")
    found = {}
    for more in ((), ("--run", "2"), ("--run", "2", "--seed", "7", "--storage", "sqlite:///7.db")):
        assert run_tool(command.monkeypatch, "study", *words, *more) == 0
        found[more] = json.loads(capsys.readouterr().out)
    assert [each["study"] for each in found.values()] == [
        "toy/dog/run-000", "toy/dog/run-002", "toy/dog/run-002",
    ]  # fmt: skip
    assert {each["trials"] for each in found.values()} == {8}
    assert len({each["row"] for each in found.values()}) > 1
    assert (Path("out") / "toy" / "dog-run-000-best.json").is_file()
    assert (Path("out") / "toy" / "dog-run-002-best.json").is_file()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of several tests: to make a database takes longer than a study."""
    return tmp_path_factory.mktemp("shared")


@pytest.mark.slow
@pytest.mark.parametrize("arm", ARMS)
def test_every_arm_can_be_run(
    shared: Path, arm: str, command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    url = f"sqlite:///{shared}/studies.db"
    config = str(fake_walker.write_config(shared))
    assert command.run(config=config, arm=arm, store="", trials=2, storage=url) == 0
    assert f"toy/{arm}/run-000: " in capsys.readouterr().out
    trials = optuna.load_study(study_name=f"toy/{arm}/run-000", storage=url).trials
    assert [trial.state for trial in trials] == [TrialState.COMPLETE] * 2
    assert trials[0].params != trials[1].params


@pytest.fixture
def families(command: Command) -> Path:
    """A store with the families that the best sampler reads; a third of its rows fell too soon."""
    strict = {"settings": 1, "min_survival_s": 2.8, "body": {"disturbance": 0.15}}
    path = command.folder / "families"
    fake_walker.write_store(path, families=dict.fromkeys(FAMILIES, strict))
    return path


def test_the_best_sampler_proposes_rows_that_walked(command: Command, families: Path) -> None:
    assert command.run(arm="best", store=str(families), trials=5) == 0
    assert command.run(arm="best", store=str(families), trials=8) == 0
    study = optuna.load_study(study_name="rough8/best/run-000", storage=command.url())
    rows = [trial.user_attrs["row"] for trial in study.trials]
    assert len(set(rows)) == 8
    walked = open_store(families).table()["rough_evaluated"].to_numpy()
    assert walked[rows].all() and not walked.all()


def test_the_best_samplers_study_keeps_to_its_store(
    command: Command, families: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.run(arm="best", store=str(families), trials=2) == 0
    fake_walker.write_store(command.folder / "other", samples=120)
    assert command.run(arm="best", store=str(command.folder / "other"), trials=4) == 2
    assert "study rough8/best/run-000: stores.diverse" in capsys.readouterr().err


def test_the_best_sampler_needs_families(
    command: Command, families: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.run(arm="best") == 2
    assert "a store with the column rough_survived_fraction_mean" in capsys.readouterr().err
    walked = int(open_store(families).table()["rough_evaluated"].to_numpy().sum())
    assert command.run(arm="best", store=str(families), trials=walked + 1) == 2
    assert f"at most {walked}, the rows that best may take of the store" in capsys.readouterr().err


@pytest.mark.parametrize("arm", ["dog", "best"])
def test_a_store_of_more_than_the_gains_is_refused(
    command: Command, families: Path, arm: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = command.folder / "torso"
    fake_walker.write_store(path, searched=["theta_ref"])
    assert command.run(arm=arm, store=str(path)) == 2
    message = "with theta_ref' cannot be used; allowed: a store of the 16 gains"
    assert message in capsys.readouterr().err


def no_gpu(settings: Settings) -> None:
    raise InputError("simulation.arch", settings.arch, "an architecture of this machine")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"config": "nowhere.toml"}, "config: 'nowhere.toml'"),
        ({"arm": "cat"}, "arm: 'cat' .* one of random, .*dog"),
        ({"run": 50}, "run: 50 .* 0 to 49, the runs of rough8"),
        ({"run": -1}, "run: -1 "),
        ({"seed": -1}, "seed: -1 "),
        ({"arm": "random"}, "store: .* arms that read one store; random: none"),
        ({"trials": 0}, "trials: 0"),
        ({"trials": 1000}, "trials: 1000 .* at most 200"),
        ({"storage": "postgresql://host/db"}, r"storage: '\*\*\*' .* sqlite:///FILE"),
        (
            {"storage": "postgresql+psycopg://me:secret@host"},
            r"storage: 'postgresql.psycopg://\*\*\*@host'",
        ),
        ({"store": "nowhere"}, "nowhere"),
        ({"arch": "cuda"}, "simulation.arch: 'cuda'"),
    ],
)
def test_bad_input_is_one_line_and_no_file(
    command: Command,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    changes: dict[str, str | int],
    message: str,
) -> None:
    if "arch" in changes:  # a machine without a GPU
        monkeypatch.setattr("taichi_nmm.kernel.backend.start", no_gpu)
    assert command.run(**changes) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert re.match(f"error: .*{message}", lines[0])
    assert [path.name for path in command.folder.iterdir()] == ["store"]


def test_a_server_that_does_not_answer_is_one_line_without_its_password(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    url = "postgresql+psycopg://me:secret@127.0.0.1:1/walker"
    assert command.run(storage=url) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("error: storage: 'postgresql+psycopg://***@127.0.0.1:1/walker'")
    assert "secret" not in line


def test_a_store_of_other_bounds_is_refused(
    command: Command, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    narrower = replace(GAINS[0], high=7.0)
    monkeypatch.setattr("taichi_nmm.walker_simulator.GAINS", (narrower, *GAINS[1:]))
    assert command.run() == 2
    assert re.search(r"gains\.K_GAS: .*8\.0.* allowed: .*7\.0", capsys.readouterr().err)


def test_another_configuration_is_refused_by_name(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.run() == 0
    other = command.folder / "other.toml"
    other.write_text(ROUGH8.read_text().replace("seed = 1", "seed = 2"))
    capsys.readouterr()
    new = command.folder / "new"
    assert command.run(config=str(other), trials=6, out=str(new)) == 2
    assert not new.exists()
    assert "study rough8/dog/run-000: seed: 2" in capsys.readouterr().err
    assert len(command.rows()) == 4


def test_a_locked_database_is_one_line(
    command: Command, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert command.run() == 0
    monkeypatch.setattr(studies, "BUSY_TIMEOUT_S", 0.1)
    capsys.readouterr()
    with closing(sqlite3.connect(command.folder / "studies.db")) as connection:
        connection.execute("BEGIN EXCLUSIVE")
        assert command.run(trials=6) == 2
    assert "database is locked" in capsys.readouterr().err


def test_a_database_locked_half_way_is_one_line_and_resumes(
    command: Command, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(studies, "BUSY_TIMEOUT_S", 0.1)
    database = sqlite3.connect(command.folder / "studies.db")
    calls = iter(range(100))

    def simulate_and_lock(*args: Any, **options: Any) -> Result:
        if next(calls) == 2:
            database.execute("BEGIN EXCLUSIVE")
        return fake_walker.simulate(*args, **options)

    monkeypatch.setitem(vars(taichi_nmm), "simulate", simulate_and_lock)
    with closing(database):
        assert command.run() == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert re.match("error: storage: .*database is locked", lines[-1])
    assert len(lines) == 3  # two trials, one error
    assert command.run() == 0
    assert len(set(command.rows())) == 4


def test_another_programs_database_leaves_no_folder_and_is_kept(
    command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    file = command.folder / "studies.db"
    with closing(sqlite3.connect(file)) as connection:
        connection.execute("CREATE TABLE studies (title TEXT)")
    before = file.read_bytes()
    assert command.run() == 2
    assert capsys.readouterr().err.startswith("error: storage: ")
    assert {path.name for path in command.folder.iterdir()} == {"store", "studies.db"}
    assert file.read_bytes() == before


@pytest.mark.parametrize("writing", [False, True])
def test_a_study_that_runs_already_is_refused(
    writing: bool,
    command: Command,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(studies, "BUSY_TIMEOUT_S", 0.1)
    assert command.run(trials=1) == 0
    capsys.readouterr()
    database = sqlite3.connect(command.folder / "studies.db")
    with closing(database), only_run(command.url(), "rough8/dog/run-000"):
        if writing:  # as a process that was stopped in the middle of it
            database.execute("BEGIN EXCLUSIVE")
        assert command.run() == 2
    said = capsys.readouterr().err
    assert said.startswith("error: study: 'rough8/dog/run-000'") and "another process" in said


def test_ctrl_c_says_that_work_is_kept(
    command: Command, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any, **__: Any) -> Result:
        raise KeyboardInterrupt

    monkeypatch.setitem(vars(taichi_nmm), "simulate", interrupted)
    assert command.run() == 130
    assert "resumes" in capsys.readouterr().err


@pytest.mark.slow
def test_killed_and_resumed_is_the_same_study(command: Command) -> None:
    whole = f"sqlite:///{command.folder / 'whole.db'}"
    assert command.run(trials=7, storage=whole) == 0
    program = [sys.executable, str(ROOT / "tests" / "tools" / "fake_command.py"), "study"]
    killed = subprocess.run(
        program + command.arguments(trials=7),
        stderr=subprocess.PIPE,
        env=os.environ | {"FAKE_SIGNAL": "5:SIGKILL"},
    )
    assert killed.returncode == -signal.SIGKILL
    assert killed.stderr.count(b"rough8/dog/run-000") == 4
    assert len(command.rows()) == 4
    assert command.run(trials=7) == 0
    assert command.rows() == command.rows(whole)
