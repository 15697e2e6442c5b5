"""Tables and spaces that a study never serves are not ignored in silence."""

import numpy as np
import optuna
import pytest
from optuna.distributions import FloatDistribution

from study import FeatureKernelSampler, FeatureTable
from taichi_nmm.errors import InputError


def table() -> FeatureTable:
    rng = np.random.default_rng(0)
    return FeatureTable.from_arrays({"x": rng.random(40), "y": rng.random(40)}, rng.random((40, 1)))


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
