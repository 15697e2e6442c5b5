"""The sampler that did best, outside the comparisons."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest

import study
from storage.store import open_store
from study.experiment.arms import ARMS
from study.experiment.samplers import Task
from study.features import (
    COVERED_OPTIONS,
    FAMILIES,
    OPTIONS,
    SurvivalSampler,
    covered_table,
    survival_table,
)
from study.sampler.table import FeatureTable
from taichi_nmm.errors import InputError
from tests.study import fake_walker


@pytest.fixture
def store(fake_simulator: None, tmp_path: Path) -> Path:
    fake_walker.write_store(tmp_path / "store")
    return tmp_path / "store"


def proposals(sampler: optuna.samplers.BaseSampler, count: int) -> list[int]:
    """Rows that it proposes, when the cost of a trial is a formula of its gains."""
    made = optuna.create_study(sampler=sampler)
    for _ in range(count):
        trial = made.ask(fixed_distributions=sampler.infer_relative_search_space(made, None))  # type: ignore[arg-type]
        gains = np.array([list(trial.params.values())])
        made.tell(trial, float(1.0 - fake_walker.quality(gains[:, :16])[0]))
    return [trial.user_attrs["row"] for trial in made.trials]


@pytest.mark.parametrize(
    ("name", "table", "options"),
    [
        ("best", survival_table, OPTIONS),
        ("best-worlds", covered_table, COVERED_OPTIONS),
    ],
)
def test_it_proposes_what_the_arm_of_the_comparisons_does(
    name: str,
    table: Callable[[Path], FeatureTable],
    options: dict[str, Any],
    tmp_path: Path,
    store: Path,
) -> None:
    experiment = fake_walker.experiment(tmp_path)
    arm = ARMS[name]
    task = Task(experiment, 11, 0, arm.store, arm.features)
    ours = SurvivalSampler(table(experiment.stores[arm.store]), seed=11)
    assert proposals(ours, 12) == proposals(arm.new_sampler(task), 12)
    assert arm.definition["options"] == options


def test_rows_and_features_are_the_stores(store: Path) -> None:
    table, rows = survival_table(store), open_store(store).table()
    means = [rows[f"{name}_survived_fraction_mean"].to_numpy() for name in FAMILIES]
    ran = rows["rough_evaluated"].to_numpy()
    np.testing.assert_allclose(table.rows.features[ran, 0], np.mean(means, axis=0)[ran])
    np.testing.assert_allclose(table.rows.features[ran, 5], rows["mean_speed_mps"].to_numpy()[ran])
    np.testing.assert_array_equal(table.rows.offered, ran)


def test_options_may_differ(store: Path) -> None:
    table = survival_table(store, ("up", "down"))
    assert len(proposals(SurvivalSampler(table, seed=1, kernel="rbf"), 3)) == 3


def test_a_store_without_families_is_one_line(store: Path, tmp_path: Path) -> None:
    fake_walker.write_store(tmp_path / "plain", families={})
    with pytest.raises(InputError, match="a store with the column rough_survived_fraction_mean"):
        survival_table(tmp_path / "plain")


def test_it_is_public() -> None:
    assert study.SurvivalSampler is SurvivalSampler
    assert study.survival_table is survival_table
