"""Features of a store's rows, and what the arms make of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from storage.store import Store, open_store
from study.experiment.arms import ARMS
from study.experiment.stores import candidates
from study.features import (
    FAMILIES,
    GROUNDS,
    LONGER,
    PLAINEST,
    Coverage,
    Feature,
    Survival,
    check_feature,
    earliness,
    feature_values,
    survivals,
)
from study.features import OPTIONS as BEST
from taichi_nmm.errors import InputError
from tests.study import fake_walker
from tests.study.conftest import Comparisons
from tests.study.fake_walker import WORLDS

# A third of the fake's points falls sooner.
STRICT = {"settings": 1, "min_survival_s": 2.8, "body": {"disturbance": 0.15}}


def write(folder: Path, families: tuple[str, ...]) -> Store:
    fake_walker.write_store(folder, robust={}, families=dict.fromkeys(families, STRICT))
    return open_store(folder)


def test_survival_is_the_mean_over_the_families_of_a_store(
    fake_simulator: None, tmp_path: Path
) -> None:
    store = write(tmp_path / "store", ("up", "down"))
    up, down = (
        store.table()[f"{name}_survived_fraction_mean"].to_numpy() for name in ("up", "down")
    )
    np.testing.assert_allclose(feature_values(Survival(), store), (up + down) / 2)
    np.testing.assert_array_equal(feature_values(Survival(("up",)), store), up)


def test_coverage_is_of_the_survival_of_each_ground(fake_simulator: None, tmp_path: Path) -> None:
    store = write(tmp_path / "store", ("rough", "up", "down"))
    plainest, up, down = (Survival((name,), name) for name in ("rough", "up", "down"))
    plainest = replace(plainest, survivors=True)
    grounds = np.column_stack([feature_values(ground, store) for ground in (up, down)])
    covered = feature_values(Coverage(plainest, (up, down)), store)
    np.testing.assert_array_equal(covered, earliness(feature_values(plainest, store), grounds))
    assert np.isnan(covered).any()


def test_rows_that_a_search_bred_can_be_left_out(fake_simulator: None, tmp_path: Path) -> None:
    bred = {"evaluations": 2304, "candidates": 12, "seed": 3}
    families = {"up": STRICT | {"min_survival_s": 1.0}}
    fake_walker.write_store(tmp_path / "store", robust={}, families=families, repertoire=bred)
    store = open_store(tmp_path / "store")
    is_of_grid = store.table()["origin"].to_numpy() == "sobol"
    assert 0 < np.sum(~is_of_grid) <= 12
    everyone = Survival(("up",))
    of_grid = feature_values(replace(everyone, grid_only=True), store)
    expected = np.where(is_of_grid, feature_values(everyone, store), np.nan)
    np.testing.assert_array_equal(of_grid, expected)
    of_grid = feature_values(Coverage(replace(everyone, grid_only=True), (everyone,)), store)
    np.testing.assert_array_equal(np.isnan(of_grid), ~is_of_grid)


def test_of_a_store_without_a_search_all_rows_are_of_the_grid(
    fake_simulator: None, tmp_path: Path
) -> None:
    store = write(tmp_path / "store", ("up",))
    everyone = Survival(("up",))
    of_grid = feature_values(replace(everyone, grid_only=True), store)
    np.testing.assert_array_equal(of_grid, feature_values(everyone, store))


@pytest.mark.filterwarnings("error:FeatureTable")
def test_rows_that_no_family_ran_are_left_out(comparisons: Comparisons) -> None:
    store = write(comparisons.folder / "strict", FAMILIES)
    ran = store.table()["rough_evaluated"].to_numpy()
    assert 30 < ran.sum() < len(store) - 30
    survivors = replace(Survival(FAMILIES), survivors=True)
    everyone = feature_values(Survival(FAMILIES), store)
    np.testing.assert_array_equal(feature_values(survivors, store), np.where(ran, everyone, np.nan))
    stores = dict.fromkeys(comparisons.experiment.stores, store.path)
    experiment = replace(comparisons.experiment, stores=stores)
    table = candidates(experiment, "diverse", ARMS["best"].features)
    np.testing.assert_array_equal(table.rows.offered, ran)
    comparisons.run("out", experiment=experiment, arms=("best",), runs=2, trials=20)
    assert ran[comparisons.table("out")["row"].to_numpy()].all()


@pytest.mark.parametrize(
    ("feature", "column"),
    [
        (Survival(), "robust_survived_fraction_mean"),
        (Survival(("up", "rough")), "rough_survived_fraction_mean"),
        (Survival(("rough",), survivors=True), "rough_survived_fraction_mean"),
        (Coverage(Survival(("down",)), (Survival(("up",)),)), "down_survived_fraction_mean"),
        (Coverage(Survival(("up",)), (Survival(("down",)),)), "down_survived_fraction_mean"),
        ("phi_reprinted", "phi_reprinted"),
    ],
)
def test_a_store_without_what_a_feature_needs(
    feature: Feature, column: str, fake_simulator: None, tmp_path: Path
) -> None:
    store = write(tmp_path / "store", () if feature == Survival() else ("up",))
    check_feature("mean_speed_mps", store)
    assert feature_values("mean_speed_mps", store).shape == (len(store),)
    with pytest.raises(InputError) as caught:
        check_feature(feature, store)
    assert str(caught.value).endswith(f"a store with the column {column}")
    assert "\n" not in str(caught.value)


def test_the_best_arm_is_what_its_definition_says() -> None:
    definition = ARMS["best"].definition
    assert definition["options"] == BEST
    assert definition["features"] == [
        ["survival", *FAMILIES, "survivors only"],
        *([name, name, "survivors only"] for name in FAMILIES),
        "mean_speed_mps",
    ]


def test_the_best_arm_of_worlds_takes_each_ground_by_its_few_and_its_long_walks() -> None:
    each = [[name, name, f"{name}{LONGER}", "survivors only"] for name in WORLDS]
    both = [family for name in PLAINEST for family in (name, f"{name}{LONGER}")]
    plainest = ["plainest", *both, "survivors only"]
    longer = [["survival", f"{name}{LONGER}"] for name in GROUNDS]
    for name, ties in (("best-worlds", "mean_speed_mps"), ("score-first-worlds", "phi_corrected")):
        coverage, *_, last = ARMS[name].definition["features"]
        assert coverage == ["coverage", plainest, *longer] and last == ties
    assert ARMS["best-worlds"].definition["features"][1:-1] == each


def test_its_control_differs_in_the_rows_that_are_proposed_only() -> None:
    ours, control = ARMS["best-worlds"], ARMS["best-worlds-grid"]
    assert (control.store, control.options) == (ours.store, ours.options)
    for own, plain in zip(control.features[1:-1], ours.features[1:-1], strict=True):
        assert isinstance(own, Survival) and own.grid_only
        assert replace(own, grid_only=False) == plain
    assert control.definition["features"][1][-1] == "grid only"


def test_the_arm_of_stairs_reads_nothing_else() -> None:
    read = {name for each in survivals(ARMS["best-stairs"].features) for name in each.families}
    assert read == {"stairs", f"stairs{LONGER}"}
