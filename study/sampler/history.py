"""The trials of a study as a sampler sees them: parameters, rows and costs.

A trial is a row of a table if its parameters are that row's. Its number, and its
features, are left in the trial as user attributes, to be read and sorted by. The study
may suggest a parameter in another way than the table has it: by another kind, scale or
range. Its values count.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState, create_trial

from storage.inputs.errors import InputError, listed
from study.sampler.arrays import Floats, Mask, Whole
from study.sampler.goals import Goals
from study.sampler.rows import Rows
from study.sampler.space import Number, Space, as_suggested
from study.sampler.transforms import by_side, stand_ins, without_infinities

ROW_ATTRIBUTE = "row"  # of the table; -1 for a point off it
SCORE_ATTRIBUTE = "score"  # the feature, where there is one
FEATURES_ATTRIBUTE = "features"  # as a list, where there are several, or no table
FIXED_ATTRIBUTE = "fixed_params"  # Optuna's: what `enqueue_trial` was given
WHY_ATTRIBUTE = "why"  # it was proposed, in words: an `Aim`
OFF_TABLE = -1
NOTES = {ROW_ATTRIBUTE, SCORE_ATTRIBUTE, FEATURES_ATTRIBUTE, WHY_ATTRIBUTE}

LookedUp = dict[int, tuple[FrozenTrial, int | None, Floats | None]]
"""Finished trials by number, each with the row that it is and its parameters [d]."""


@dataclass(frozen=True, eq=False)
class Placed:
    """Trials of which the parameters are known, or parameters that a trial might have.

    Attributes:
        trials: m of them; () where there are only parameters.
        parameters: of each, [m, d].
        rows: of each, the row of the table that it is, or OFF_TABLE, [m].
    """

    trials: tuple[FrozenTrial, ...]
    parameters: Floats
    rows: Whole


@dataclass(frozen=True, eq=False)
class History:
    """The trials of a study before one of its trials.

    Attributes:
        done: the n finished ones that can be learned from, by number.
        running: those that run elsewhere.
        cost: of each that is done, lower is better, finite: infinity is beyond the others, [n].
        costs: of each, for each of the k goals of the study, [n, k].
        signs: of costs in the study's values: -1 where these are maximised, else 1,
            [k].
        tried: whether any trial has taken a row, whatever became of it, [table rows].
        taken: parameters of all other trials that have them, whatever became of them, or
            will have them (enqueued ones), [t, d].
        unplaced: finished trials left out, being no row of the table.
        fixed: settled values of the trial itself by name: the user's, or suggested
            already.
        goals: what made one cost of several; None: there is one.
    """

    done: Placed
    running: Placed
    cost: Floats
    costs: Floats
    signs: Floats
    tried: Mask
    taken: Floats
    unplaced: tuple[FrozenTrial, ...]
    fixed: Mapping[str, Any]
    goals: Goals | None = None

    @property
    def sign(self) -> float:
        """The sign of the only goal."""
        return float(self.signs[0])


def next_trial(study: optuna.Study) -> FrozenTrial:
    """The trial that would come next, of which nothing is known; the study stays as it is."""
    trial = create_trial(state=TrialState.RUNNING)
    trial.number = len(study.get_trials(deepcopy=False))
    return trial


def read_history(
    study: optuna.Study,
    before: FrozenTrial,
    space: Space,
    table: Rows | None = None,
    places_all: bool = True,
    known: LookedUp | None = None,
    compared: Sequence[Floats] = (),
) -> History:
    """The history that the trial `before`, which is left out itself, is proposed from.

    A trial must have the parameters of the space to be learned from. If it is no row of
    the table, it must also have features, unless all have a place. Trials that were
    looked up before in the table are known, new ones added. An infinite value is beyond
    all others, and beyond what it is `compared` with: numbers for each of the k goals,
    in the study's values.
    """
    known = {} if known is None else known
    tried = np.zeros(0 if table is None else len(table), dtype=bool)
    done: list[tuple[FrozenTrial, Floats, int]] = []
    running: list[tuple[FrozenTrial, Floats, int]] = []
    taken: list[Floats] = []
    unplaced = []
    for trial in study.get_trials(deepcopy=False):
        if trial.number == before.number:
            continue
        row, parameters = _looked_up(trial, space, table, known)
        if row is not None:
            tried[row] = True
        place = space.row(values_of(trial)) if parameters is None else parameters
        if place is not None:
            taken.append(place)
        if trial.state not in (TrialState.COMPLETE, TrialState.RUNNING):
            continue
        is_complete = trial.state is TrialState.COMPLETE
        if row is None and (places_all or noted_features(trial) is not None):
            row = OFF_TABLE
        if row is not None and parameters is not None:
            (done if is_complete else running).append((trial, parameters, row))
        elif table is not None and is_complete:
            unplaced.append(trial)
    values = np.array([trial.values for trial, _, _ in done], dtype=np.float64)
    signs = [
        -1.0 if each is StudyDirection.MAXIMIZE else 1.0 for each in study.directions
    ]
    others = compared or [np.empty(0)] * len(signs)
    columns = []
    goals = values.reshape(-1, len(signs)).T
    for sign, column, other in zip(signs, goals, others, strict=True):
        columns.append(sign * without_infinities(column, stand_ins(column, other)))
    costs = np.column_stack(columns)
    settled = values_of(before)
    return History(
        done=_placed(done, len(space)),
        running=_placed(running, len(space)),
        cost=costs[:, 0],
        costs=costs,
        signs=np.array(signs),
        tried=tried,
        taken=np.array(taken, dtype=np.float64).reshape(-1, len(space)),
        unplaced=tuple(unplaced),
        fixed={name: settled[name] for name in space.names if name in settled},
    )


def _placed(found: list[tuple[FrozenTrial, Floats, int]], d: int) -> Placed:
    """Trials, each with its d parameters and its row."""
    parameters = np.array([each for _, each, _ in found], dtype=np.float64)
    return Placed(
        trials=tuple(trial for trial, _, _ in found),
        parameters=parameters.reshape(-1, d),
        rows=np.array([row for _, _, row in found], dtype=np.int64),
    )


def placed(rows: Rows, params: Sequence[Mapping[str, Any]]) -> Placed:
    """Parameters by name, as trials over a table that have them would be placed.

    Raises:
        InputError: parameters that the table's distributions cannot have.
    """
    parameters = np.empty((len(params), len(rows.names)))
    numbers = np.full(len(params), OFF_TABLE)
    for place, values in enumerate(params):
        known, row = rows.space.row(values), rows.find(values)
        if known is None:
            allowed = f"one of {rows.space.as_dict()}"
            raise InputError(f"params[{place}]", dict(values), allowed)
        parameters[place] = known
        if row is not None:
            numbers[place] = row
    return Placed(trials=(), parameters=parameters, rows=numbers)


def _looked_up(
    trial: FrozenTrial, space: Space, table: Rows | None, known: LookedUp
) -> tuple[int | None, Floats | None]:
    """The row of a table that a trial is, and its parameters [d]; None for either it has not.

    A finished trial stays as it is, and is looked up once. Storages give the same
    object for it each time; another object under its number (of another study) is
    looked up anew.
    """
    if table is None:
        return None, space.row(trial.params)
    found = known.get(trial.number)
    if found is not None and found[0] is trial:
        return found[1:]
    row = row_of(table, trial)
    parameters = space.row(trial.params) if row is None else table.parameters[row]
    if trial.state.is_finished():
        known[trial.number] = trial, row, parameters
    return row, parameters


def values_of(trial: FrozenTrial) -> dict[str, Any]:
    """The parameters of a trial and, until it ends, those that the user has fixed."""
    if trial.state.is_finished():
        return trial.params
    fixed = trial.system_attrs.get(FIXED_ATTRIBUTE)
    return fixed | trial.params if fixed else trial.params


def row_of(table: Rows, trial: FrozenTrial) -> int | None:
    """The row that a trial is, or is about to be; None where its parameters are no row.

    The number that was left in the trial counts if what the trial has is that row's; of
    a COMPLETE one that is all of it. A trial without a number is looked up by its
    values.
    """
    row, values = trial.user_attrs.get(ROW_ATTRIBUTE), values_of(trial)
    if isinstance(row, int) and 0 <= row < len(table):
        expected = table.as_parameters(row)
        # nearly always; the rest is for those that have more, or fewer
        if values == expected:
            return row
        named = {name: values[name] for name in expected if name in values}
        is_whole = len(named) == len(expected) or trial.state is not TrialState.COMPLETE
        if is_whole and (
            named.items() <= expected.items() or bool(table.having(named)[row])
        ):
            return row
    return table.find(values)


def is_own(table: Rows, study: optuna.Study, trial: FrozenTrial, row: int) -> bool:
    """Whether no other trial has the row that was just written into this one.

    A trial that was enqueued with the row, and still waits, has it too; one that has the
    number and did something else has not.
    """
    return not any(
        (
            other.user_attrs.get(ROW_ATTRIBUTE) == row
            or other.state is TrialState.WAITING
        )
        and row_of(table, other) == row
        for other in study.get_trials(deepcopy=False)
        if other.number != trial.number
    )


def noted_features(trial: FrozenTrial) -> list[float] | None:
    """The features that were left in a trial of a point off the table; None without such a note.

    What was left with the number of a row is that row's.
    """
    noted = trial.user_attrs.get(FEATURES_ATTRIBUTE)
    is_off = trial.user_attrs.get(ROW_ATTRIBUTE, OFF_TABLE) == OFF_TABLE
    if not is_off or not isinstance(noted, list):
        return None
    return [np.nan if value is None else value for value in noted]


def notes_of(row: int, features: Floats, why: str | None = None) -> dict[str, Any]:
    """The row, or OFF_TABLE, its features [k], those unknown as None, and why it is proposed."""
    values = [value if math.isfinite(value) else None for value in features.tolist()]
    notes: dict[str, Any] = {ROW_ATTRIBUTE: row}
    if len(values) == 1:
        notes[SCORE_ATTRIBUTE] = values[0]
    if len(values) > 1 or row == OFF_TABLE:
        notes[FEATURES_ATTRIBUTE] = values
    if why is not None:
        notes[WHY_ATTRIBUTE] = str(why)
    return notes


def limit_names(trials: Iterable[FrozenTrial]) -> list[str]:
    """Names of the constraints that trials told of, in the order of `read_limits`."""
    return sorted({key for trial in trials for key in trial.constraints})


def read_limits(trials: Sequence[FrozenTrial]) -> Floats:
    """The constraints of trials, [n, c], by their names; NaN where unknown, kept where <= 0.

    As `transforms.by_side` has what `trial.set_constraint` was told.
    """
    keys = limit_names(trials)
    limits = np.empty((len(trials), len(keys)))
    for key, column in zip(keys, limits.T, strict=True):
        told = [trial.constraints.get(key, np.nan) for trial in trials]
        column[:] = by_side(np.array(told, dtype=np.float64))
    return limits


# What a study suggests, and whether a table fits it.


class Inferred(dict[str, BaseDistribution]):
    """The search space of a table, as it is given to Optuna: distributions by name.

    Optuna requires the study to suggest with the very distributions of a search space
    whose values it was given at once, and a study that suggests another scale, kind, or
    order of choices fails with them. Where the space is this one, values are therefore
    handed out one by one.
    """


def suggested_so_far(
    names: Iterable[str], study: optuna.Study
) -> dict[str, BaseDistribution]:
    """Distributions by name, of the latest trial that has each; names that none has are left out.

    Within a study Optuna holds a parameter to one kind of distribution, one scale, and,
    of a categorical, one list of choices.
    """
    found: dict[str, BaseDistribution] = {}
    missing = set(names)
    for trial in reversed(study.get_trials(deepcopy=False)):
        if not missing:
            break
        for name in missing & trial.distributions.keys():
            found[name] = trial.distributions[name]
        missing -= found.keys()
    return found


def as_suggested_rows(rows: Rows, suggested: Mapping[str, BaseDistribution]) -> Rows:
    """The rows with a logarithmic scale for what a study suggests on one.

    It is the scale of the kernels that look at parameters, and of points near the rows.
    A scale or step that the table was given stays. Rows that the study does not hold
    stay as they are, too.
    """
    distributions = rows.space.as_dict()
    for column, (name, own) in enumerate(rows.space.as_dict().items()):
        theirs = suggested.get(name)
        if not isinstance(own, Number) or not isinstance(theirs, Number):
            continue
        whole = isinstance(own, IntDistribution)
        has_step = own.step != (1 if whole else None)
        if own.log or has_step or not theirs.log:
            continue
        if rows.outside(column, theirs) is not None:
            continue
        low, high = max(own.low, theirs.low), min(own.high, theirs.high)
        if whole:
            low, high = math.ceil(low), math.floor(high)
            distributions[name] = IntDistribution(int(low), int(high), log=True)
        else:
            distributions[name] = FloatDistribution(low, high, log=True)
    return replace(rows, space=Space.of(distributions))


def shown_misfit(
    rows: Rows, suggested: Mapping[str, BaseDistribution], study: optuna.Study
) -> InputError | None:
    """The misfit of a table that earlier trials have shown; None without any.

    `suggested` is how they suggested its parameters, or some of them; the latest
    finished one may have suggested some of them only.
    """
    for column, name in enumerate(rows.names):
        if name in suggested:
            error = distribution_misfit(rows, column, suggested[name])
            if error is not None:
                return error
    trial = _latest(study)
    if trial is None or not any(name in trial.params for name in rows.names):
        return None
    return not_suggested(rows.names, trial)


def proves_fit(rows: Rows, study: optuna.Study) -> bool:
    """Whether the latest finished trial suggested all parameters of the table, and holds them."""
    trial = _latest(study)
    return trial is not None and all(
        name in trial.distributions
        and distribution_misfit(rows, column, trial.distributions[name]) is None
        for column, name in enumerate(rows.names)
    )


def _latest(study: optuna.Study) -> FrozenTrial | None:
    trials = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return trials[-1] if trials else None


def not_suggested(names: Sequence[str], trial: FrozenTrial) -> InputError | None:
    """The error of a trial without one of these parameters; None if it has all."""
    for name in names:
        if name not in trial.params:
            allowed = f"an objective that suggests all of {listed(names, name)}"
            return InputError(name, f"not suggested in trial {trial.number}", allowed)
    return None


def distribution_misfit(
    rows: Rows, column: int, suggested: BaseDistribution
) -> InputError | None:
    """An error if what is suggested for one parameter leaves rows out; None if it holds all.

    Kind, scale and order of choices may be others than the table's: its values count.
    """
    outside = rows.outside(column, suggested)
    if outside is None:
        return None
    name, own = rows.names[column], rows.space.distributions[column]
    value = rows.as_parameters(outside)[name]
    what = (
        "a range that holds" if isinstance(suggested, Number) else "choices that hold"
    )
    allowed = f"{what} all rows: row {outside} has {value!r} (the table: {own}, or as space= says)"
    return InputError(name, str(suggested), allowed)


def run_otherwise(trial: FrozenTrial, values: Mapping[str, Any]) -> str | None:
    """The first parameter of which a trial ran another value than this; None without any."""
    for name, value in values.items():
        if name not in trial.params:
            continue
        ran = trial.params[name]
        try:
            if ran != value and ran != as_suggested(trial.distributions[name], value):
                return name
        except ValueError:  # its distribution has no such value
            return name
    return None


def no_row_has(rows: Rows, fixed: Mapping[str, Any]) -> InputError:
    """The error of fixed values, at least one, that no row has which could be proposed."""
    name, values = ", ".join(fixed), tuple(fixed.values())
    what = "values that a row of the table has together"
    if rows.having(fixed).any():
        what = "values of a row that has not been tried"
    elif len(fixed) == 1:
        what = "a value that a row of the table has"
        column = rows.names.index(name)
        number = rows.space.number(column, values[0])
        if number is not None:
            row = int(abs(rows.parameters[:, column] - number).argmin())
            what += f", such as {rows.as_parameters(row)[name]!r}"
    allowed = f"{what}; or all parameters, in enqueue_trial"
    return InputError(name, values[0] if len(values) == 1 else values, allowed)
