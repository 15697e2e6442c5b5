"""What a store knows of its rows, as candidates of studies."""

import pickle
import re
import shutil
import warnings
from dataclasses import replace
from math import nan

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from storage import FunctionSimulator, make_store
from storage.store import open_store
from study.bench.plan import read_plan
from study.experiment.arms import ARMS, check_arms
from study.experiment.experiment import candidates
from study.experiment.features import world_table, worlds_function
from tests.cases import ASSETS, refused
from tests.storage import plants, robot
from tests.study import fake_walker


@pytest.mark.filterwarnings("error:FeatureTable")
def test_rows_that_no_family_ran_are_left_out_and_do_not_count(comparisons):
    # a third of the fake's points falls sooner
    strict = {"settings": 1, "min_survival_s": 2.8}
    families = dict.fromkeys(("rough", "up"), strict)
    fake_walker.write_store(
        comparisons.folder / "strict", robust=strict, families=families
    )
    store = open_store(comparisons.folder / "strict")
    ran = store.table()["rough_evaluated"].to_numpy()
    count = int(ran.sum())
    assert 30 < count < len(store) - 30
    experiment = replace(comparisons.experiment, stores={"worlds": store.path})
    for arm in ("worlds", "ranking"):
        table = candidates(experiment, "worlds", ARMS[arm].feature)
        assert_array_equal(table.rows.offered, ran)
        comparisons.run(arm, experiment=experiment, arms=(arm,), runs=2, trials=20)
        rows = comparisons.table(arm)["row"].to_numpy()
        assert ran[rows[rows >= 0]].all()  # others are between rows
        with refused(
            f"trials: {count + 1} .* at most {count}, the rows that {arm} may"
        ):
            check_arms(experiment, (arm,), count + 1)


HOT = {"settings": 3, "min_survival_s": 0.0, "world": {"heat_k": [300.0, 320.0]}}


def battery(folder, **changes):
    """A store of the battery; its hot worlds run most of the rows, its cold ones few of them."""
    configuration = {
        "samples": 64,
        "simulation": {"duration_s": 5400.0},
        "families": {"hot": HOT, "cold": HOT | {"world": {"heat_k": 270.0}}},
    }
    make_store(plants.Battery, folder / "store", workers=1, **configuration | changes)
    return folder / "store"


def test_a_cost_has_what_each_world_gave_of_every_column(tmp_path):
    path, seen = battery(tmp_path), {}

    def cost(given, horizon_s):
        seen.update(given)
        assert horizon_s == 5400.0 and "no_column" not in given
        return given["loss_j"] + given["current_a"]

    table, store = world_table(path, cost), open_store(path)
    assert list(seen) == [*plants.Battery.columns.names[:-1], *plants.PARAMETERS]
    assert {values.shape for values in seen.values()} == {(64, 3)}
    assert_array_equal(seen["current_a"], np.tile(store.points()[:, :1], 3))
    heats = store.specification["families"]["hot"]["drawn"]["heat_k"]
    for row, gains in enumerate(store.points().tolist()):
        point = dict(zip(plants.PARAMETERS, gains, strict=True))
        runs = [
            plants.charge(point, {"heat_k": heat, "seed": 0}, 5400.0) for heat in heats
        ]
        for column in plants.COLUMNS:
            found = store.outcomes("hot", column)[row]
            expected = [run[column] for run in runs]
            if column == "survived_fraction":  # a sum of steps that is not quite 1 is 1
                expected = [round(share, 9) for share in expected]
            assert found.tolist() == expected  # else not a bit is lost
    assert seen["finished_at_s"].min() > 2.0**30  # beyond the whole numbers of float32
    hot = [name.startswith("hot") for name in table.rows.worlds.names]
    assert_array_equal(
        table.rows.worlds.costs[:, hot], seen["loss_j"] + seen["current_a"]
    )


@pytest.mark.parametrize("kept", [[], ["loss_j"]])
def test_a_cost_of_what_no_world_keeps_is_refused_with_the_key(tmp_path, kept):
    path = battery(tmp_path, kept=kept)
    assert open_store(path).kept("cold") == ("survived_fraction", *kept)
    with refused(
        "^cost: 'finished_at_s' .* or what the worlds .*kept = ..finished_at_s"
    ) as error:
        world_table(path, lambda given, horizon_s: given["finished_at_s"])
    assert len(str(error.value)) < 500
    with refused("^cost: 'finished_at_s' "):
        world_table(path, lambda given, horizon_s: given.get("finished_at_s", 0.0))
    for none in ("no_column", "run_ended", "row", "hot_loss_j_mean"):
        with refused(f"^cost: '{none}' .* keep: survived_fraction[^;]*$"):
            world_table(path, lambda given, _, none=none: given[none])


