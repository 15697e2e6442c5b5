"""Pictures of the best trials, as Optuna and its dashboard find them."""

import json
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pyarrow as pa
import pytest
from optuna.artifacts import FileSystemArtifactStore, get_all_artifact_meta, upload_artifact
from optuna_dashboard import get_note, save_note

from storage.databases.studies import open_studies
from storage.pool import IN_PROCESS, Pool, local_pool
from study.experiment import artifacts
from study.experiment.artifacts import Drawing, best_walks, draw, make_artifacts
from study.experiment.database import export
from study.experiment.folder import gains_of
from taichi_nmm.result import Result
from tests.study import synthetic_gait
from tests.study.conftest import refused
from tests.study.experiment.fake_results import experiment, results

pytestmark = pytest.mark.slow

TINY = experiment()
GLIMPSE = synthetic_gait.walk(0.3, 50.0)
STUDIES = ("tiny/dog/run-000", "tiny/dog/run-001", "tiny/random/run-000", "tiny/random/run-001")


class Fake:
    """Stands for the simulator, and remembers what it was asked for."""

    def __init__(self) -> None:
        self.runs: list[list[int]] = []
        self.gains: list[np.ndarray] = []
        self.options: list[dict[str, Any]] = []
        self.walks = (GLIMPSE,) * 100

    def __call__(self, of: Any, runs: list[int], gains: np.ndarray, **options: Any) -> Result:
        self.runs.append(list(runs))
        self.gains.append(gains)
        self.options.append(options)
        return Result(np.zeros(0), self.walks[: len(runs)])


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Fake:
    fake = Fake()
    monkeypatch.setattr(artifacts, "simulate_trials", fake)
    return fake


@pytest.fixture
def url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path}/studies.db"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder and database of a finished experiment with its pictures, to look at only."""
    folder = tmp_path_factory.mktemp("made")
    url = f"sqlite:///{folder}/studies.db"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(artifacts, "simulate_trials", Fake())
        assert make(results(TINY), url, folder) == [(done, 4) for done in range(5)]
    return folder, url


def make(table: pa.Table, url: str, out: Path, pool: Pool = IN_PROCESS) -> list[tuple[int, int]]:
    told: list[tuple[int, int]] = []
    export(TINY, table, url, None, final=True)
    make_artifacts(TINY, table, url, out, pool, lambda *done: told.append(done))
    return told


def load(url: str, name: str = STUDIES[0]) -> optuna.Study:
    return optuna.load_study(study_name=name, storage=open_studies(url))


def best_note(study: optuna.Study) -> str:
    return str(get_note(optuna.trial.Trial(study, study.best_trial._trial_id)))


def found(url: str, name: str, number: int) -> dict[str, Any]:
    """The artifacts of a trial by file name, as Optuna lists them."""
    study = load(url, name)
    metas = get_all_artifact_meta(study.trials[number], storage=study._storage)
    assert len({meta.filename for meta in metas}) == len(metas)
    return {meta.filename: meta for meta in metas}


def test_the_best_trial_of_each_study_gets_a_picture(made: tuple[Path, str]) -> None:
    folder, url = made
    store = FileSystemArtifactStore(folder / "artifacts")
    for name in STUDIES:
        best = load(url, name).best_trial.number
        metas = found(url, name, best)
        assert {key: meta.mimetype for key, meta in metas.items()} == {"strip.png": "image/png"}
        with store.open_reader(metas["strip.png"].artifact_id) as file:
            assert file.read(4) == b"\x89PNG"
        assert not found(url, name, (best + 1) % 3)
    assert len(list((folder / "artifacts").iterdir())) == 4


def test_they_are_registered_and_noted(made: tuple[Path, str], tmp_path: Path) -> None:
    study, file = load(made[1]), tmp_path / "strip.png"
    file.touch()
    trial, store = study.ask(), FileSystemArtifactStore(tmp_path)
    upload_artifact(artifact_store=store, file_path=str(file), study_or_trial=trial)
    (theirs,) = study.trials[trial.number].system_attrs.values()
    attributes = study.best_trial.system_attrs.items()
    ((key, ours),) = [(key, value) for key, value in attributes if "png" in value]
    assert isinstance(ours, str) and isinstance(theirs, str)
    assert list(json.loads(ours)) == list(json.loads(theirs))
    drop = {"artifact_id": ""}
    assert json.loads(ours) | drop == json.loads(theirs) | drop
    assert key == f"artifacts:{json.loads(ours)['artifact_id']}"
    study = load(made[1])
    identity = found(made[1], STUDIES[0], study.best_trial.number)["strip.png"].artifact_id
    path = f"/artifacts/{study._study_id}/{study.best_trial._trial_id}/{identity}"
    note = best_note(study)
    assert note.startswith("tiny, run 0: walked 2.0 s, 2.0 m at 0.50 m/s\n")
    assert note.endswith(f"({path})")


def test_a_note_of_the_users_stays_and_one_that_a_kill_left_out_is_made_up_for(
    tmp_path: Path, url: str, fake: Fake, monkeypatch: pytest.MonkeyPatch
) -> None:
    export(TINY, results(TINY), url, None, final=True)
    first, second = load(url), load(url, STUDIES[1])
    save_note(optuna.trial.Trial(first, first.best_trial._trial_id), "mine")

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(artifacts, "_note", interrupt)
        make(results(TINY), url, tmp_path)
    assert not best_note(second)
    make(results(TINY), url, tmp_path)
    assert best_note(first) == "mine" and best_note(second)
    assert len(found(url, STUDIES[0], first.best_trial.number)) == 1


