"""A parameter of the table that the study does not always suggest: refused once that is known."""

import warnings

import numpy as np
import optuna
import pytest
from optuna.trial import TrialState

from study import FeatureKernelSampler, FeatureTable
from taichi_nmm.errors import InputError


def table() -> FeatureTable:
    rng = np.random.default_rng(0)
    return FeatureTable.from_arrays({"a": rng.random(20), "b": rng.random(20)}, rng.random(20))


def only_a(trial: optuna.Trial) -> float:
    return trial.suggest_float("a", 0, 1)


def b_at_times(trial: optuna.Trial) -> float:
    a = trial.suggest_float("a", 0, 1)
    return a + trial.suggest_float("b", 0, 1) if trial.number else a


def a_and_b(trial: optuna.Trial) -> float:
    return only_a(trial) + trial.suggest_float("b", 0, 1)


@pytest.mark.parametrize("objective", [only_a, b_at_times])
def test_it_is_an_error_of_the_very_trial(objective) -> None:  # type: ignore[no-untyped-def]
    study = optuna.create_study(sampler=FeatureKernelSampler(table(), seed=1))
    with pytest.raises(InputError, match=r"b: 'not suggested in trial 0' .* all of a, b"):
        study.optimize(objective, n_trials=1)
    assert study.trials[0].state is TrialState.COMPLETE  # what it cost is not lost
    assert study.trials[0].user_attrs == {"row": -1, "score": None}
    study.optimize(a_and_b, n_trials=2)  # the objective was mended
    assert len({trial.user_attrs["row"] for trial in study.trials[1:]}) == 2


def test_asked_and_told_too() -> None:
    study = optuna.create_study(sampler=FeatureKernelSampler(table(), seed=1))
    trial = study.ask()
    value = only_a(trial)
    with pytest.raises(InputError, match="b: 'not suggested in trial 0'"):
        study.tell(trial, value)


def test_an_objective_that_suggests_none_of_the_table_is_one_too() -> None:
    sampler = FeatureKernelSampler(table(), seed=1, extra_parameters=["n"])
    study = optuna.create_study(sampler=sampler)
    with pytest.raises(InputError, match="a: 'not suggested in trial 0'"):
        study.optimize(lambda trial: trial.suggest_int("n", 1, 9), n_trials=1)
    with pytest.raises(InputError, match="a: 'not suggested in trial 1'"):
        study.tell(study.ask(), 1.0)  # nor where nothing at all was suggested


def test_an_enqueued_row_tells_it_too() -> None:
    study = optuna.create_study(sampler=FeatureKernelSampler(table(), seed=1))
    study.enqueue_trial(table().rows.as_parameters(3))
    with pytest.raises(InputError, match="b: 'not suggested in trial 0'"):
        study.optimize(only_a, n_trials=1)


def test_where_the_table_need_not_fit_it_is_one_warning_and_no_row() -> None:
    study = optuna.create_study(sampler=FeatureKernelSampler(table(), seed=1, strict=False))
    with pytest.warns(UserWarning, match="b: 'not suggested in trial 0'") as said:
        study.optimize(only_a, n_trials=4)
    assert len(said) == 1
    assert all(trial.user_attrs.get("row", -1) == -1 for trial in study.trials)


@pytest.mark.parametrize("error", [optuna.TrialPruned, RuntimeError])
def test_a_trial_that_ends_early_says_nothing(error: type[Exception]) -> None:
    def ends(trial: optuna.Trial) -> float:
        only_a(trial)
        raise error

    study = optuna.create_study(sampler=FeatureKernelSampler(table(), seed=1))
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        study.optimize(ends, n_trials=2, catch=RuntimeError)
    assert len({trial.user_attrs["row"] for trial in study.trials}) == 2
