"""Trials that broke a limit, and candidates that are likely to."""

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm

from study import FeatureKernelSampler, FeatureTable
from study.sampler.acquisition import log_kept
from study.sampler.gp import KERNELS
from study.sampler.history import read_limits


def test_the_probability_is_the_normal_one() -> None:
    mean, sd = np.array([-1.0, 0.0, 2.0, 60.0]), np.array([0.5, 1.0, 4.0, 1.0])
    assert_allclose(log_kept(mean, sd**2), norm.logcdf(-mean / sd))


def test_limits_are_the_constraints_that_trials_have() -> None:
    one = optuna.create_trial(value=0.0, constraints={"x": 1.0, "y": -np.inf})
    other = optuna.create_trial(value=0.0, constraints={"y": -2.0})
    assert_allclose(read_limits([one, other]), [[1.0, -2.0], [np.nan, -2.0]])
    assert read_limits([one]).shape == (1, 2)
    assert read_limits([optuna.create_trial(value=0.0)]).shape == (1, 0)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("told", ["how far", "whether"])
def test_a_sampler_that_knows_breaks_limits_less_often(kernel: str, told: str) -> None:
    """The cost falls towards a region that is forbidden, and a little into it.

    Told how far it was, by 4 trials or more of 20; told only whether, less often: a smooth process
    over the parameters cannot have a step.
    """
    a, side = np.random.default_rng(0).uniform(size=(2, 300))
    table = FeatureTable.from_arrays({"a": a, "side": side}, a)

    def broken(knows: bool) -> int:
        def objective(trial: optuna.Trial) -> float:
            value = trial.suggest_float("a", 0, 1)
            if knows:
                over = value - 0.6
                trial.set_constraint("edge", over if told == "how far" else float(np.sign(over)))
            return -min(value, 0.65) + 0.3 * trial.suggest_float("side", 0, 1)

        study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=2, kernel=kernel))
        study.optimize(objective, n_trials=20)
        values = [trial.params["a"] for trial in study.trials]
        if knows:
            assert max(v for v in values if v <= 0.6) > 0.5
        return sum(v > 0.6 for v in values)

    assert broken(knows=True) < broken(knows=False) - (3 if told == "how far" else 0)


def test_before_any_candidate_holds_the_likeliest_is_sought() -> None:
    a = np.linspace(0, 1, 200)
    table = FeatureTable.from_arrays({"a": a}, a)
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=0))

    def objective(trial: optuna.Trial) -> float:
        value = trial.suggest_float("a", 0, 1)
        trial.set_constraint("far", value - 0.02)
        return value

    for row in (150, 180):
        study.enqueue_trial({"a": float(a[row])})
    study.optimize(objective, n_trials=12)
    assert min(trial.params["a"] for trial in study.trials) <= 0.02
