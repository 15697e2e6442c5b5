"""taichi-nmm study as its users meet it: every arm, output, exit codes, locks."""

import json
import re
import shlex
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import optuna
import pytest
from optuna.artifacts import get_all_artifact_meta
from optuna.trial import TrialState
from optuna_dashboard import get_note

from storage.databases.studies import only_run
from study.experiment.walker import read_experiment
from taichi_nmm import GAIN_NAMES, load_gains
from taichi_nmm.parameters import PUBLISHED_GAINS, load_all_gains
from tests.study import fake_walker, synthetic_gait
from tests.tools.conftest import Command
from tests.tools.running import ROOT, load_command

ROUGH8 = ROOT / "configs" / "rough8.toml"
NAME = "rough8/dog/run-000"


class Study(Command):
    """The command, and what it leaves in its database."""

    def study(self, name=NAME, url=None):
        return optuna.load_study(study_name=name, storage=url or self.url)

    def rows(self, name=NAME, url=None):
        trials = self.study(name, url).get_trials(states=(TrialState.COMPLETE,))
        return [trial.user_attrs["row"] for trial in trials]


@pytest.fixture
def command(tmp_path, tool, simulator):
    fake_walker.write_plain_store(tmp_path / "store")
    places = {
        "storage": f"sqlite:///{tmp_path / 'studies.db'}",
        "store": tmp_path / "store",
    }
    return Study(tool, tmp_path, "study", config=ROUGH8, arm="dog", trials=4, **places)


def test_json_is_one_object(command):
    found = command.json()
    assert found["study"] == NAME
    assert found["trials"] == 4
    assert found["end_reason"] in ("completed", "fell")
    assert found["best_cost"] == command.study().best_value
    assert command.tool.err.count(NAME) == 4  # a line a trial
    assert f"{NAME}  4/4  cost " in command.tool.err
    walked = [trial.user_attrs["walked"] for trial in command.study().trials]
    trials = found["first_walker"]
    assert trials == walked.index(True) + 1  # a count, as reports have it
    assert command.run() == 0
    said = f"trials walked, the first after {trials}; best: trial number "
    assert f"{said}{found['best_trial']} " in command.tool.out
    gains = command.folder / "out" / "dog-run-000-best.json"
    assert tuple(json.loads(gains.read_text())) == GAIN_NAMES
    load_gains(str(gains))
    assert command.run(arm="random", store="") == 0  # needs none
    assert "rough8/random/run-000: " in command.tool.out


@pytest.fixture
def walks(simulator):
    """Walks that can be drawn, and how many were recorded in each call."""
    recorded = []
    glimpse = synthetic_gait.walk(0.3, 50.0)

    def simulate(gains, record=(), **options):
        made = fake_walker.simulate(gains, **options)
        recorded.extend([len(record)] if record else [])
        return replace(made, trajectories=(glimpse,) * len(record))

    simulator(simulate)
    return recorded


def test_the_best_trial_has_its_picture_in_the_dashboard(command, walks):
    """Beside the database, where our dashboard looks; and once."""
    best = command.json()["best_trial"]
    study = command.study()
    artifacts = [
        get_all_artifact_meta(each, storage=study._storage) for each in study.trials
    ]
    (picture,) = artifacts.pop(best)
    assert artifacts == [[]] * 3
    file = command.folder / "artifacts" / picture.artifact_id
    assert (picture.filename, picture.mimetype) == ("strip.png", "image/png")
    assert file.read_bytes().startswith(b"\x89PNG")
    note = get_note(optuna.Trial(study, study.trials[best]._trial_id))
    assert note.startswith("rough8, run 0: ") and picture.artifact_id in note
    assert command.run() == 0 and walks == [1]
    assert get_note(command.study()).startswith("## ")  # what the features were worth
    find_artifacts = load_command("dashboard").find_artifacts
    assert find_artifacts(None, command.url, None) == file.parent


@pytest.mark.slow
def test_fixed_gains_stand_beside_the_best(command, walks):
    top = 'fixed_gains = "published"\nsearched = ["exo_torque"]'
    config = fake_walker.write_config(command.folder, top)
    found = command.json(config=config, store="", arm="random")
    gains, low_level = load_all_gains(found["gains"])
    assert gains.tolist() == PUBLISHED_GAINS.tolist() and low_level[8] > 0.0


@pytest.mark.slow
def test_lines_are_taken(command, walks, monkeypatch):
    """Film and dashboard, as a user pastes them."""
    config = fake_walker.write_config(command.folder)
    found = command.json(config=config, store="", arm="random", run=2, seed=7)
    film, dashboard = (shlex.split(found[name]) for name in ("film", "dashboard"))
    assert film[1:4] == ["-m", "taichi_nmm", "walk"]
    assert dashboard[1:4] == ["-m", "taichi_nmm", "dashboard"]
    films = []

    def write_movies(path, *shown):
        films.append((path, *shown))
        return path

    monkeypatch.setattr("study.pictures.write_movies", write_movies)
    for name in ("strip", "gait_cycle"):
        monkeypatch.setattr(f"study.pictures.write_{name}", lambda *_: Path("x"))
    assert command.tool(*film[3:], "--out", command.folder / "film") == 0
    ((path, _, ground, *_),) = films
    assert path == command.folder / "film" / "movie.mp4"
    terrain = read_experiment(config, None, 7).terrain(2)
    np.testing.assert_array_equal(ground.height_m, terrain.height_m)
    served = []
    monkeypatch.setattr(
        "socketserver.BaseServer.serve_forever", lambda *_: served.append(None)
    )
    assert command.tool(*dashboard[3:], "--port", 0) == 0
    assert served and "artifacts" in command.tool.out


@pytest.mark.slow
def test_what_is_not_said_is_the_configs(command, monkeypatch):
    """Trials, store and folder; and the study of another run and seed is another one."""
    config = fake_walker.write_config(command.folder / "out")
    monkeypatch.chdir(command.folder)
    words = ("--config", config, "--arm", "dog", "--storage", command.url)
    other = ("--run", 2, "--seed", 7, "--storage", "sqlite:///7.db")
    found = [
        command.tool.json("study", *words, *more) for more in ((), ("--run", 2), other)
    ]
    assert [each["study"] for each in found] == [
        f"toy/dog/run-00{run}" for run in (0, 2, 2)
    ]
    assert {each["trials"] for each in found} == {8}
    assert len({each["row"] for each in found}) > 1
    assert (Path("out") / "toy" / "dog-run-000-best.json").is_file()
    assert (Path("out") / "toy" / "dog-run-002-best.json").is_file()


def test_locked_midway(command, database, simulator):
    calls = count()

    def simulate_and_lock(*args, **options):
        if next(calls) == 2:
            database.execute("BEGIN EXCLUSIVE")
        return fake_walker.simulate(*args, **options)

    simulator(simulate_and_lock)
    assert command.run() == 2
    *trials, line = command.tool.err.strip().splitlines()
    assert re.match("error: storage: .*database is locked", line) and len(trials) == 2
    database.rollback()
    assert command.run() == 0
    assert len(set(command.rows())) == 4


@pytest.mark.parametrize("writing", [False, True])
def test_no_study_runs_twice(writing, command, database):
    assert command.run(trials=1) == 0
    with only_run(command.url, NAME):
        if writing:  # as a process that was stopped in the middle of it
            database.execute("BEGIN EXCLUSIVE")
        command.refuses(f"study: '{NAME}'.*another process")


def test_ctrl_c_says_that_work_is_kept(command, simulator):
    simulator(fake_walker.stopped_in_call(1))
    assert command.run() == 130
    assert "resumes" in command.tool.err
