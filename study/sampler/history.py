"""What a study's trials say to a sampler: where they were, and the costs they showed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState, create_trial

from study.sampler.rows import Rows
from study.sampler.space import Space
from study.sampler.transforms import clip_infinities

Floats = NDArray[np.float64]

ROW_ATTRIBUTE = "row"  # of the table; -1 for a point off it
SCORE_ATTRIBUTE = "score"  # the feature, where there is one
FEATURES_ATTRIBUTE = "features"  # as a list, where there are several, or no table
FIXED_ATTRIBUTE = "fixed_params"  # Optuna's, of the system: what `enqueue_trial` was given
OFF_TABLE = -1

# Of a trial that is no row, with its parameters [d]: the row whose features it is taken to have,
# OFF_TABLE if it has its own (or none are needed), None if it cannot be learned from.
FeaturesOf = Callable[[FrozenTrial, Floats], int | None]


def _own(trial: FrozenTrial, parameters: Floats) -> int | None:
    """Every trial has features of its own."""
    return OFF_TABLE


@dataclass(frozen=True, eq=False)
class History:
    """The trials of a study before one of its trials.

    Attributes:
        trials: the n finished ones that can be learned from, in the order of their numbers.
        parameters: of each, [n, d].
        rows: of each, the row whose features it has, OFF_TABLE where these are its own, [n].
        cost: of each, lower is better, finite, [n].
        running: parameters of those running elsewhere, [r, d].
        running_rows: of each, [r].
        tried: rows that any trial has taken, whatever became of it, bool [rows of the table].
        unplaced: finished trials left out, being no row of the table.
        fixed: values of `before` that are settled: the user's, or suggested already.
    """

    trials: tuple[FrozenTrial, ...]
    parameters: Floats
    rows: NDArray[np.int64]
    cost: Floats
    running: Floats
    running_rows: NDArray[np.int64]
    tried: NDArray[np.bool_]
    unplaced: tuple[FrozenTrial, ...]
    fixed: Mapping[str, Any]

    @property
    def finished(self) -> "History":
        """The same as if no trial were running."""
        return replace(self, running=self.running[:0], running_rows=self.running_rows[:0])


def next_trial(study: optuna.Study) -> FrozenTrial:
    """The trial that would come next, of which nothing is known; the study stays as it is."""
    trial = create_trial(state=TrialState.RUNNING)
    trial.number = len(study.get_trials(deepcopy=False))
    return trial


@dataclass(frozen=True, eq=False)
class _Placed:
    """A trial with its parameters [d], and the row whose features it has."""

    trial: FrozenTrial
    parameters: Floats
    row: int


def read_history(
    study: optuna.Study,
    before: FrozenTrial,
    space: Space,
    table: Rows | None = None,
    features_of: FeaturesOf = _own,
) -> History:
    """The history that the trial `before` is proposed from.

    Args:
        study: whose trials are read.
        before: left out itself.
        space: parameters that a trial must have to be learned from.
        table: where rows are looked up.
        features_of: trials that are no row of the table.
    """
    tried = np.zeros(0 if table is None else len(table), dtype=bool)
    finished: list[_Placed] = []
    running: list[_Placed] = []
    unplaced = []
    for trial in study.get_trials(deepcopy=False):
        if trial.number == before.number:
            continue
        row = None if table is None else row_of(table, trial)
        if row is not None:
            tried[row] = True
        if trial.state not in (TrialState.COMPLETE, TrialState.RUNNING):
            continue
        placed = _place(trial, row, space, table, features_of)
        if trial.state is TrialState.RUNNING:
            running += [] if placed is None else [placed]
        elif placed is not None:
            finished.append(placed)
        elif table is not None:
            unplaced.append(trial)
    values = np.array([placed.trial.values[0] for placed in finished], dtype=np.float64)
    sign = -1.0 if study.direction is StudyDirection.MAXIMIZE else 1.0
    fixed = values_of(before)
    return History(
        tuple(placed.trial for placed in finished),
        _parameters(finished, space),
        np.array([placed.row for placed in finished], dtype=np.int64),
        sign * clip_infinities(values),
        _parameters(running, space),
        np.array([placed.row for placed in running], dtype=np.int64),
        tried,
        tuple(unplaced),
        {name: fixed[name] for name in space.names if name in fixed},
    )


def _place(
    trial: FrozenTrial,
    row: int | None,
    space: Space,
    table: Rows | None,
    features_of: FeaturesOf,
) -> _Placed | None:
    """A trial as a model sees it; None if it cannot be learned from.

    Args:
        trial: finished or running.
        row: that it is, if any.
        space: as of `read_history`, and so on.
    """
    if row is not None and table is not None:
        return _Placed(trial, table.parameters[row], row)
    parameters = space.row(trial.params)
    lent = None if parameters is None else features_of(trial, parameters)
    return None if parameters is None or lent is None else _Placed(trial, parameters, lent)


def _parameters(placed: list[_Placed], space: Space) -> Floats:
    """Of trials, [n, d]."""
    rows = [one.parameters for one in placed]
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(space))


def values_of(trial: FrozenTrial) -> dict[str, Any]:
    """What a trial has, or is sure to have: its parameters and, until it ends, the user's."""
    if trial.state.is_finished():
        return trial.params
    fixed = trial.system_attrs.get(FIXED_ATTRIBUTE)
    return fixed | trial.params if fixed else trial.params


def row_of(table: Rows, trial: FrozenTrial) -> int | None:
    """The row that a trial is, or is about to be; None where its parameters are no row.

    The number that was left in the trial counts if what the trial has is that row's; of a COMPLETE
    one that is all of it. A trial without a number is looked up by its exact values.
    """
    row, values = trial.user_attrs.get(ROW_ATTRIBUTE), values_of(trial)
    if isinstance(row, int) and 0 <= row < len(table):
        wanted = table.as_parameters(row)
        if values == wanted:  # nearly always; the rest is for those that have more, or fewer
            return row
        partial = trial.state is not TrialState.COMPLETE
        if all(values[name] == v if name in values else partial for name, v in wanted.items()):
            return row
    return table.find(values)


def noted_features(trial: FrozenTrial) -> list[float] | None:
    """The features that were left in a trial of a point off the table; None without such a note.

    What was left with the number of a row is that row's: a trial that did something else has not
    these features.
    """
    noted = trial.user_attrs.get(FEATURES_ATTRIBUTE)
    if trial.user_attrs.get(ROW_ATTRIBUTE, OFF_TABLE) != OFF_TABLE:
        return None
    if not isinstance(noted, list):
        return None
    return [np.nan if value is None else value for value in noted]
