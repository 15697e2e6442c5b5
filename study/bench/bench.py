"""A bench: what to try next on a real machine, what came of it, and what all of it tells.

The sampler sees the trials of the present context alone, in a study in memory, in their order and
without gaps: so what was entered wrongly and corrected, broken off and tried again, or undone,
leaves no trace in later proposals. What was learned in other contexts is one more family of
worlds.
"""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution, distribution_to_json, json_to_distribution
from optuna.trial import FrozenTrial, TrialState, create_trial

from storage.databases.studies import read_errors, shown_url
from storage.tables import difference
from study.bench.journal import Entry, Journal, State, Trial, read_state, undoable
from study.bench.plan import Plan, Safety, read_plan
from study.bench.words import operator_here, require_names
from study.sampler.diagnostics import Best, Prediction
from study.sampler.sampler import FeatureKernelSampler
from study.sampler.space import as_suggested
from study.sampler.table import FeatureTable, Rows
from study.sampler.table_policy import TableExhaustedError
from study.sampler.worlds import Worlds
from taichi_nmm import checks
from taichi_nmm.errors import InputError

WHOLE, VALUE = checks.whole(0), checks.optional(checks.number())
COLUMNS = checks.optional(checks.by_name(checks.number()))
Own = tuple[Mapping[str, Any], float, Mapping[str, float], str]
"""Parameters, value, columns and note of a trial that nobody proposed."""
BEFORE = "as before"  # the world that other contexts tell of
MOST_BATCH = 1000
TOLD = {True: TrialState.COMPLETE, False: TrialState.RUNNING}