def test_the_best_is_the_first_of_the_cheapest_and_equal_ones_are_shared() -> None:
    walks = best_walks(TINY, results(TINY))
    assert [walk.run for walk in walks] == [0, 1, 0, 1]
    assert walks[0].trials == (("tiny/dog/run-000", 1),)
    random = results(TINY, arms=("abc", "two"))  # whose gains are equal, as their names are long
    walks = best_walks(TINY, random)
    assert [walk.trials for walk in walks] == [
        tuple((f"tiny/{arm}/run-00{run}", trial) for arm in ("abc", "two"))
        for run, trial in ((0, 2), (1, 1))
    ]
    places = [(row["run"], row["trial"]) for row in random.to_pylist()]
    np.testing.assert_array_equal(walks[1].gains, gains_of(TINY, random)[places.index((1, 1))])
    assert walks[1].title == "tiny, run 1: fell after 2.0 s, 2.0 m at 0.50 m/s"


def test_shared_files_are_drawn_once(tmp_path: Path, url: str, fake: Fake) -> None:
    make(results(TINY, arms=("abc", "two")), url, tmp_path)
    assert len(list((tmp_path / "artifacts").iterdir())) == 2
    assert found(url, "tiny/abc/run-001", 1) == found(url, "tiny/two/run-001", 1) != {}


def test_all_are_simulated_together_from_the_start(
    tmp_path: Path, url: str, fake: Fake, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(artifacts, "WALKS_PER_BATCH", 3)
    table = results(TINY)
    make(table, url, tmp_path)
    assert fake.runs == [[0, 1, 0], [1]]
    expected = np.array([walk.gains for walk in best_walks(TINY, table)])
    np.testing.assert_array_equal(np.vstack(fake.gains), expected)
    for options in fake.options:
        assert options["record"] is True and options["duration_s"] == TINY.conditions.duration_s


def test_what_is_there_is_kept_and_the_rest_is_made(tmp_path: Path, url: str, fake: Fake) -> None:
    table = results(TINY)
    make(table, url, tmp_path)
    files = sorted((tmp_path / "artifacts").iterdir())
    times = {file: file.stat().st_mtime_ns for file in files}
    files[0].unlink()
    (tmp_path / "artifacts" / ".x.1.tmp").touch()  # of a call that was killed
    assert make(table, url, tmp_path) == [(3, 4), (4, 4)]
    assert fake.runs[1:] == [[fake.runs[1][0]]]
    assert sorted((tmp_path / "artifacts").iterdir()) == files
    assert all(file.stat().st_mtime_ns == times[file] for file in files[1:])
    assert make(table, url, tmp_path) == [(4, 4)] and len(fake.runs) == 2
    another = f"sqlite:///{tmp_path}/another.db"  # a new database, the files as they are
    assert make(table, another, tmp_path) == [(4, 4)]
    assert set(found(another, STUDIES[0], 1)) == {"strip.png"}


def test_whoever_diverged_at_once_has_no_picture(tmp_path: Path, url: str, fake: Fake) -> None:
    lost = synthetic_gait.walk(0.1)
    lost.q[:] = np.nan
    fake.walks = (lost, GLIMPSE, GLIMPSE, GLIMPSE)
    make(results(TINY), url, tmp_path)
    assert not found(url, STUDIES[0], 1) and found(url, STUDIES[1], 1)


def test_several_processes_draw_the_same_files(tmp_path: Path, url: str, fake: Fake) -> None:
    table = results(TINY, runs=3, arms=("dog",))
    make(table, url, tmp_path / "one")
    with local_pool(2) as pool:
        make(table, url, tmp_path / "two", pool)
    one, two = (sorted((tmp_path / name / "artifacts").iterdir()) for name in ("one", "two"))
    assert len(one) == 3 and [file.name for file in one] == [file.name for file in two]
    assert [file.read_bytes() for file in one] == [file.read_bytes() for file in two]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_process_that_cannot_write_says_so_in_one_line(tmp_path: Path, workers: int) -> None:
    walk = best_walks(TINY, results(TINY))[0]
    drawing = Drawing(walk, GLIMPSE, TINY.terrain(0), tmp_path / "no")
    with local_pool(workers) as pool, refused("out: .* a place that can be written"):
        list(pool.results(draw, deque([drawing, drawing])))


def test_the_real_simulator_repeats_the_trial(
    tmp_path: Path, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawings: list[Drawing] = []
    monkeypatch.setattr(artifacts, "draw", lambda drawing: bool(drawings.append(drawing)))
    make(results(TINY, arms=("dog",), runs=1), url, tmp_path)
    (drawing,) = drawings
    assert np.isfinite(drawing.trajectory.q).all() and len(drawing.trajectory.time_s) > 5
    assert drawing.trajectory.time_s[1] - drawing.trajectory.time_s[0] == pytest.approx(0.02)
    assert drawing.terrain is TINY.terrain(0)
