"""Features of a store's rows, and the sampler that uses them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from storage.store import Store, open_store
from study.experiment import features
from study.experiment.arms import ARMS
from study.experiment.features import Survival, feature_values
from study.experiment.stores import candidates
from taichi_nmm.errors import InputError
from tests.study import fake_walker

# A third of the fake's points falls sooner.
STRICT = {"settings": 1, "min_survival_s": 2.8, "body": {"disturbance": 0.15}}


def write(folder: Path, families: tuple[str, ...]) -> Store:
    fake_walker.write_store(folder, robust={}, families=dict.fromkeys(families, STRICT))
    return open_store(folder)


def test_survival_is_the_mean_over_the_families_of_a_store(fake_simulator, tmp_path):
    store = write(tmp_path / "store", ("up", "down"))
    names = [f"{name}_survived_fraction_mean" for name in ("up", "down")]
    up, down = (store.table()[name].to_numpy() for name in names)
    assert_allclose(feature_values(Survival(), store), (up + down) / 2)
    assert_array_equal(feature_values(Survival(("up",)), store), up)


@pytest.mark.filterwarnings("error:FeatureTable")
def test_rows_that_no_family_ran_are_left_out(comparisons):
    store = write(comparisons.folder / "strict", features.FAMILIES)
    ran = store.table()["rough_evaluated"].to_numpy()
    assert 30 < ran.sum() < len(store) - 30
    survivors = replace(Survival(features.FAMILIES), survivors=True)
    everyone = feature_values(Survival(features.FAMILIES), store)
    assert_array_equal(feature_values(survivors, store), np.where(ran, everyone, np.nan))
    stores = dict.fromkeys(comparisons.experiment.stores, store.path)
    experiment = replace(comparisons.experiment, stores=stores)
    table = candidates(experiment, "diverse", ARMS["best"].features)
    assert_array_equal(table.rows.offered, ran)
    comparisons.run("out", experiment=experiment, arms=("best",), runs=2, trials=20)
    assert ran[comparisons.table("out")["row"].to_numpy()].all()


@pytest.mark.parametrize(("feature", "column"), [
    (Survival(), "robust_survived_fraction_mean"),
    (Survival(("up", "rough")), "rough_survived_fraction_mean"),
    (Survival(("rough",), survivors=True), "rough_survived_fraction_mean"),
    ("phi_reprinted", "phi_reprinted"),
])  # fmt: skip
def test_a_store_without_what_a_feature_needs(feature, column, fake_simulator, tmp_path):
    store = write(tmp_path / "store", () if feature == Survival() else ("up",))
    features.check_feature("mean_speed_mps", store)
    assert feature_values("mean_speed_mps", store).shape == (len(store),)
    with pytest.raises(InputError) as caught:
        features.check_feature(feature, store)
    assert str(caught.value).endswith(f"a store with the column {column}")


# The arms of the comparisons.
def test_the_best_arm_is_what_its_definition_says():
    assert ARMS["best"].definition["options"] == features.OPTIONS
    each = [[name, name, "survivors only"] for name in features.FAMILIES]
    expected = [["survival", *features.FAMILIES, "survivors only"], *each, "mean_speed_mps"]
    assert ARMS["best"].definition["features"] == expected


@pytest.mark.parametrize(("cost", "walker", "faller"), [
    ("smooth", 1 / 101 + 0.3 / 121 + 0.001, 1 / 11 + 0.3 / 13 + 0.001), ("walking", 15.0, 288.0),
])  # fmt: skip
def test_costs_in_worlds_are_those_of_a_trial(cost, walker, faller):
    given = {
        "survived_fraction": np.array([[1.0, 0.5, np.nan]]),
        "mean_speed_mps": np.array([[1.2, 1.2, np.nan]]),
        "cost_of_transport_jpkgpm": np.array([[5.0, 9.0, np.nan]]),
    }
    found = features.COSTS[cost](given, 20.0)  # who lasts 20 s is taken to last 100 s
    assert_allclose(found, [[walker, faller, np.nan]])


def test_worlds_count_in_the_units_of_the_experiments_cost(fake_simulator, tmp_path):
    experiment = fake_walker.experiment(tmp_path)
    tables = {
        cost: candidates(replace(experiment, cost=cost), "worlds", ARMS["worlds"].features)
        for cost in ("smooth", "walking")
    }
    costs = {cost: table.rows.worlds.costs for cost, table in tables.items()}
    assert np.nanmax(costs["smooth"]) < 2.0 < 200.0 < np.nanmax(costs["walking"])
