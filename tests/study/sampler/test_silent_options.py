"""Options and tables that a study never serves are not ignored in silence."""

import warnings

import numpy as np
import optuna
import pytest
from optuna.distributions import FloatDistribution

from study import FeatureKernelSampler, FeatureTable
from taichi_nmm.errors import InputError


def table() -> FeatureTable:
    rng = np.random.default_rng(0)
    return FeatureTable.from_arrays({"x": rng.random(40), "y": rng.random(40)}, rng.random((40, 1)))


def objective(trial: optuna.Trial) -> float:
    return trial.suggest_float("x", 0, 1) + trial.suggest_float("y", 0, 1)


def messages(sampler: FeatureKernelSampler, trials: int = 8) -> list[str]:
    study = optuna.create_study(sampler=sampler)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        study.optimize(objective, n_trials=trials)
    return [str(warning.message) for warning in caught if warning.category is UserWarning]


@pytest.mark.parametrize("option", ["mismatch", "feasibility"])
def test_an_attribute_that_no_trial_reports_is_one_warning(option: str) -> None:
    said = messages(FeatureKernelSampler(table(), seed=1, **{option: "misspelt"}))
    assert len(said) == 1
    assert said[0].startswith(f"{option} is left out: no finished trial reports it (misspelt")


def test_a_table_of_other_names_is_one_warning_where_it_need_not_fit() -> None:
    study = optuna.create_study(sampler=FeatureKernelSampler(table(), seed=1, strict=False))
    with pytest.warns(UserWarning, match="none of the table's parameters: x, y") as caught:
        study.optimize(lambda trial: trial.suggest_float("a", 0, 1), n_trials=5)
    assert len(caught) == 1


def test_a_declared_parameter_that_is_never_suggested_is_an_error() -> None:
    space = {"x": FloatDistribution(0, 1), "unused": FloatDistribution(0, 1)}
    study = optuna.create_study(sampler=FeatureKernelSampler(seed=1, space=space))
    with pytest.raises(InputError, match="unused: 'not suggested in trial 0'"):
        study.optimize(lambda trial: trial.suggest_float("x", 0, 1), n_trials=3)
