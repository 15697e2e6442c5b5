"""Features of a store's rows, and the sampler that uses them."""

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
from study.experiment.features import Survival, feature_values
from study.experiment.samplers import Task
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
    assert "\n" not in str(caught.value)


# The arms of the comparisons.
def test_the_best_arm_is_what_its_definition_says():
    assert ARMS["best"].definition["options"] == features.OPTIONS
    each = [[name, name, "survivors only"] for name in features.FAMILIES]
    expected = [["survival", *features.FAMILIES, "survivors only"], *each, "mean_speed_mps"]
    assert ARMS["best"].definition["features"] == expected


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
def test_it_proposes_what_the_arm_of_the_comparisons_does(tmp_path, stores):
    experiment, arm = fake_walker.experiment(tmp_path), ARMS["best"]
    task = Task(experiment, 11, 0, arm.store, arm.features)
    ours = study.SurvivalSampler(study.survival_table(experiment.stores[arm.store]), seed=11)
    assert proposals(ours, 12) == proposals(arm.new_sampler(task), 12)


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
