"""The picture of the best trial of a live study, as Optuna and its dashboard find it."""

import json
from unittest.mock import Mock

import numpy as np
import optuna
import pytest
from optuna.artifacts import (
    FileSystemArtifactStore,
    get_all_artifact_meta,
    upload_artifact,
)
from optuna_dashboard import get_note, save_note

from storage.databases.studies import open_studies
from study.experiment import artifacts
from study.experiment.artifacts import draw_best
from study.experiment.database import export
from study.experiment.gains import named_gains, recorded_walk
from taichi_nmm.result import Result
from tests.cases import refused
from tests.study import synthetic_gait
from tests.study.experiment.fake_results import experiment, results

pytestmark = pytest.mark.slow

TINY = experiment()
NAME, BEST = "tiny/dog/run-000", 1


@pytest.fixture
def fake(monkeypatch):
    """Stands for the simulator, and remembers what it was asked for."""
    fake = Mock(return_value=Result(np.zeros(0), (synthetic_gait.walk(0.3, 50.0),)))
    monkeypatch.setattr(artifacts, "recorded_walk", fake)
    return fake


@pytest.fixture
def url(tmp_path):
    """A database of studies."""
    url = f"sqlite:///{tmp_path}/studies.db"
    export(TINY, results(TINY), url, None, final=True)
    return url


def load(url):
    return optuna.load_study(study_name=NAME, storage=open_studies(url))


def make(url, folder):
    """Draw; the study afterwards."""
    draw_best(TINY, 0, load(url), url, folder)
    return load(url)


def best_note(study):
    return str(get_note(optuna.trial.Trial(study, study.best_trial._trial_id)))


def test_the_best_trial_is_simulated_and_registered(tmp_path, url, fake):
    study = make(url, tmp_path)
    ((gains, simulated, *asked),) = (call.args for call in fake.call_args_list)
    assert gains.gains.tolist() == [study.best_params[name] for name in TINY.names]
    assert (simulated, *asked) == (TINY, 0, 50.0)
    (file,) = (tmp_path / "artifacts").iterdir()
    assert file.read_bytes().startswith(b"\x89PNG")
    found = [
        get_all_artifact_meta(each, storage=study._storage) for each in study.trials
    ]
    (meta,) = found.pop(BEST)
    assert found == [[]] * 2
    assert (meta.artifact_id, meta.filename, meta.mimetype) == (
        file.name,
        "strip.png",
        "image/png",
    )
    path = f"/artifacts/{study._study_id}/{study.best_trial._trial_id}/{file.name}"
    note = best_note(study)
    assert note.startswith("tiny, run 0: walked 2.0 s, 2.0 m at 0.50 m/s\n")
    assert note.endswith(f"({path})")
    # As Optuna itself registers a file.
    trial, store = study.ask(), FileSystemArtifactStore(tmp_path)
    upload_artifact(artifact_store=store, file_path=str(file), study_or_trial=trial)
    (theirs,) = study.trials[trial.number].system_attrs.values()
    ours = study.best_trial.system_attrs[f"artifacts:{file.name}"]
    assert list(json.loads(ours)) == list(json.loads(theirs))
    assert json.loads(ours)["encoding"] == json.loads(theirs)["encoding"]


def test_what_is_there_is_kept(tmp_path, url, fake):
    make(url, tmp_path)
    (file,) = (tmp_path / "artifacts").iterdir()
    written = file.stat().st_mtime_ns
    (tmp_path / "artifacts" / ".x.1.tmp").touch()  # of a call that was killed
    make(url, tmp_path)
    assert [*(tmp_path / "artifacts").iterdir()] == [file] and fake.call_count == 1
    assert file.stat().st_mtime_ns == written
    file.unlink()
    make(url, tmp_path)
    assert file.exists()


def test_a_lost_note(tmp_path, url, fake, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(artifacts, "_note", interrupt)
        make(url, tmp_path)
    assert not best_note(load(url))
    study = make(url, tmp_path)
    assert best_note(study)
    assert len(get_all_artifact_meta(study.best_trial, storage=study._storage)) == 1


def test_a_note_of_the_users_stays(tmp_path, url, fake):
    study = load(url)
    save_note(optuna.trial.Trial(study, study.best_trial._trial_id), "mine")
    assert best_note(make(url, tmp_path)) == "mine"


def test_whoever_diverged_at_once_has_no_picture(tmp_path, url, fake):
    fake.return_value.trajectories[0].q[:] = np.nan
    assert not make(url, tmp_path).best_trial.system_attrs
    assert not list((tmp_path / "artifacts").iterdir())


def test_a_place_that_cannot_be_written_is_one_line(tmp_path, url, fake):
    (tmp_path / "artifacts").touch()
    with refused("out: .* a place that can be written"):
        make(url, tmp_path)


def test_the_real_one_repeats_it(tmp_path, url, monkeypatch):
    walks = []
    monkeypatch.setattr(artifacts, "write_strip", lambda _, *made: walks.append(made))
    study = make(url, tmp_path)
    ((trajectory, terrain, title, _),) = walks
    gains = named_gains("best", study.best_params)
    (again,) = recorded_walk(gains, TINY, 0, 50.0).trajectories
    np.testing.assert_array_equal(trajectory.q, again.q)
    assert np.isfinite(trajectory.q).all() and len(trajectory.time_s) > 5
    assert trajectory.time_s[1] - trajectory.time_s[0] == pytest.approx(0.02)
    assert terrain is TINY.terrain(0) and title.startswith("tiny, run 0: ")
