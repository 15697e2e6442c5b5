"""Constraints by a function of the finished trial: the older of Optuna's two idioms.

The newer one is `trial.set_constraint(key, value)` in the objective. Both are read the same way,
`trial.constraints`.
"""

import math
from collections.abc import Callable, Sequence

import optuna
from optuna.trial import FrozenTrial, TrialState

from taichi_nmm.errors import InputError

ConstraintsFunction = Callable[[FrozenTrial], Sequence[float]]

STORED_AS = "constraints"  # system attribute; Optuna's own samplers write it and all read it


def checked(function: ConstraintsFunction | None) -> ConstraintsFunction | None:
    """The function, or none.

    Raises:
        InputError: not a function.
    """
    if function is not None and not callable(function):
        name = type(function).__name__
        raise InputError("constraints_func", name, "a function of a finished trial")
    return function


def store_constraints(
    function: ConstraintsFunction, study: optuna.Study, trial: FrozenTrial, state: TrialState
) -> None:
    """Call the function and store what it says, as Optuna's samplers do after each trial.

    Args:
        function: of the user; its exceptions are the user's.
        study: of the trial.
        trial: that is about to be finished.
        state: that it will have; trials that FAIL have no constraints.

    Raises:
        InputError: it returned something else than numbers.
    """
    if state not in (TrialState.COMPLETE, TrialState.PRUNED):
        return
    limits = _numbers(function(trial))
    study._storage.set_trial_system_attr(trial._trial_id, STORED_AS, limits)


def _numbers(returned: object) -> list[float]:
    """What the function returned as a list of numbers, none of them NaN."""
    try:
        if isinstance(returned, str):
            raise TypeError
        limits = [float(value) for value in returned]  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        limits = [math.nan]
    if any(math.isnan(limit) for limit in limits):
        allowed = "a list of numbers, feasible where <= 0"
        raise InputError("constraints_func(trial)", returned, allowed)
    return limits
