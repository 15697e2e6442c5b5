"""Gains by name, from a store's row and from finished trials, with every low-level gain."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import optuna
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

import taichi_nmm
from storage.databases.studies import open_studies
from storage.store import open_store
from study.experiment.arms import find_arm
from study.experiment.compare import Request, compare
from study.experiment.experiment import check_store
from study.experiment.gains import (
    SPEED_TOLERANCE_MPS,
    gains_of_row,
    gains_of_source,
    gains_of_trial,
    row_at_speed,
)
from study.experiment.live_study import run_study
from taichi_nmm.parameters import (
    GAIN_NAMES,
    LOW_LEVEL_GAINS,
    LOW_LEVEL_NAMES,
    PUBLISHED_GAINS,
)
from taichi_nmm.result import ENERGY, OF_MUSCLES
from tests.cases import refused
from tests.study import fake_walker

DEFAULTS = [parameter.default for parameter in LOW_LEVEL_GAINS]
LIVE, BESIDE, OTHER = (
    "sqlite:///live.db",
    "sqlite:///out/studies.db",
    "sqlite:///other.db",
)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The toy experiment with a seventeenth parameter: its store, a comparison, a live study."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
        toy = fake_walker.experiment(folder, 'searched = ["theta_ref"]')
        request = Request(folder / "out", arms=("dog", "random"), runs=2, trials=3)
        compare(toy, request, lambda progress: None)
        dotted = Request(folder / "dots", arms=("random",), runs=1, trials=1)
        compare(replace(toy, name="rough-8.5_b"), dotted, lambda progress: None)
        storage = open_studies(f"sqlite:///{folder}/live.db")
        # a fourth, which nobody finishes
        run_study(toy, find_arm("dog"), 1, 3, storage).ask()
        storage.engine.dispose()
    other = optuna.create_study(
        study_name="other", storage=f"sqlite:///{folder}/other.db"
    )
    other.optimize(lambda trial: trial.suggest_float("x", 0, 1), 1)
    (folder / "empty").mkdir()
    (folder / "text.db").write_text(
        "no database, but long enough to have a header of its own"
    )
    return folder


@pytest.fixture
def here(made, monkeypatch):
    """The current folder."""
    monkeypatch.chdir(made)
    return made


def test_gains_by_name_and_of_a_file(tmp_path):
    named = gains_of_source("published")
    assert named.name == "published"
    np.testing.assert_array_equal(named.gains, PUBLISHED_GAINS)
    np.testing.assert_array_equal(named.low_level, DEFAULTS)
    file = tmp_path / "mine.json"
    file.write_text(json.dumps(named.as_document() | {"theta_ref": 0.2}))
    mine = gains_of_source(str(file))
    assert mine.name == "mine"
    assert mine.low_level.tolist() == [*DEFAULTS[:7], 0.2, *DEFAULTS[8:]]
    published = dict(zip(GAIN_NAMES, PUBLISHED_GAINS, strict=True))
    assert mine.as_document() == published | {"theta_ref": 0.2}
    with refused(r"gains: 'nobody'"):
        gains_of_source("nobody")


def test_a_row_of_a_store(here, store):
    rows = open_store(store).points()
    for row in (0, 17, 199):
        found = gains_of_row(store, row)
        np.testing.assert_array_equal(found.gains, rows[row])
        np.testing.assert_array_equal(found.low_level, DEFAULTS)
        assert found.name == f"plain-store-row-{row}"
        assert list(found.as_document()) == list(GAIN_NAMES)
    found = gains_of_row(Path("store"), 7)  # of seventeen parameters
    row_7 = open_store("store").points()[7]
    np.testing.assert_array_equal([*found.gains, found.low_level[7]], row_7)
    assert found.as_document()["theta_ref"] == row_7[16] != DEFAULTS[7]


def test_an_experiment_may_have_dots_in_its_name(here):
    found = gains_of_trial("rough-8.5_b/random/run-000/0", "dots")
    assert found.name == "rough-8.5_b-random-run-000-0"


MALFORMED = (
    "",
    "12",
    "toy/dog/run-001",
    "toy/dog/run-001/",
    "toy/dog/run-001/-1",
    "/3",
    "a/1.5",
)
FORM = "EXPERIMENT/ARM/run-NNN/NUMBER, such as"
TRIAL = "toy/dog/run-001/2"
NOT_IN_THE_FOLDER = (
    "toy/cat/run-001/2",
    "toy/dog/run-007/2",
    "toy/dog/run-001/3",
    "boy/dog/run-001/2",
    f"toy/dog/run-001/{10**30}",
    "toy/dog/2",
    "dog/2",
    "toy/dog/run-x/2",
    "a/b/c/d/2",
)


@pytest.mark.parametrize(
    ("trial", "where", "message"),
    [
        *(
            (trial, "sqlite:///none.db", f"trial: '{trial}' .* {FORM}")
            for trial in MALFORMED
        ),
        *(
            (
                trial,
                "out",
                rf"trial: '{trial}' .* a finished trial of .*trials\.parquet: {FORM}",
            )
            for trial in NOT_IN_THE_FOLDER
        ),
        ("toy/cat/run-001/2", LIVE, "trial: 'toy/cat/run-001/2' .* a study of"),
        ("toy/dog/run-000/2", LIVE, "trial: 'toy/dog/run-000/2' .* a study of"),
        (
            "toy/dog/run-001/3",
            LIVE,
            "trial: .* a finished trial of",
        ),  # which is running
        *(
            (f"toy/dog/run-001/{n}", LIVE, "trial: .* a finished trial of")
            for n in (4, 10**30)
        ),
        ("other/0", OTHER, "K_GAS"),  # by what it lacks
        (
            TRIAL,
            "sqlite:///none.db",
            "storage: .* a database that is there, or a comparison's",
        ),
        (TRIAL, "nowhere", "storage"),
        (TRIAL, "empty", "storage: .* a comparison's folder, with trials.parquet"),
        (TRIAL, "sqlite:///text.db", "text.db"),
    ],
)
def test_no_such_trial(trial, where, message, here):
    before = sorted(here.iterdir())
    with refused(message):
        gains_of_trial(trial, where)
    assert sorted(here.iterdir()) == before


@pytest.mark.parametrize("lacking", ["experiment", "trial", ""])
def test_a_table_without_a_column_or_without_any(here, tmp_path, lacking):
    path = shutil.copytree(here / "out", tmp_path / "out") / "trials.parquet"
    if lacking:
        pq.write_table(pq.read_table(path).drop_columns([lacking]), path)
    else:
        path.write_text("no table")
    with refused(rf".*trials\.parquet.*{lacking}"):
        gains_of_trial("toy/dog/run-001/1", str(tmp_path / "out"))


def test_the_row_of_a_speed_is_the_one_of_least_energy(store, toy):
    """On level ground; in a store with families, in all worlds of the one that runs longest."""
    names = ("survived_fraction", "mean_speed_mps", ENERGY, OF_MUSCLES)
    lasted, speed, energy, muscles = (
        open_store(store).numpy([name])[name] for name in names
    )
    wanted = float(np.median(speed[lasted >= 1.0]))
    row = row_at_speed(store, wanted)
    near = (lasted >= 1.0) & (np.abs(speed - wanted) <= SPEED_TOLERANCE_MPS)
    assert near[row] and energy[row] == energy[near].min() and near.sum() > 1
    other = row_at_speed(store, wanted, OF_MUSCLES)  # by name
    assert near[other] and muscles[other] == muscles[near].min() and other != row
    with refused(
        r"^least: 'hip_torque_peak_nm' .* a column of each world of .*plain-store"
    ):
        row_at_speed(store, wanted, "hip_torque_peak_nm")
    with refused(r"^speed: 9\.0 .* a row of .* that lasts: \d\.\d\d to "):
        row_at_speed(store, 9.0)
    robust = open_store(toy.stores["worlds"])
    kept = robust.outcomes("robust", "survived_fraction") >= 1.0
    speeds = robust.outcomes("robust", "mean_speed_mps").mean(axis=1)
    wanted = float(np.median(speeds[kept.all(axis=1)]))
    row = row_at_speed(toy.stores["worlds"], wanted)
    assert kept[row].all() and abs(speeds[row] - wanted) <= SPEED_TOLERANCE_MPS


def test_where_gains_are_fixed_rows_and_trials_have_them(fake_simulator, tmp_path):
    """An exoskeleton alone is searched: in a store, in a comparison and in a live study."""
    searched = 'fixed_gains = "published"\nsearched = ["exo_torque", "exo_peak"]\n'
    data = {
        "samples": 64,
        "seed": 3,
        "fixed_gains": "published",
        "families": {
            "rough": {
                "settings": 2,
                "min_survival_s": 0.5,
                "body": {"disturbance": 0.1},
            }
        },
        "searched": ["exo_torque", "exo_peak"],
    }
    fake_walker.fill(tmp_path / "store", data)
    toy = fake_walker.experiment(tmp_path, searched)
    assert toy.names == ("exo_torque", "exo_peak") and toy.fixed == tuple(
        PUBLISHED_GAINS
    )
    found = compare(
        toy,
        Request(tmp_path / "out", arms=("worlds", "tpe"), runs=2, trials=4),
        lambda progress: None,
    ).trials
    row = found.filter(pc.equal(found["arm"], "worlds")).slice(3, 1).to_pylist()[0]
    assert [row[name] for name in GAIN_NAMES] == PUBLISHED_GAINS.tolist()
    url = f"sqlite:///{tmp_path}/live.db"
    storage = open_studies(url)
    live = run_study(toy, find_arm("worlds"), 0, 4, storage)
    assert set(live.best_params) == set(toy.names)
    storage.engine.dispose()
    for where in (str(tmp_path / "out"), url):
        gains = gains_of_trial("toy/worlds/run-000/3", where)
        assert gains.gains.tolist() == PUBLISHED_GAINS.tolist()
        assert gains.low_level[8:10].tolist() == [row["exo_torque"], row["exo_peak"]]
    stored = gains_of_row(tmp_path / "store", 5)
    assert (
        stored.gains.tolist() == PUBLISHED_GAINS.tolist() and stored.low_level[8] > 0.0
    )
    other = replace(toy, fixed=(), searched=("exo_torque", "exo_peak"))
    with refused(r"stores\.worlds: .*store without K_GAS"):
        check_store(other, "worlds")
    with refused(r"stores\.worlds: .* a store of the same fixed gains"):
        check_store(replace(toy, fixed=(1.0, *toy.fixed[1:])), "worlds")


def test_a_store_of_equal_legs_serves_a_search_of_gains_by_side(
    fake_simulator, tmp_path
):
    """Rows have no asymmetry; points near good trials have some, and so have their walks."""
    searched = ["K_SOL_asymmetry", "exo_torque"]
    toy = fake_walker.experiment(tmp_path, f"searched = {json.dumps(searched)}\n")
    fake_walker.calls.clear()
    found = compare(
        toy,
        Request(tmp_path / "out", arms=("worlds", "bo-ranking"), runs=2, trials=8),
        lambda progress: None,
    ).trials.to_pandas()
    first = found[found.trial < 1]
    assert (first.row >= 0).all() and not first[searched].to_numpy().any()
    ours = found[(found.arm == "worlds") & (found.row < 0)]
    assert (ours[searched] != 0.0).any().all() and (
        ours.K_SOL_asymmetry.abs() <= 0.5
    ).all()
    places = [LOW_LEVEL_NAMES.index(name) for name in searched]
    walked = np.concatenate(
        [call["low_level_gains"][:, places] for call in fake_walker.calls]
    )
    assert {tuple(row) for row in found[searched].to_numpy()} == {
        tuple(row) for row in walked
    }
