"""Whether a table fits what a study suggests, as far as its trials show."""

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution
from optuna.trial import FrozenTrial, TrialState

from study.sampler.history import ROW_ATTRIBUTE
from study.sampler.rows import Rows
from study.sampler.space import same_kind
from taichi_nmm.errors import InputError


def first_misfit(rows: Rows, study: optuna.Study, before: FrozenTrial) -> InputError | None:
    """What the latest finished trial says against the table; None if nothing, or none has finished.

    Only a trial that was proposed from the table tells that a parameter is never suggested: others
    may be anything.
    """
    trial = _latest(study, before)
    if trial is None:
        return None
    proposed = ROW_ATTRIBUTE in trial.user_attrs
    if not proposed and not all(name in trial.params for name in rows.names):
        return None
    for column, name in enumerate(rows.names):
        error = _misfit(rows, column, name, trial)
        if error is not None:
            return error
    return None


def proves_fit(rows: Rows, study: optuna.Study, before: FrozenTrial) -> bool:
    """Whether the latest finished trial suggested all parameters of the table, in its ranges."""
    trial = _latest(study, before)
    return trial is not None and all(
        _misfit(rows, column, name, trial) is None for column, name in enumerate(rows.names)
    )


def _latest(study: optuna.Study, before: FrozenTrial) -> FrozenTrial | None:
    """The finished trial of the highest number, other than `before`."""
    trials = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    others = [trial for trial in trials if trial.number != before.number]
    return others[-1] if others else None


def _misfit(rows: Rows, column: int, name: str, trial: FrozenTrial) -> InputError | None:
    """What the trial says against one parameter of the table; None if nothing."""
    suggested = trial.distributions.get(name)
    if suggested is None:
        allowed = f"an objective that suggests all of {', '.join(rows.names)}"
        return InputError(name, f"not suggested in trial {trial.number}", allowed)
    own = rows.space.distributions[column]
    if not same_kind(own, suggested):
        return InputError(name, str(suggested), f"the table's kind: {own}")
    return _range_misfit(rows, column, name, suggested)


def _range_misfit(
    rows: Rows, column: int, name: str, suggested: BaseDistribution
) -> InputError | None:
    """An error if the range that was suggested leaves rows out."""
    if isinstance(suggested, CategoricalDistribution):
        return None
    low, high = suggested.low, suggested.high  # type: ignore[attr-defined]
    least, most = rows.extent[0][column], rows.extent[1][column]
    if low <= least and most <= high:
        return None
    values = rows.parameters[:, column]
    outside = int(np.flatnonzero((values < low) | (values > high))[0])
    allowed = f"a range that holds all rows: row {outside} has {float(values[outside]):g}"
    return InputError(name, str(suggested), allowed)