def test_rows_that_did_not_run_stay_out_whatever_a_cost_makes_of_them(tmp_path):
    some = {"settings": 2, "world": {"heat_k": 300.0}, "min_survival_s": 5400.0}
    long = {"settings": 1, "after": "hot", "min_survived_fraction": 1.0}
    path = battery(tmp_path, families={"hot": some, "long": long})
    store = open_store(path)
    ran = store.numpy(["hot_evaluated"])["hot_evaluated"]
    assert 0 < ran.sum() < 64
    for cost in (
        lambda given, _: np.where(
            given["survived_fraction"] >= 1.0, given["loss_j"], 100.0
        ),
        lambda given, _: np.nan_to_num(given["loss_j"]),
        lambda given, _: np.ones(given["loss_j"].shape),
    ):
        assert_array_equal(world_table(path, cost).rows.offered, ran)
    with warnings.catch_warnings(action="error"), refused("gaps in all rows"):
        world_table(path, lambda given, _: np.nan * given["loss_j"])


@pytest.mark.parametrize(
    ("cost", "message"),
    [
        (lambda given, _: 1.0, r"^cost\.shape: \(\) .* \[64, 3\]"),
        (
            lambda given, _: given["loss_j"][:, :1],
            r"^cost\.shape: \(64, 1\) .* \[64, 3\]",
        ),
        (lambda given, _: given["loss_j"].mean(axis=1), r"^cost\.shape: \(64,\) "),
        (lambda given, _: None, r"^cost\.shape: \(\) "),
        (lambda given, _: "much", "^cost: 'str' .* numbers"),
    ],
)
def test_a_cost_of_another_shape_is_refused(tmp_path, cost, message):
    with refused(message):
        world_table(battery(tmp_path), cost)


def test_a_run_that_failed_has_no_number_that_is_cheap(tmp_path):
    """Zeros of a run that raised would be the least loss of all."""
    path = battery(
        tmp_path,
        families={
            "hot": {
                "settings": 2,
                "world": {"heat_k": [362.0, 366.0]},
                "min_survival_s": 0.0,
            }
        },
    )
    store = open_store(path)
    loss, lasted = (
        store.outcomes("hot", name) for name in ("loss_j", "survived_fraction")
    )
    burnt = np.isnan(loss).any(axis=1)
    assert 0 < burnt.sum() < 64 and (lasted[np.isnan(loss)] == 0.0).all()
    known = world_table(path, lambda given, _: given["loss_j"]).rows
    assert_array_equal(known.offered, ~burnt)
    priced = lambda given, _: np.where(  # noqa: E731
        given["survived_fraction"] >= 1.0, given["loss_j"], 1e9
    )
    assert world_table(path, priced).rows.offered.all()


class Packed(FunctionSimulator):
    outcome_type = np.float32


def test_a_number_too_large_for_its_type_is_no_infinity(tmp_path):
    """Infinity would be the best of all where values are maximised."""
    huge = Packed(plants.explode, parameters=plants.PARAMETERS, columns=plants.COLUMNS)
    hot = {"settings": 2, "min_survival_s": 0.0}
    make_store(huge, tmp_path / "store", workers=1, samples=16, families={"hot": hot})
    store = open_store(tmp_path / "store")
    loss, current = store.outcomes("hot", "loss_j"), store.points()[:, 0]
    assert loss.dtype == np.float32 and not np.isinf(loss).any()
    assert_array_equal(np.isnan(loss).all(axis=1), current > 10.0)


@pytest.mark.parametrize(
    ("changes", "lines"),
    [
        (
            {"horizon_s": 600.0},
            [r"families\.hot\.horizon_s: 0 of 64 rows lasted 600 s .* 0\.9 of it"],
        ),
        ({}, []),
    ],
)
def test_a_family_that_no_row_finished_is_warned_of(tmp_path, changes, lines):
    path = battery(tmp_path, families={"hot": HOT | changes})
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        world_table(path, lambda given, _: given["loss_j"])
    found = [str(each.message) for each in found if each.filename == __file__]
    bench = tmp_path / "bench.toml"
    bench.write_text('candidates = {store = "store", cost = "loss_j"}\ngoal = {}\n')
    assert found == read_plan(bench).cautions() and len(found) == len(lines)
    for line, expected in zip(found, lines, strict=True):
        assert re.search(expected, line)


