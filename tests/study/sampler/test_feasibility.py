"""Trials that broke a limit, and candidates that are likely to."""

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm

from study import FeatureKernelSampler, FeatureTable
from study.sampler.evidence import read_limits
from study.sampler.feasibility import log_kept


def test_the_probability_is_the_normal_one() -> None:
    mean, sd = np.array([-1.0, 0.0, 2.0, 60.0]), np.array([0.5, 1.0, 4.0, 1.0])
    assert_allclose(log_kept(mean, sd**2), norm.logcdf(-mean / sd))


def test_limits_come_from_constraints_or_a_flag() -> None:
    one = optuna.create_trial(value=0.0, constraints={"x": 1.0, "y": -np.inf})
    other = optuna.create_trial(value=0.0, constraints={"y": -2.0}, user_attrs={"fell": True})
    limits = read_limits([one, other], "constraints")
    assert_allclose(limits, [[1.0, -2.0], [np.nan, -2.0]])
    assert_allclose(read_limits([one, other], "fell"), [[np.nan], [1.0]])
    assert read_limits([one, other], None).shape == (2, 0)
    assert read_limits([one], "constraints").shape == (1, 2)


@pytest.mark.parametrize("acquisition", ["ei", "log_ei", "ucb", "thompson"])
@pytest.mark.parametrize("feasibility", ["constraints", "fell"])
def test_a_sampler_that_knows_breaks_limits_less_often(acquisition: str, feasibility: str) -> None:
    """The cost falls towards a region that is forbidden, and a little into it."""
    a, side = np.random.default_rng(0).uniform(size=(2, 300))
    table = FeatureTable.from_arrays({"a": a, "side": side}, a)

    def objective(trial: optuna.Trial) -> float:
        value = trial.suggest_float("a", 0, 1)
        trial.set_constraint("edge", value - 0.6)
        trial.set_user_attr("fell", value > 0.6)
        return -min(value, 0.65) + 0.3 * trial.suggest_float("side", 0, 1)

    def broken(knows: bool) -> int:
        sampler = FeatureKernelSampler(
            table, seed=2, acquisition=acquisition, feasibility=feasibility if knows else None
        )
        study = optuna.create_study(sampler=sampler)
        study.optimize(objective, n_trials=20)
        values = [trial.params["a"] for trial in study.trials]
        if knows:
            assert max(v for v in values if v <= 0.6) > 0.5
        return sum(v > 0.6 for v in values)

    assert broken(knows=True) < broken(knows=False) - 3


def test_before_any_candidate_holds_the_likeliest_is_sought() -> None:
    a = np.linspace(0, 1, 200)
    table = FeatureTable.from_arrays({"a": a}, a)
    sampler = FeatureKernelSampler(table, seed=0, feasibility="constraints", n_startup_trials=2)
    study = optuna.create_study(sampler=sampler)

    def objective(trial: optuna.Trial) -> float:
        value = trial.suggest_float("a", 0, 1)
        trial.set_constraint("far", value - 0.02)
        return value

    for row in (150, 180):
        study.enqueue_trial({"a": float(a[row])})
    study.optimize(objective, n_trials=12)
    assert min(trial.params["a"] for trial in study.trials) <= 0.02
