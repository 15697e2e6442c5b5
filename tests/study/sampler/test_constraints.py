"""Constraints as Optuna has them: the objective names each by `trial.set_constraint`."""

import numpy as np
import optuna
import pytest
from optuna.trial import TrialState

from study import FeatureKernelSampler, FeatureTable
from taichi_nmm.errors import InputError

A = np.linspace(0, 1, 60)


def cost(trial: optuna.Trial) -> float:
    return -trial.suggest_float("a", 0, 1)


def told(trial: optuna.Trial) -> float:
    value = cost(trial)
    for key, limit in enumerate((-value - 0.6, -1.0)):
        trial.set_constraint(str(key), limit)
    return value


def new_study() -> optuna.Study:
    table = FeatureTable.from_arrays({"a": A}, A)
    return optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))


def test_candidates_that_keep_their_limits_are_tried_more_often() -> None:
    limited, unlimited = new_study(), new_study()
    limited.optimize(told, n_trials=12)
    unlimited.optimize(cost, n_trials=12)
    kept = [sum(trial.params["a"] <= 0.6 for trial in s.trials) for s in (limited, unlimited)]
    assert kept[0] > kept[1]


def test_limits_of_pruned_and_failed_trials_do_no_harm() -> None:
    study = new_study()
    for state in (TrialState.FAIL, TrialState.PRUNED):
        trial = study.ask()
        told(trial)
        study.tell(trial, state=state)
    study.optimize(told, n_trials=3)
    assert len(study.get_trials(states=(TrialState.COMPLETE,))) == 3


def test_the_option_of_0_2_0_says_what_has_taken_its_place() -> None:
    with pytest.raises(
        InputError, match=r"constraints_func: .* trial\.set_constraint\(key, value\)"
    ):
        FeatureKernelSampler(seed=1, constraints_func=lambda trial: (0.0,))  # type: ignore[arg-type]
