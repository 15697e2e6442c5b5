"""Features of a store's rows, the order that covers grounds, and the sampler that uses both."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import study
from storage.store import Store, open_store
from study.experiment import features
from study.experiment.arms import ARMS
from study.experiment.features import (
    Coverage,
    Survival,
    chances,
    covering_order,
    earliness,
    feature_values,
)
from study.experiment.samplers import Task
from study.experiment.stores import candidates
from taichi_nmm.errors import InputError
from tests.study import fake_walker
from tests.study.fake_walker import WORLDS

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


def test_coverage_is_of_the_survival_of_each_ground(fake_simulator, tmp_path):
    store = write(tmp_path / "store", ("rough", "up", "down"))
    plainest, up, down = (Survival((name,), name) for name in ("rough", "up", "down"))
    plainest = replace(plainest, survivors=True)
    grounds = np.column_stack([feature_values(ground, store) for ground in (up, down)])
    covered = feature_values(Coverage(plainest, (up, down)), store)
    assert_array_equal(covered, earliness(feature_values(plainest, store), grounds))
    assert np.isnan(covered).any()


@pytest.mark.slow
def test_rows_that_a_search_bred_can_be_left_out(fake_simulator, tmp_path):
    bred = {"evaluations": 2304, "candidates": 12, "seed": 3}
    families = {"up": STRICT | {"min_survival_s": 1.0}}
    fake_walker.write_store(tmp_path / "store", robust={}, families=families, repertoire=bred)
    store = open_store(tmp_path / "store")
    is_of_grid = store.table()["origin"].to_numpy() == "sobol"
    assert 0 < np.sum(~is_of_grid) <= 12
    everyone = Survival(("up",))
    grid = replace(everyone, grid_only=True)
    expected = np.where(is_of_grid, feature_values(everyone, store), np.nan)
    assert_array_equal(feature_values(grid, store), expected)
    of_grid = feature_values(Coverage(grid, (everyone,)), store)
    assert_array_equal(np.isnan(of_grid), ~is_of_grid)
    plain = write(tmp_path / "plain", ("up",))  # without a search all are of the grid
    assert_array_equal(feature_values(grid, plain), feature_values(everyone, plain))


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
    (Coverage(Survival(("down",)), (Survival(("up",)),)), "down_survived_fraction_mean"),
    (Coverage(Survival(("up",)), (Survival(("down",)),)), "down_survived_fraction_mean"),
    ("phi_reprinted", "phi_reprinted"),
])  # fmt: skip
def test_a_store_without_what_a_feature_needs(feature, column, fake_simulator, tmp_path):
    store = write(tmp_path / "store", () if feature == Survival() else ("up",))
    features.check_feature("mean_speed_mps", store)
    assert feature_values("mean_speed_mps", store).shape == (len(store),)
    with pytest.raises(InputError) as caught:
        features.check_feature(feature, store)
    assert str(caught.value).endswith(f"a store with the column {column}")
    assert "\n" not in str(caught.value)


# The order that covers, against its rule and against Bayes's.
def test_the_order_begins_on_the_plainest_ground_and_goes_on_with_what_that_does_not_survive():
    plainest = np.array([0.8, 0.9, 0.9, np.nan])
    survival = np.array([[0.9, 0.9], [0.1, 0.2], [0.1, 0.3], [1.0, 1.0]])
    assert covering_order(plainest, survival).tolist() == [1, 0, 2, 3]
    everywhere_but_up, its_like, up = [0.9, 0.9, 0.1], [0.9, 0.8, 0.1], [0.0, 0.0, 0.9]
    survival = np.array([its_like, up, everywhere_but_up])
    assert covering_order(np.array([0.8, 0.0, 0.9]), survival).tolist() == [2, 1, 0]
    assert covering_order(np.ones(5), np.full((5, 2), 0.5)).tolist() == [0, 1, 2, 3, 4]  # equal
    one = features.RELIABILITY  # a chance is relative to the best on that ground
    eighth = one / 8
    found = chances(np.array([[1.0, 0.2, 0.0], [0.5, 0.4, 0.0]]))
    assert_allclose(found, [[one, eighth, 0.0], [eighth, one, 0.0]])
    plainest, survival = np.array([0.2, np.nan, 0.9]), np.array([[0.2], [1.0], [0.9]])
    assert_array_equal(earliness(plainest, survival), [2.0, np.nan, 3.0])  # NaN: not to be tried
    assert np.isnan(earliness(np.full(3, np.nan), survival)).all()


def test_rows_beyond_those_that_cover_follow_by_their_mean(monkeypatch):
    monkeypatch.setattr(features, "COVERING", 3)
    survival = np.random.default_rng(1).uniform(size=(20, 4))
    order = covering_order(np.ones(20), survival)
    assert sorted(order) == list(range(20))
    rest = chances(survival).mean(axis=1)[order[3:]]
    assert (np.diff(rest) <= 0).all()


def test_the_next_row_is_the_likeliest_to_walk_after_so_many_falls():
    survival = np.random.default_rng(2).uniform(size=(30, 4)) ** 2
    plainest = np.random.default_rng(3).uniform(size=30)
    order, belief = covering_order(plainest, survival), np.full(4, 0.25)
    for place, row in enumerate(order[:10]):
        likely = plainest.copy() if place == 0 else chances(survival) @ belief
        likely[order[:place]] = -1.0
        assert row == np.argmax(likely)
        belief *= 1.0 - chances(survival)[row]  # of each ground, given that it fell
        belief /= belief.sum()


# The arms of the comparisons.
def test_the_best_arm_is_what_its_definition_says():
    assert ARMS["best"].definition["options"] == features.OPTIONS
    each = [[name, name, "survivors only"] for name in features.FAMILIES]
    expected = [["survival", *features.FAMILIES, "survivors only"], *each, "mean_speed_mps"]
    assert ARMS["best"].definition["features"] == expected


def test_the_arms_of_worlds_take_each_ground_by_few_and_long_walks_and_stairs_nothing_else():
    each = [[name, name, f"{name}{features.LONGER}", "survivors only"] for name in WORLDS]
    both = [family for name in features.PLAINEST for family in (name, f"{name}{features.LONGER}")]
    plainest = ["plainest", *both, "survivors only"]
    longer = [["survival", f"{name}{features.LONGER}"] for name in features.GROUNDS]
    for name, ties in (("best-worlds", "mean_speed_mps"), ("score-first-worlds", "phi_corrected")):
        coverage, *_, last = ARMS[name].definition["features"]
        assert coverage == ["coverage", plainest, *longer] and last == ties
    assert ARMS["best-worlds"].definition["features"][1:-1] == each
    ours, control = ARMS["best-worlds"], ARMS["best-worlds-grid"]
    assert (control.store, control.options) == (ours.store, ours.options)
    for own, plain in zip(control.features[1:-1], ours.features[1:-1], strict=True):
        assert isinstance(own, Survival) and own.grid_only
        assert replace(own, grid_only=False) == plain
    assert control.definition["features"][1][-1] == "grid only"
    read = features.survivals(ARMS["best-stairs"].features)
    stairs = {"stairs", f"stairs{features.LONGER}"}
    assert {name for each in read for name in each.families} == stairs


# The sampler outside of the comparisons.
@pytest.fixture
def stores(fake_simulator, tmp_path):
    fake_walker.write_store(tmp_path / "store")
    return tmp_path / "store"


def proposals(sampler: optuna.samplers.BaseSampler, count: int) -> list[int]:
    """Rows that it proposes, when the cost of a trial is a formula of its gains."""
    made = optuna.create_study(sampler=sampler)
    for _ in range(count):
        trial = made.ask(sampler.infer_relative_search_space(made, None))  # type: ignore[arg-type]
        gains = np.array([list(trial.params.values())])
        made.tell(trial, float(1.0 - fake_walker.quality(gains[:, :16])[0]))
    return [trial.user_attrs["row"] for trial in made.trials]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "table", "options"), [
    ("best", study.survival_table, features.OPTIONS),
    ("best-worlds", features.covered_table, features.COVERED_OPTIONS),
])  # fmt: skip
def test_it_proposes_what_the_arm_of_the_comparisons_does(name, table, options, tmp_path, stores):
    experiment = fake_walker.experiment(tmp_path)
    arm = ARMS[name]
    task = Task(experiment, 11, 0, arm.store, arm.features)
    ours = study.SurvivalSampler(table(experiment.stores[arm.store]), seed=11)
    assert proposals(ours, 12) == proposals(arm.new_sampler(task), 12)
    assert arm.definition["options"] == options


def test_rows_and_features_are_the_stores_and_options_may_differ(stores, tmp_path):
    table, rows = study.survival_table(stores), open_store(stores).table()
    means = [rows[f"{name}_survived_fraction_mean"].to_numpy() for name in features.FAMILIES]
    ran = rows["rough_evaluated"].to_numpy()
    assert_allclose(table.rows.features[ran, 0], np.mean(means, axis=0)[ran])
    assert_allclose(table.rows.features[ran, 5], rows["mean_speed_mps"].to_numpy()[ran])
    assert_array_equal(table.rows.offered, ran)
    table = study.survival_table(stores, ("up", "down"))
    assert len(proposals(study.SurvivalSampler(table, seed=1, kernel="rbf"), 3)) == 3
    fake_walker.write_store(tmp_path / "plain", families={})
    with pytest.raises(InputError, match="a store with the column rough_survived_fraction_mean"):
        study.survival_table(tmp_path / "plain")
