"""Finite costs and constraints so large that their differences or squares are not."""

from typing import Any

import numpy as np
import optuna
import pytest

from study import FeatureKernelSampler, FeatureTable
from study.sampler.transforms import log_excess

LARGEST = np.finfo(np.float64).max
ROWS = np.linspace(0.0, 1.0, 30)
EXTREMES = [
    (5e307, -5e307),
    (LARGEST, -LARGEST),
    (LARGEST, LARGEST),
    (-LARGEST, 0.0),
    (1e155, 1.0),
    (np.inf, -LARGEST),
]


def study_of(costs: tuple[float, float], limit: float = -1.0, **options: Any) -> optuna.Study:
    table = FeatureTable.from_arrays({"x": ROWS}, np.column_stack([ROWS, ROWS**2]))
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1, **options))

    def objective(trial: optuna.Trial) -> float:
        x = trial.suggest_float("x", 0, 1)
        trial.set_constraint("limit", limit * x)
        return costs[trial.number] if trial.number < 2 else x

    study.optimize(objective, n_trials=9)
    return study


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("kernel", ["additive", "rbf", "rbf_ard", "euclidean"])
@pytest.mark.parametrize("costs", EXTREMES)
def test_extreme_costs_are_learned_from(costs: tuple[float, float], kernel: str) -> None:
    study = study_of(costs, kernel=kernel)
    assert len({trial.params["x"] for trial in study.trials}) == 9
    if kernel != "euclidean":
        study.sampler.worth(study).markdown()  # type: ignore[attr-defined]


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("limit", [LARGEST, -LARGEST, 1e200])
def test_extreme_constraints_are_learned_from(limit: float) -> None:
    assert len(study_of((1.0, 2.0), limit).trials) == 9


def test_the_order_of_large_costs_is_kept() -> None:
    cost = np.array([-1e307, 4e307, 3e307, 1.0, LARGEST, -LARGEST])
    found = log_excess(cost)
    assert np.isfinite(found).all()
    assert np.argsort(found).tolist() == np.argsort(cost).tolist()


def test_costs_below_a_quarter_of_the_largest_are_as_before() -> None:
    cost = np.array([3.0, 1.0, 1e150, -2.0, 7.0])
    excess = cost - cost.min()
    before = np.log1p(excess / np.median(excess[excess > 0]))
    assert log_excess(cost).tobytes() == before.tobytes()


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("kernel", ["additive", "rbf", "rbf_ard"])
def test_extreme_features_tell_rows_apart(kernel: str) -> None:
    features = np.where(np.arange(30) % 2, LARGEST, -LARGEST) * ROWS
    table = FeatureTable.from_arrays({"x": ROWS}, features)
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1, kernel=kernel))
    study.optimize(lambda trial: trial.suggest_float("x", 0, 1), n_trials=6)
    assert len({trial.params["x"] for trial in study.trials}) == 6