class Bench:
    """A file of a bench, with the entries in its database.

    Args:
        path: of the TOML file.
        operator: who makes the entries; by default the user and the machine.

    Attributes:
        operator: the same; it may be changed between entries.

    Raises:
        InputError: naming the key of the file; or the bench was begun with another file.
    """

    def __init__(self, path: str | Path, operator: str | None = None) -> None:
        self.plan: Plan = read_plan(Path(path))
        self.operator = operator or operator_here()
        self._journal = Journal(self.plan.url, self.plan.name)
        self._entries = self._journal.entries()
        if not self._entries:
            return
        with read_errors(self.plan.url):  # which somebody may have edited
            begun, _ = self._begun["plan"], (self.space, self._begun["range"], self.state)
            found = difference(self.plan.document, begun)
        if found:
            field, ours, theirs = found
            allowed = f"{theirs!r}, with which the bench was begun; or another name for a new one"
            raise InputError(f"{self.plan.path.name}: {field}", ours, allowed)

    @classmethod
    def new(cls, path: str | Path, operator: str | None = None) -> "Bench":
        """Begin a bench, or open the one that was begun with this file."""
        bench = cls(path, operator)
        simulated = bench.candidates
        with bench._turn():
            if not bench._entries:
                space = simulated.rows.space.as_dict()
                require_names(bench.plan.columns, space)
                begun = {
                    "plan": bench.plan.document, "digest": simulated.digest,
                    "space": {name: distribution_to_json(of) for name, of in space.items()},
                    "range": _range(simulated.rows),
                }  # fmt: skip
                bench._add("begin", begun)
        return bench

    def look(self) -> State:
        """What all entries come to, also those that others have made since."""
        self._entries = self._read()
        return self.state

    def _read(self) -> list[Entry]:
        """All entries, which are those that were read before and perhaps more.

        Raises:
            InputError: the database is gone, or is another one now.
        """
        found = self._journal.entries()
        if self._entries and found[:1] != list(self._entries[:1]):
            allowed = "the database with this bench, which was removed or replaced"
            raise InputError("storage", shown_url(self.plan.url), allowed)
        return found

    @property
    def state(self) -> State:
        """What the entries come to."""
        return read_state(self._entries)

    @property
    def space(self) -> dict[str, BaseDistribution]:
        """The distributions of the parameters, by name; the candidates are not read for them."""
        return {name: json_to_distribution(text) for name, text in self._begun["space"].items()}

    @property
    def entries(self) -> Sequence[Entry]:
        """All entries, those that were undone too."""
        return tuple(self._entries)

    @cached_property
    def candidates(self) -> FeatureTable:
        """The candidates, as they were when the bench was begun.

        Raises:
            InputError: they cannot be read, or have changed since.
        """
        found = self.plan.read_candidates(self.space if self._entries else None)
        if self._entries and found.digest != self._begun["digest"]:
            allowed = "the candidates with which the bench was begun (their digest differs)"
            raise InputError("candidates", str(self.plan.path), allowed)
        return found

    @checks.checked(batch=checks.whole(1, MOST_BATCH), repeat=checks.optional(WHOLE))
    def next(self, batch: int = 1, repeat: int | None = None) -> list[Trial]:
        """Trials to run: those that this operator has not entered yet, and new ones up to `batch`.

        Args:
            batch: how many, at most `MOST_BATCH`.
            repeat: a finished trial, whose parameters are tried once more.

        Raises:
            InputError: no candidate is left, or none within the limits of [safety].
        """
        with self._turn() as state:
            mine = [
                trial for trial in state.trials.values()
                if trial.value is None and trial.context == state.context
                and trial.operator == self.operator
            ]  # fmt: skip
            asked = list[dict[str, Any]]()
            if repeat is not None:
                again, mine = state.trial(repeat, finished=True), []
                why = f"Once more what trial {repeat} was."
                asked.append(self._asked(again.params, {}, state.count, why))
            while len(mine) + len(asked) < batch:
                asked.append(self._propose(state, asked))
            if asked:
                self._add("next", {"trials": asked})
            new = [self.state.trials[trial["number"]] for trial in asked]
            return [*mine, *new][:batch]

    @checks.checked(number=WHOLE, value=VALUE, failed_s=VALUE, columns=COLUMNS, note=checks.text)
    def record(
        self, number: int, value: float | None = None, *, failed_s: float | None = None,
        columns: Mapping[str, float] | None = None, note: str = "",
    ) -> None:  # fmt: skip
        """Enter the result of a trial: its value, or after how many seconds it failed.

        Raises:
            InputError: no pending trial, no finite number, or a column that the file has not.
        """
        if value is None and failed_s is None:
            raise InputError("value", None, "the trial's value, or after how long it failed")
        kind = "record" if failed_s is None else "fail"
        self._tell(kind, number, self._checked(value, columns, note, failed_s))

    @checks.checked(number=WHOLE, value=VALUE, failed_s=VALUE, columns=COLUMNS, note=checks.text)
    def correct(
        self, number: int, value: float | None = None, *, failed_s: float | None = None,
        columns: Mapping[str, float] | None = None, note: str = "",
    ) -> None:  # fmt: skip
        """Replace what was entered of a finished trial; what is not given stays.

        With a value, a trial that failed is a failure no longer; with `failed_s`, it is one.

        Raises:
            InputError: nothing to replace; or as `record`.
        """
        if value is None and failed_s is None and not columns and not note:
            allowed = "something to correct: the value, the time of a failure, a column or the note"
            raise InputError("correct", number, allowed)
        self._tell("correct", number, self._checked(value, columns, note, failed_s))

    @checks.checked(number=WHOLE, note=checks.text)
    def abort(self, number: int, note: str = "") -> None:
        """Enter that a trial was broken off: nothing is learned, and it is the next one again."""
        with self._turn() as state:
            state.trial(number, finished=False)
            self._add("abort", {"trial": number, "note": note})

    def add(self, rows: Sequence[Own]) -> list[int]:
        """Enter trials that nobody proposed: parameters, value, columns, note; their numbers.

        Raises:
            InputError: a parameter is missing, unknown or out of its range, by name; or a result
                as of `record`. Nothing is entered then.
        """
        space = self.space
        for params, *_ in rows:
            for name in dict.fromkeys([*space, *params]):
                if name not in space or name not in params:
                    what = params.get(name, "missing")
                    raise InputError(name, what, f"one value of each of {', '.join(space)}")
                try:
                    as_suggested(space[name], params[name])
                except ValueError:
                    raise InputError(name, params[name], str(space[name])) from None
        results = [
            self._checked(checks.number()("value", value), columns, checks.text("note", note))
            for _, value, columns, note in rows
        ]
        with self._turn() as state:
            numbers = list(range(state.count, state.count + len(rows)))
            trials = [
                self._asked(dict(row[0]), {}, number, "The operator's own.", expect=False) | result
                for number, row, result in zip(numbers, rows, results, strict=True)
            ]
            self._add("add", {"trials": trials})
        return numbers

    @checks.checked("context.", name=checks.text)
    def context(self, name: str) -> None:
        """Go on in another context: other ground, shoes or motors; or in one that was before."""
        with self._turn() as state:
            if name == state.context:
                raise InputError("context", name, "another one than the present")
            self._add("context", {"name": name})

    @checks.checked("undo.", number=checks.optional(WHOLE))
    def undo(self, number: int | None = None) -> Entry:
        """Undo an entry, by default the last one that stands; an undoing can be undone."""
        with self._turn():
            chosen = undoable(self._entries, number)
            self._add("undo", {"entry": chosen.number})
        return chosen

    def best(self) -> Best:
        """The trial of the present context that is best by the model, with its interval."""
        return self._sampler().best(self._study(self.state))

    def repeat(self) -> int | None:
        """The trial of which a repeat would tell most: the least sure one that may be the best."""
        state, best = self.state, self.best()
        told = [trial for trial in state.trials.values()
                if trial.value is not None and trial.context == state.context]  # fmt: skip
        found = self._sampler().predict(self._study(state), [trial.params for trial in told])
        may_be = found.high >= best.value if self.plan.goal.maximise else found.low <= best.value
        sure = np.where(may_be, found.low - found.high, np.inf)
        return told[int(sure.argmin())].number if may_be.any() else None

    def worth(self) -> str:
        """Which simulated worlds the machine is like, or what the features are worth."""
        sampler = self._sampler()
        return str(sampler.worth(self._study(self.state))) if sampler.has_features else ""

    def simulated(self) -> dict[int, float]:
        """The mean over the worlds of each finished trial; none without worlds."""
        rows = self.candidates.rows
        told = [trial for trial in self.state.trials.values() if trial.value is not None]
        if not told or rows.worlds is None:
            return {}
        known = rows.worlds.costs @ rows.worlds.weights
        places = rows.space.unit(np.array([rows.space.row(trial.params) for trial in told]))
        values = rows.mixed(known[rows.numbers][:, None], places, places)[:, 0].tolist()
        return dict(zip([trial.number for trial in told], values, strict=True))

    def _tell(self, kind: str, number: int, result: dict[str, Any]) -> None:
        with self._turn() as state:
            trial = state.trial(number, finished=kind == "correct")
            if trial.failed and result["value"] is not None and "seconds" not in result:
                result["failed"] = False
            self._add(kind, {"trial": number} | result)

    def _checked(
        self, value: float | None, columns: Mapping[str, float] | None, note: str,
        failed_s: float | None = None,
    ) -> dict[str, Any]:  # fmt: skip
        """A result as an entry has it."""
        if value is not None and failed_s is not None:
            allowed = "the value, or after how long it failed, not both"
            raise InputError("seconds", failed_s, allowed)
        for name, given in (COLUMNS("columns", columns) or {}).items():
            if name not in self.plan.columns:
                known = ", ".join(self.plan.columns) or "none: [columns] of the file names them"
                raise InputError(name, given, f"one of the columns {known}")
        result = {"value": value, "columns": dict(columns or {}), "note": note}
        if failed_s is None:
            return result
        return result | {"value": self.plan.goal.of_failure(failed_s), "seconds": failed_s}

    def odd(self, value: float) -> str:
        """A warning of a value that no simulated world has, such as one of the wrong sign."""
        low, high = self._begun["range"] or (-np.inf, np.inf)
        beyond = 0.5 * (high - low)
        other_sign = (low > 0.0 > value) or (high < 0.0 < value)
        if low - beyond <= value <= high + beyond and not other_sign:
            return ""
        return (
            f"{value:g} is far from all that was simulated, {low:.4g} to {high:.4g}: is it right?"
        )

    def shown(self) -> optuna.Study:
        """The study that the dashboard shows."""
        return optuna.load_study(study_name=self.plan.name, storage=self._journal.storage)

    @property
    def _begun(self) -> Mapping[str, Any]:
        """The first entry."""
        return self._entries[0].data

    @contextmanager
    def _turn(self) -> Iterator[State]:
        """Alone, after the entries of others; in the end what is shown follows from all entries."""
        with self._journal.turn():
            self._entries = self._read()
            yield self.state
            show(self)

    def _add(self, kind: str, data: Mapping[str, Any]) -> None:
        self._entries.append(self._journal.append(kind, data, self.operator))

    def _propose(self, state: State, asked: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """The next trial, after those that were just asked for."""
        numbers = {given["number"]: Trial(operator="", **given) for given in asked}
        state = replace(state, trials=state.trials | numbers, count=state.count + len(asked))
        study, sampler = self._study(state), self._sampler()
        if self.plan.safety != Safety():
            sampler = self._sampler(self._allowed(study, sampler))
        study.sampler = sampler
        try:
            trial = study.ask(self.space)
        except TableExhaustedError as error:
            raise InputError("candidates", str(error), "a row that nobody has tried") from None
        notes = dict(study.get_trials(deepcopy=False)[trial.number].user_attrs)
        return self._asked(trial.params, notes, state.count, self._why(study))

    def _asked(
        self, params: dict[str, Any], notes: dict[str, Any], number: int, why: str,
        expect: bool = True,
    ) -> dict[str, Any]:  # fmt: skip
        """A trial as an entry has it, with what is expected of it."""
        if expect:
            found = self._sampler().predict(self._study(self.state), [params])
            why = f"{why} {self._expected(found)}".strip()
        return {
            "number": number, "params": params, "notes": notes, "why": why,
            "context": self.state.context,
        }  # fmt: skip

    def _expected(self, found: Prediction) -> str:
        """What is expected of a candidate, in a sentence."""
        value, parts = float(found.value[0]), list[str]()
        if np.isfinite(value):
            interval = "interval unknown"
            if np.isfinite(found.low[0]):
                interval = f"{found.low[0]:.4g} to {found.high[0]:.4g}, the mean without noise"
            parts.append(f"{value:.4g} ({interval})")
        if np.isfinite(found.success[0]):
            parts.append(f"success {100 * found.success[0]:.0f} %")
        if any(column.limits("", 0.0) for column in self.plan.columns.values()):
            unknown = np.isnan(found.kept[0])
            chance = "unknown" if unknown else f"{100 * found.kept[0]:.0f} %"
            parts.append(f"all limits kept {chance}")
        return f"Expected: {', '.join(parts)}." if parts else ""

    def _why(self, study: optuna.Study) -> str:
        """Why a proposal is made, in a sentence."""
        told = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        if not told:
            known = ""
            if self._others(self.state):
                known = f"the best {BEFORE}, or "
            elif self.candidates.rows.worlds is not None:
                known = "the best simulated, or "
            return f"The first one: {known}one of several to begin with."
        kept = [trial for trial in told if all(v <= 0.0 for v in trial.constraints.values())]
        if not kept:
            return "No trial has kept all limits yet: the one that most likely does."
        if self.plan.goal.success is not None and not self._successful(kept):
            return "No trial has succeeded yet: the one that most likely does, or improves most."
        best = (max if self.plan.goal.maximise else min)(trial.values[0] for trial in kept)
        return f"The largest improvement to be expected on {best:.4g}."

    def _allowed(self, study: optuna.Study, sampler: FeatureKernelSampler) -> NDArray[np.bool_]:
        """Rows within the limits of [safety]; one at least."""
        safety, rows = self.plan.safety, self.candidates.rows
        found = sampler.predict(study)
        keeps = ~(found.kept < safety.least_kept) & ~(found.success < safety.least_success)
        told = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        good = self._successful(told)
        if good and safety.most_step < 1.0:
            places = rows.space.unit(np.array([rows.space.row(trial.params) for trial in good]))
            steps = np.abs(rows.unit[:, None] - places[None]).max(axis=2).min(axis=1)
            keeps &= steps <= safety.most_step
        allowed = np.zeros(len(rows), dtype=bool)
        allowed[found.rows[keeps]] = True
        tried = [row for trial in study.get_trials(deepcopy=False)
                 if (row := rows.find(trial.params)) is not None]  # fmt: skip
        allowed[tried] = False
        if not allowed.any():
            raise InputError("safety", "no candidate within the limits", "wider limits in [safety]")
        return allowed

    def _successful(self, told: Sequence[FrozenTrial]) -> list[FrozenTrial]:
        """Trials that succeeded; without `goal.success`, those that did not fail."""
        sign, success = -1.0 if self.plan.goal.maximise else 1.0, self.plan.goal.success
        if success is None:
            return [trial for trial in told if not trial.user_attrs["failed"]]
        return [trial for trial in told if sign * trial.values[0] <= sign * success]

    def _study(self, state: State, context: str | None = None) -> optuna.Study:
        """The trials of a context, by default the present one, as if all had been right at once."""
        study = optuna.create_study(direction=self.plan.direction)
        space = self.space
        here = state.context if context is None else context
        for trial in state.trials.values():
            if trial.context == here:
                study.add_trial(frozen(trial, space, self.plan))
        return study

    def _others(self, state: State) -> list[str]:
        """Other contexts in which a trial is finished, in their order."""
        told = [trial.context for trial in state.trials.values() if trial.value is not None]
        return [name for name in dict.fromkeys(told) if name != state.context]

    def _sampler(self, allowed: NDArray[np.bool_] | None = None) -> FeatureKernelSampler:
        """The sampler of the present context."""
        found, state = self.candidates, self.state
        told = list[np.ndarray[Any, np.dtype[np.float64]]]()
        for context in self._others(state):
            known = self.plan.sampler(found).predict(self._study(state, context))
            column = np.full(len(found), np.nan)
            column[known.rows] = known.value
            told.append(column)
        if told:
            column, maximise = np.column_stack(told), self.plan.goal.maximise
            with warnings.catch_warnings(action="ignore", category=UserWarning):  # rows left out
                found = with_before(found, column, maximise=maximise)
        return self.plan.sampler(found, allowed)


def with_before(candidates: FeatureTable, told: Any, *, maximise: bool) -> FeatureTable:
    """Candidates of which k other contexts tell something too.

    It is a family of worlds with the weight of all others.

    Args:
        candidates: as they are.
        told: predicted values of the rows, in the study's units, [n, k]; NaN where unknown.
        maximise: high values are good.
    """
    rows, k = candidates.rows, told.shape[1]
    before, own = tuple(f"{BEFORE} {place}" for place in range(k)), rows.worlds
    if own is None:
        worlds = Worlds(before, told, np.full(k, 1.0 / k))
        return FeatureTable(replace(rows, worlds=worlds))
    if own.better is not None:  # in units of their own: as many standard deviations
        sign = 1.0 if maximise is (own.better == "higher") else -1.0
        spread = float(np.nanstd(told)) or 1.0
        told = sign * (told - np.nanmean(told)) / spread * np.nanstd(own.costs)
        told = told + np.nanmean(own.costs)
    weights = np.concatenate([own.weights / 2.0, np.full(k, 0.5 / k)])
    worlds = Worlds((*own.names, *before), np.hstack([own.costs, told]), weights, own.better)
    return FeatureTable(replace(rows, worlds=worlds))


def _range(rows: Rows) -> list[float] | None:
    """The least and the largest value that was simulated; None: in no worlds of these units."""
    if rows.worlds is None or rows.worlds.better is not None:
        return None
    return [float(np.nanmin(rows.worlds.costs)), float(np.nanmax(rows.worlds.costs))]


def frozen(trial: Trial, space: Mapping[str, Any], plan: Plan) -> FrozenTrial:
    """A trial as Optuna has it."""
    shown = {key: getattr(trial, key) for key in ("context", "operator", "note", "failed", "why")}
    limits = {
        limit: excess
        for name, value in trial.columns.items()
        for limit, excess in plan.columns[name].limits(name, value).items()
    }
    return create_trial(
        state=TOLD[trial.value is not None], value=trial.value, params=trial.params,
        distributions=dict(space), user_attrs=trial.notes | shown | trial.columns,
        constraints=limits if trial.value is not None else None,
    )  # fmt: skip


def show(bench: Bench) -> None:
    """Bring the study that the dashboard shows up to date with the entries.

    Its trials are those of the bench, by number. It is made of the entries whenever it does not
    follow from them: also after a command that was killed between the two.
    """
    plan, state, storage = bench.plan, bench.state, bench._journal.storage
    study = optuna.create_study(
        storage=storage, study_name=plan.name, direction=plan.direction, load_if_exists=True
    )
    space = bench.space
    gone = create_trial(state=TrialState.FAIL, user_attrs={"note": "undone"})
    wanted = [
        frozen(state.trials[number], space, plan) if number in state.trials else gone
        for number in range(state.count)
    ]
    for trial, own in zip_longest(study.get_trials(deepcopy=False), wanted):
        if trial is None:
            study.add_trial(own)
        elif own is None or not _shows(study, trial, own):
            optuna.delete_study(study_name=plan.name, storage=storage)
            show(bench)
            return


def _shows(study: optuna.Study, trial: FrozenTrial, wanted: FrozenTrial) -> bool:
    """Whether a trial shows what is wanted, perhaps after it was finished, if it was running."""
    parts = ("state", "values", "params", "user_attrs")
    if all(getattr(trial, part) == getattr(wanted, part) for part in parts):
        return True
    unfinished = trial.state is TrialState.RUNNING and wanted.state is not TrialState.FAIL
    if not unfinished or trial.params != wanted.params:
        return False
    storage, number = study._storage, trial._trial_id
    for key, value in wanted.user_attrs.items():
        storage.set_trial_user_attr(number, key, value)
    for key, value in wanted.system_attrs.items():
        storage.set_trial_system_attr(number, key, value)
    return wanted.state is TrialState.RUNNING or storage.set_trial_state_values(
        number, wanted.state, wanted.values
    )
