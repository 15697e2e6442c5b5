"""Gains by name, from a store's row and from finished trials, with every low-level gain."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import optuna
import pyarrow.parquet as pq
import pytest

from storage.databases.studies import open_studies
from storage.store import open_store
from study.comparison.compare import Request, compare
from study.experiment.arms import find_arm
from study.experiment.experiment import Experiment
from study.experiment.live_study import run_study
from study.gains import gains_of_row, gains_of_source, gains_of_trial
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, LOW_LEVEL_GAINS, PUBLISHED_GAINS, load_all_gains
from tests.study import fake_walker

DEFAULTS = [parameter.default for parameter in LOW_LEVEL_GAINS]
TORSO = 'searched = ["theta_ref"]'


@pytest.fixture
def torso(fake_simulator: None, tmp_path: Path) -> Experiment:
    """The toy experiment with a seventeenth parameter."""
    return fake_walker.experiment(tmp_path, TORSO)


@pytest.fixture
def database(torso: Experiment, tmp_path: Path) -> str:
    """Of a live study of three trials, and a fourth that nobody has finished."""
    url = f"sqlite:///{tmp_path}/studies.db"
    run_study(torso, find_arm("dog"), 1, 3, open_studies(url)).ask()
    return url


@pytest.fixture
def folder(torso: Experiment, tmp_path: Path) -> Path:
    """Of a comparison, with its own database."""
    request = Request(tmp_path / "out", arms=("dog", "random"), runs=2, trials=3, artifacts=False)
    compare(torso, request, lambda progress: None)
    return tmp_path / "out"


def one_line(message: str) -> pytest.RaisesExc[InputError]:
    return pytest.raises(InputError, match=message, check=lambda error: "\n" not in str(error))


def test_gains_by_name_and_of_a_file(tmp_path: Path) -> None:
    named = gains_of_source("published")
    assert named.name == "published"
    np.testing.assert_array_equal(named.gains, PUBLISHED_GAINS)
    np.testing.assert_array_equal(named.low_level, DEFAULTS)
    file = tmp_path / "mine.json"
    file.write_text(json.dumps(named.as_document() | {"theta_ref": 0.2}))
    mine = gains_of_source(str(file))
    assert mine.name == "mine"
    assert mine.low_level.tolist() == [*DEFAULTS[:7], 0.2]
    assert mine.as_document() == dict(zip(GAIN_NAMES, PUBLISHED_GAINS, strict=True)) | {
        "theta_ref": 0.2
    }
    with one_line(r"gains: 'nobody'"):
        gains_of_source("nobody")


def test_a_row_of_a_store(store: Path) -> None:
    rows = open_store(store).gains()
    for row in (0, 17, 199):
        found = gains_of_row(store, row)
        np.testing.assert_array_equal(found.gains, rows[row])
        np.testing.assert_array_equal(found.low_level, DEFAULTS)
        assert found.name == f"plain-store-row-{row}"
        assert list(found.as_document()) == list(GAIN_NAMES)


def test_a_row_of_a_store_of_seventeen_parameters(torso: Experiment) -> None:
    found = gains_of_row(torso.stores["flat"], 7)
    row = open_store(torso.stores["flat"]).gains()[7]
    np.testing.assert_array_equal([*found.gains, found.low_level[7]], row)
    assert found.as_document()["theta_ref"] == row[16] != DEFAULTS[7]


@pytest.mark.parametrize("row", [-1, 200, 10**9])
def test_a_row_out_of_range(store: Path, row: int) -> None:
    with one_line(rf"row: {row} .* 0 to 199, the rows of .*plain-store"):
        gains_of_row(store, row)


def test_no_store(tmp_path: Path) -> None:
    with one_line("nowhere"):
        gains_of_row(tmp_path / "nowhere", 0)
    (tmp_path / "empty").mkdir()
    with one_line("a finished store"):
        gains_of_row(tmp_path / "empty", 0)


def test_a_trial_of_a_live_study_and_of_a_comparison_are_the_same(
    database: str, folder: Path
) -> None:
    """Of its table, and of its database: all 17 parameters, to the bit."""
    row = pq.read_table(folder / "trials.parquet").to_pandas()
    row = row[(row.arm == "dog") & (row.run == 1) & (row.trial == 2)].iloc[0]
    for where in (database, str(folder), f"sqlite:///{folder}/studies.db"):
        found = gains_of_trial("toy/dog/run-001/2", where)
        assert found.name == "toy-dog-run-001-2"
        assert found.gains.tolist() == [row[name] for name in GAIN_NAMES]
        assert found.low_level.tolist() == [*DEFAULTS[:7], row.theta_ref]


def test_what_is_found_can_be_written_and_read(folder: Path, tmp_path: Path) -> None:
    found = gains_of_trial("toy/random/run-000/1", str(folder))
    file = tmp_path / "found.json"
    file.write_text(json.dumps(found.as_document()))
    gains, low_level = load_all_gains(str(file))
    np.testing.assert_array_equal(gains, found.gains)
    np.testing.assert_array_equal(low_level, found.low_level)


@pytest.mark.parametrize(
    "trial", ["", "12", "toy/dog/run-001", "toy/dog/run-001/", "toy/dog/run-001/-1", "/3", "a/1.5"]
)
def test_a_malformed_trial(trial: str, tmp_path: Path) -> None:
    with one_line(rf"trial: '{trial}' .* EXPERIMENT/ARM/run-NNN/NUMBER, such as"):
        gains_of_trial(trial, f"sqlite:///{tmp_path}/none.db")
    assert not (tmp_path / "none.db").exists()


@pytest.mark.parametrize(
    ("trial", "message"),
    [
        ("toy/cat/run-001/2", "a study of"),
        ("toy/dog/run-000/2", "a study of"),
        ("toy/dog/run-001/3", "a finished trial of"),  # which is running
        ("toy/dog/run-001/4", "a finished trial of"),
    ],
)
def test_a_trial_that_the_database_does_not_have(trial: str, message: str, database: str) -> None:
    with one_line(rf"trial: '{trial}' .* {message}"):
        gains_of_trial(trial, database)


@pytest.mark.parametrize(
    "trial",
    ["toy/cat/run-001/2", "toy/dog/run-007/2", "toy/dog/run-001/3", "boy/dog/run-001/2",
     "toy/dog/2", "dog/2", "toy/dog/run-x/2", "a/b/c/d/2"],
)  # fmt: skip
def test_a_trial_that_the_folder_does_not_have(trial: str, folder: Path) -> None:
    with one_line(rf"trial: '{trial}' .* a finished trial of .*trials\.parquet: EXPERIMENT/ARM"):
        gains_of_trial(trial, str(folder))


def test_a_missing_database_is_not_made(tmp_path: Path) -> None:
    with one_line("storage: .* a database that is there, or a comparison's folder"):
        gains_of_trial("toy/dog/run-001/2", f"sqlite:///{tmp_path}/none.db")
    with one_line("storage"):
        gains_of_trial("toy/dog/run-001/2", str(tmp_path / "nowhere"))
    assert not list(tmp_path.iterdir())


def test_a_folder_without_results(torso: Experiment, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with one_line("storage: .* a comparison's folder, with trials.parquet"):
        gains_of_trial("toy/dog/run-001/2", str(tmp_path / "out"))


def test_something_else_in_place_of_a_database_or_a_table(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "text.db").write_text("no database, but long enough to have a header of its own")
    with one_line("text.db"):
        gains_of_trial("toy/dog/run-001/2", f"sqlite:///{tmp_path}/text.db")
    (folder / "trials.parquet").write_text("no table")
    with one_line(r"trials\.parquet"):
        gains_of_trial("toy/dog/run-001/2", str(folder))


def test_trials_of_other_studies_are_refused_by_what_they_lack(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/studies.db"
    study = optuna.create_study(study_name="other", storage=open_studies(url))
    study.optimize(lambda trial: trial.suggest_float("x", 0, 1), 1)
    with one_line("K_GAS"):
        gains_of_trial("other/0", url)


def test_an_experiments_name_may_hold_dots(torso: Experiment, tmp_path: Path) -> None:
    named = replace(torso, name="rough-8.5_b")
    request = Request(tmp_path / "out", arms=("random",), runs=1, trials=1, artifacts=False)
    compare(named, request, lambda progress: None)
    found = gains_of_trial("rough-8.5_b/random/run-000/0", str(tmp_path / "out"))
    assert found.name == "rough-8.5_b-random-run-000-0"


@pytest.mark.parametrize("column", ["experiment", "trial"])
def test_a_table_without_a_column(folder: Path, column: str) -> None:
    path = folder / "trials.parquet"
    pq.write_table(pq.read_table(path).drop_columns([column]), path)
    with one_line(rf"storage: .*trials\.parquet.*{column}"):
        gains_of_trial("toy/dog/run-001/1", str(folder))


def test_a_database_that_gains_come_from_stays_as_it_is(torso: Experiment, tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/studies.db"
    storage = open_studies(url)
    run_study(torso, find_arm("random"), 0, 1, storage)
    storage.engine.dispose()
    before = {path.name: path.read_bytes() for path in tmp_path.glob("studies.db*")}
    assert gains_of_trial("toy/random/run-000/0", url).name == "toy-random-run-000-0"
    assert {path.name: path.read_bytes() for path in tmp_path.glob("studies.db*")} == before
