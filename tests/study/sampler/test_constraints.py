"""Constraints as Optuna's own samplers take them: `constraints_func`, or `trial.set_constraint`."""

import pickle
from typing import Any

import numpy as np
import optuna
import pytest
from optuna.samplers import TPESampler
from optuna.trial import FrozenTrial, TrialState

from study import FeatureKernelSampler, FeatureTable
from taichi_nmm.errors import InputError

A = np.linspace(0, 1, 60)


def table() -> FeatureTable:
    return FeatureTable.from_arrays({"a": A}, A)


def cost(trial: optuna.Trial) -> float:
    return -trial.suggest_float("a", 0, 1)


def limits(trial: FrozenTrial) -> tuple[float, ...]:
    return (trial.params["a"] - 0.6, -1.0)


def told(trial: optuna.Trial) -> float:
    value = cost(trial)
    for key, limit in enumerate((-value - 0.6, -1.0)):
        trial.set_constraint(str(key), limit)
    return value


def new_study(**options: Any) -> optuna.Study:
    return optuna.create_study(sampler=FeatureKernelSampler(table(), seed=1, **options))


def test_it_is_stored_as_optunas_samplers_do() -> None:
    ours = new_study(constraints_func=limits)
    ours.optimize(cost, n_trials=3)
    with pytest.warns(FutureWarning):
        theirs = optuna.create_study(sampler=TPESampler(seed=1, constraints_func=limits))
    theirs.optimize(cost, n_trials=3)
    for study in (ours, theirs):
        for trial in study.trials:
            assert trial.constraints == dict(zip("01", limits(trial), strict=True))
    assert set(ours.trials[0].system_attrs) == set(theirs.trials[0].system_attrs)


def test_it_is_the_same_as_telling_them_in_the_objective() -> None:
    ours, by_hand = new_study(constraints_func=limits), new_study()
    ours.optimize(cost, n_trials=12)
    by_hand.optimize(told, n_trials=12)
    assert [trial.params for trial in ours.trials] == [trial.params for trial in by_hand.trials]
    unlimited = new_study()
    unlimited.optimize(cost, n_trials=12)
    kept = [sum(trial.params["a"] <= 0.6 for trial in s.trials) for s in (ours, unlimited)]
    assert kept[0] > kept[1]


def test_failed_trials_have_none_and_pruned_ones_have() -> None:
    study = new_study(constraints_func=limits)
    for state in (TrialState.FAIL, TrialState.PRUNED):
        trial = study.ask()
        cost(trial)
        study.tell(trial, state=state)
    assert [bool(trial.constraints) for trial in study.trials] == [False, True]


@pytest.mark.parametrize("returned", [[float("nan")], "no", 3.0, ["x"], None])
def test_what_is_no_list_of_numbers_is_one_line(returned: Any) -> None:
    study = new_study(constraints_func=lambda trial: returned)
    with pytest.raises(InputError, match=r"constraints_func\(trial\): .* a list of numbers"):
        study.optimize(cost, n_trials=1)
    assert study.trials[0].state is TrialState.COMPLETE


def test_numbers_of_numpy_are_fine() -> None:
    study = new_study(constraints_func=lambda trial: np.array([1.0, -2.0]))
    study.optimize(cost, n_trials=1)
    assert study.trials[0].constraints == {"0": 1.0, "1": -2.0}


def test_what_cannot_be_used_is_refused_at_once() -> None:
    with pytest.raises(InputError, match=r"constraints_func: 'int' .* a function"):
        new_study(constraints_func=3)


def test_it_travels() -> None:
    sampler = pickle.loads(pickle.dumps(FeatureKernelSampler(table(), constraints_func=limits)))
    study = optuna.create_study(sampler=sampler)
    study.optimize(cost, n_trials=1)
    assert len(study.trials[0].constraints) == 2


def test_it_goes_without_a_table() -> None:
    study = optuna.create_study(sampler=FeatureKernelSampler(seed=1, constraints_func=limits))
    study.optimize(cost, n_trials=5)
    assert all(len(trial.constraints) == 2 for trial in study.trials)
