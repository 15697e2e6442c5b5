"""What a study's trials say to a sampler over rows: the rows tried, and the costs they showed."""

import math
from dataclasses import dataclass

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from study.score_table import Rows
from taichi_nmm.errors import InputError

ROW_ATTRIBUTE = "row"
SCORE_ATTRIBUTE = "score"


@dataclass(frozen=True, eq=False)
class History:
    """The trials of a study before one of its trials.

    Attributes:
        tried: rows that any trial has taken, whatever became of it, bool [n].
        observed: rows of the finished trials, [m].
        cost: their values, lower is better, finite, [m].
        unplaced: numbers of finished trials that are no row of the table.
    """

    tried: NDArray[np.bool_]
    observed: NDArray[np.int64]
    cost: NDArray[np.float64]
    unplaced: tuple[int, ...]


def read_history(rows: Rows, study: optuna.Study, before: FrozenTrial) -> History:
    """The history that the trial `before` is proposed from, in the order of the trial numbers."""
    tried = np.zeros(len(rows), dtype=bool)
    observed, values, unplaced = [], [], []
    for trial in study.get_trials(deepcopy=False):
        if trial.number == before.number:
            continue
        row = row_of(rows, trial)
        if row is not None:
            tried[row] = True
        if trial.state is not TrialState.COMPLETE:
            continue
        if row is None:
            unplaced.append(trial.number)
        else:
            observed.append(row)
            values.append(trial.values[0])
    sign = -1.0 if study.direction is StudyDirection.MAXIMIZE else 1.0
    cost = sign * clip_infinities(np.array(values, dtype=np.float64))
    return History(tried, np.array(observed, dtype=np.int64), cost, tuple(unplaced))


def row_of(rows: Rows, trial: FrozenTrial) -> int | None:
    """The row that a trial is, or is about to be; None where its parameters are no row.

    The number that the sampler left in the trial counts if the parameters suggested so far are
    that row's. A trial without one (enqueued by hand) is looked up by its exact values.
    """
    row = trial.user_attrs.get(ROW_ATTRIBUTE)
    if isinstance(row, int) and 0 <= row < len(rows):
        expected = rows.as_parameters(row)
        _require_all_suggested(rows, trial)
        if all(trial.params.get(name, value) == value for name, value in expected.items()):
            return row
    return rows.find(trial.params)


def clip_infinities(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Infinite values replaced by the largest and the smallest finite one (zero if none is)."""
    finite = values[np.isfinite(values)]
    low, high = (finite.min(), finite.max()) if len(finite) else (0.0, 0.0)
    return np.where(values == math.inf, high, np.where(values == -math.inf, low, values))


def _require_all_suggested(rows: Rows, trial: FrozenTrial) -> None:
    """Refuse to go on in a study whose objective leaves out parameters of the table."""
    if trial.state is not TrialState.COMPLETE:
        return
    for name in rows.names:
        if name not in trial.params:
            allowed = f"an objective that suggests all of {', '.join(rows.names)}"
            raise InputError(name, f"not suggested in trial {trial.number}", allowed)