def test_a_store_of_an_older_version_opens_with_what_its_worlds_kept(
    tmp_path, monkeypatch
):
    """0.3.0 kept how far a run came and the first other column, in float32, for 8 s."""
    path = ASSETS / "store-0.3.0"
    store = open_store(path, verify=True)
    assert store.kept("gale") == ("survived_fraction", "speed_mps") and len(store) == 24
    assert store.outcomes("gale", "speed_mps").dtype == np.float32
    with pytest.warns(
        UserWarning,
        match=r"gale\.horizon_s: 0 of 18 rows lasted 8 s .*the longest 0\.9",
    ):
        assert (
            world_table(path, lambda given, _: given["speed_mps"]).rows.offered.sum()
            == 18
        )
    half = shutil.copytree(path, tmp_path / "half")
    (half / "manifest.json").unlink()
    (half / "part-00001.parquet").unlink()
    assert len(open_store(half, unfinished=True)) == 16
    gale = {"settings": 2, "world": {"wind": [1.0, 3.0]}, "horizon_s": 8.0}
    version = store.specification["code_version"]  # as if its file were the same
    monkeypatch.setattr(type(robot.Cart), "code_version", version)
    with refused(
        r"^columns\.\d+: 'gale_.*: double.*' .* 'gale_.*: float.*; or another --out"
    ):
        make_store(
            robot.Cart,
            half,
            workers=1,
            samples=24,
            shard_rows=16,
            seed=3,
            families={"gale": gale},
        )
    assert len(open_store(half, unfinished=True)) == 16


CARTS = """
samples = 40
seed = 3
simulation.duration_s = 4.0

[families.gale]
settings = 3
min_survival_s = 3.0
world = {wind = [1.0, 3.0]}

[families.long]
settings = 2
after = "gale"
min_survived_fraction = 0.6
horizon_s = 6.0
world = {mass_kg = [1.0, 2.0]}
"""


@pytest.fixture(scope="module")
def carts(tmp_path_factory):
    """A store, and the configuration that it was computed by."""
    return robot.written_store(tmp_path_factory.mktemp("carts"), "asked_carts", CARTS)


def by_speed(given, horizon_s):
    return given["speed_mps"] + given["survived_fraction"]


@pytest.mark.filterwarnings("ignore:.* rows lasted")
@pytest.mark.parametrize(
    "costs", [(by_speed,), (by_speed, lambda given, _: -given["thrust_n"])]
)
def test_a_simulator_that_is_asked_says_what_its_store_says(carts, costs):
    path, config = carts
    table, simulate = world_table(path, *costs), worlds_function(path, config, *costs)
    parameters, worlds = table.rows.parameters, table.rows.worlds
    found = simulate(parameters)
    assert 0 < np.isnan(found).sum() < found.size  # rows that no family ran
    assert_array_equal(found, worlds.costs)
    assert_array_equal(simulate(parameters[7:8]), worlds.costs[7:8])


@pytest.mark.filterwarnings("ignore:.* rows lasted")
def test_a_simulator_that_is_asked_goes_to_another_process(carts):
    path, _ = carts
    table, simulate = world_table(path, by_speed), worlds_function(*carts, by_speed)
    again = pickle.loads(pickle.dumps(simulate))
    assert_array_equal(again(table.rows.parameters), simulate(table.rows.parameters))
    assert repr(simulate) == f"worlds_function({str(path)!r}, ...)"


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.ones((2, 3)), r"^points.shape: \(2, 3\) .* \[m, 4\]"),
        (np.ones(4), r"^points.shape: \(4,\) "),
        ([[1.0, nan, 1.0, 0.0]], "^points: 'NaN or infinity' .* finite"),
        (["fast"], r"^points\[0\]: 'fast' .* numbers"),
    ],
)
def test_points_that_are_none_are_not_simulated(carts, points, message):
    with refused(message):
        worlds_function(*carts, by_speed)(points)


def test_a_simulator_of_other_worlds_is_not_asked(carts):
    path, other = carts[0], carts[1].with_name("other.toml")
    own = carts[1].read_text()
    for changed, key in (
        (own.replace("3.0]}", "2.5]}"), "families"),
        (own.replace("duration_s = 4.0", "duration_s = 4.5"), "families"),
        (own.replace("seed = 3", "seed = 4"), "seed"),
    ):
        other.write_text(changed)
        with refused(rf"^config: .*other.toml.* with '{key}' as the store "):
            worlds_function(path, other, by_speed)
    other.write_text(own.replace("samples = 40", "samples = 90"))
    assert worlds_function(path, other, by_speed)  # other rows of the same worlds
    with refused("^config: .*"):
        worlds_function(path, other.with_name("none.toml"), by_speed)
    with refused("^cost: 'no_column' "):
        worlds_function(path, other, lambda given, _: given["no_column"])(
            np.ones((1, 4))
        )
