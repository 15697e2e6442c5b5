"""What a study's trials say to a sampler: where they were, and the costs they showed."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from study.sampler.rows import Rows
from study.sampler.space import Space
from study.sampler.transforms import clip_infinities

Floats = NDArray[np.float64]

ROW_ATTRIBUTE = "row"  # of the table; -1 for a point off it
SCORE_ATTRIBUTE = "score"  # the feature, where there is one
FEATURES_ATTRIBUTE = "features"  # as a list, where there are several, or no table
OFF_TABLE = -1


@dataclass(frozen=True, eq=False)
class History:
    """The trials of a study before one of its trials.

    Attributes:
        trials: the n finished ones that can be learned from, in the order of their numbers.
        parameters: of each, [n, d].
        rows: of each, OFF_TABLE where it is no row, [n].
        cost: of each, lower is better, finite, [n].
        running: parameters of those running elsewhere, [r, d].
        running_rows: of each, [r].
        tried: rows that any trial has taken, whatever became of it, bool [rows of the table].
        unplaced: numbers of finished trials left out, being no row of the table.
    """

    trials: tuple[FrozenTrial, ...]
    parameters: Floats
    rows: NDArray[np.int64]
    cost: Floats
    running: Floats
    running_rows: NDArray[np.int64]
    tried: NDArray[np.bool_]
    unplaced: tuple[int, ...]


def read_history(
    study: optuna.Study,
    before: FrozenTrial,
    space: Space,
    table: Rows | None = None,
    usable: Callable[[FrozenTrial], bool] = lambda trial: True,
) -> History:
    """The history that the trial `before` is proposed from.

    Args:
        study: whose trials are read.
        before: left out itself.
        space: parameters that a trial must have to be learned from.
        table: where rows are looked up.
        usable: of a trial that is no row of the table: whether it can be learned from.
    """
    tried = np.zeros(0 if table is None else len(table), dtype=bool)
    finished: list[tuple[FrozenTrial, int]] = []
    running: list[tuple[FrozenTrial, int]] = []
    unplaced = []
    for trial in study.get_trials(deepcopy=False):
        if trial.number == before.number:
            continue
        row = None if table is None else row_of(table, trial)
        if row is not None:
            tried[row] = True
        if trial.state is TrialState.COMPLETE:
            if row is not None or (space.holds(trial) and usable(trial)):
                finished.append((trial, OFF_TABLE if row is None else row))
            elif table is not None:
                unplaced.append(trial.number)
        elif trial.state is TrialState.RUNNING and (row is not None or space.holds(trial)):
            running.append((trial, OFF_TABLE if row is None else row))
    values = np.array([trial.values[0] for trial, _ in finished], dtype=np.float64)
    sign = -1.0 if study.direction is StudyDirection.MAXIMIZE else 1.0
    return History(
        tuple(trial for trial, _ in finished),
        _parameters(finished, space, table),
        np.array([row for _, row in finished], dtype=np.int64),
        sign * clip_infinities(values),
        _parameters(running, space, table),
        np.array([row for _, row in running], dtype=np.int64),
        tried,
        tuple(unplaced),
    )


def _parameters(placed: list[tuple[FrozenTrial, int]], space: Space, table: Rows | None) -> Floats:
    """Of trials with their rows, [n, d]."""
    parameters = np.empty((len(placed), len(space)))
    for place, (trial, row) in enumerate(placed):
        if row == OFF_TABLE or table is None:
            parameters[place] = space.rows([trial.params])[0]
        else:
            parameters[place] = table.parameters[row]
    return parameters


def row_of(table: Rows, trial: FrozenTrial) -> int | None:
    """The row that a trial is, or is about to be; None where its parameters are no row.

    The number that the sampler left in the trial counts if the parameters suggested so far are
    that row's. A trial without one (enqueued by hand) is looked up by its exact values.
    """
    row = trial.user_attrs.get(ROW_ATTRIBUTE)
    if isinstance(row, int) and 0 <= row < len(table):
        suggested, wanted = trial.params, table.as_parameters(row)
        if suggested == wanted:  # nearly always; the rest is for those that have more, or fewer
            return row
        if all(suggested.get(name, value) == value for name, value in wanted.items()):
            return row
    return table.find(trial.params)
