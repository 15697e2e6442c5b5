"""A bench: what to try next on a real machine, what came of it, and what all of it tells.

The entries are kept by `journal`; `advice` computes from them what comes next and what
is best, and `doubts` what was perhaps entered wrongly.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import optuna
from optuna.distributions import (
    BaseDistribution,
    distribution_to_json,
    json_to_distribution,
)

from storage.databases.studies import read_errors, shown_url
from storage.inputs import checks
from storage.inputs.errors import InputError, listed
from storage.tables import difference
from study.bench.advice import EXPECTED, Advice, Recommended, simulated_range
from study.bench.doubts import Range, doubts, odd_failures, odd_value
from study.bench.journal import Entry, Journal, State, Trial, read_state, undoable
from study.bench.plan import Column, Goal, Plan, read_plan
from study.bench.shown import require_shown, show
from study.bench.words import operator_here, require_names
from study.sampler.space import as_suggested, printed_tolerance
from study.sampler.table import FeatureTable

WHOLE, VALUE = checks.whole(0), checks.optional(checks.number())
COLUMNS = checks.optional(checks.by_name(checks.number()))
MOST_BATCH = 1000


class Own(NamedTuple):
    """A trial that nobody proposed.

    Attributes:
        params: its parameters, by name.
        value: in the unit of the goal.
        columns: other numbers, by the names of the bench's columns, in their units.
        note: of whoever enters it.
        failed: whether it failed.
        context: in which it was tried; None: the present one.
        operator: who tried it; None: who enters it.
        time: of the trial, ISO 8601; None: of the entry.
    """

    params: Mapping[str, Any]
    value: float
    columns: Mapping[str, float] = {}
    note: str = ""
    failed: bool = False
    context: str | None = None
    operator: str | None = None
    time: str | None = None


class Bench:
    """A file of a bench, with the entries in its database.

    Args:
        path: of the TOML file.
        operator: who makes the entries; by default the user and the machine.

    Attributes:
        operator: the same; it may be changed between entries.

    Raises:
        InputError: naming the key of the file; or the bench was begun with another
            file.
    """

    def __init__(self, path: str | Path, operator: str | None = None) -> None:
        self.plan: Plan = read_plan(Path(path))
        self.operator = operator or operator_here()
        self._journal = Journal(self.plan.url, self.plan.name)
        self._entries = self._journal.entries()
        if not self._entries:
            return
        with read_errors(self.plan.url):  # which somebody may have edited
            begun, _ = (
                self._begun["plan"],
                (self.space, self._begun["range"], self.state),
            )
            found = difference(self.plan.document, begun)
        if found:
            field, ours, theirs = found
            allowed = f"{theirs!r}, with which the bench was begun; or another name for a new one"
            raise InputError(f"{self.plan.path.name}: {field}", ours, allowed)

    @classmethod
    def new(cls, path: str | Path, operator: str | None = None) -> "Bench":
        """Begin a bench, or open the one that was begun with this file.

        Args:
            path: of the TOML file.
            operator: as of a `Bench`.
        """
        bench = cls(path, operator)
        candidates = bench.candidates
        if not bench._entries:
            simulated = simulated_range(candidates.rows)
            _require_limits(bench.plan.columns)
            _require_failures(bench.plan.goal, simulated)
        with bench._turn():
            if not bench._entries:
                space = candidates.rows.space.as_dict()
                require_names(bench.plan.columns, space)
                begun = {
                    "plan": bench.plan.document,
                    "digest": candidates.digest,
                    "space": {
                        name: distribution_to_json(of) for name, of in space.items()
                    },
                    "range": simulated,
                }
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
        return {
            name: json_to_distribution(text)
            for name, text in self._begun["space"].items()
        }

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
            allowed = (
                "the candidates with which the bench was begun (their digest differs); for others: "
                "`export` the trials, begin a new bench under another name, and `import` them"
            )
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
            mine, asked = self._mine(state), list[Trial]()
            advice = self._advice(state)
            if repeat is not None:
                again = state.trial(repeat, finished=True)
                running = [trial for trial in mine if trial.params == again.params]
                mine = [*running, *(trial for trial in mine if trial not in running)]
                if not running:
                    why = f"Once more what trial {repeat} was."
                    asked.append(self._new(state, len(asked), again.params, {}, why))
                    mine = mine[: batch - 1]
            while len(mine) + len(asked) < batch:
                asked.append(self._new(state, len(asked), *advice.propose(asked)))
            if asked:
                told = _with_expectations(advice, asked)
                self._add("next", {"trials": [_given(trial) for trial in told]})
            new = [self.state.trials[trial.number] for trial in asked]
            return [*_with_expectations(advice, mine[:batch]), *new]

    def pending(self) -> list[Trial]:
        """Trials without a result, with what is expected of each by now."""
        state, found = self.state, list[Trial]()
        pending = [trial for trial in state.trials.values() if trial.value is None]
        for context in dict.fromkeys(trial.context for trial in pending):
            trials = [trial for trial in pending if trial.context == context]
            found += _with_expectations(
                self._advice(replace(state, context=context)), trials
            )
        return found

    def expected(self, params: Sequence[Mapping[str, Any]]) -> list[str]:
        """What is expected of each candidate by now, in a sentence.

        Args:
            params: of the candidates, by name.
        """
        return self._advice(self.state).expected(params)

    def _mine(self, state: State) -> list[Trial]:
        """Trials of the present context that this operator has not entered yet."""
        return [
            trial
            for trial in state.of_context(state.context)
            if trial.value is None and trial.operator == self.operator
        ]

    def _new(
        self,
        state: State,
        place: int,
        params: dict[str, Any],
        notes: dict[str, Any],
        why: str,
    ) -> Trial:
        """The trial of this place among those of an entry that is about to be made."""
        number = state.count + place
        return Trial(number, params, notes, state.context, self.operator, why)

    @checks.checked(
        number=WHOLE, value=VALUE, failed_s=VALUE, columns=COLUMNS, note=checks.text
    )
    def record(
        self,
        number: int,
        value: float | None = None,
        *,
        failed_s: float | None = None,
        columns: Mapping[str, float] | None = None,
        note: str = "",
    ) -> None:
        """Enter the result of a trial: its value, or after how many seconds it failed.

        Args:
            number: of a pending trial.
            value: its result, in the unit of the goal; may be left out of a trial that
                failed.
            failed_s: after how many seconds it failed; None: it did not.
            columns: other numbers, by the names of the bench's columns, in their units.
            note: of whoever enters it.

        Raises:
            InputError: no pending trial, no finite number, or a column that the file
                has not.
        """
        if value is None and failed_s is None:
            raise InputError(
                "value", None, "the trial's value, or after how long it failed"
            )
        kind = "record" if failed_s is None else "fail"
        self._tell(kind, number, self._checked(value, columns, note, failed_s))

    @checks.checked(
        number=WHOLE, value=VALUE, failed_s=VALUE, columns=COLUMNS, note=checks.text
    )
    def correct(
        self,
        number: int,
        value: float | None = None,
        *,
        failed_s: float | None = None,
        columns: Mapping[str, float] | None = None,
        note: str = "",
    ) -> None:
        """Replace what was entered of a finished trial; what is not given stays.

        With a value, a trial that failed is a failure no longer; with `failed_s`, it is
        one.

        Args:
            number: of a finished trial.
            value: as of `record`; None: it stays.
            failed_s: likewise.
            columns: those that change.
            note: "": it stays.

        Raises:
            InputError: nothing to replace; or as `record`.
        """
        if value is None and failed_s is None and not columns and not note:
            allowed = "something to correct: the value, the time of a failure, a column or the note"
            raise InputError("correct", number, allowed)
        self._tell("correct", number, self._checked(value, columns, note, failed_s))

    @checks.checked(number=WHOLE, note=checks.text)
    def abort(self, number: int, note: str = "") -> None:
        """Enter that a trial was broken off: nothing is learned, and it is the next one again.

        Args:
            number: of a pending trial.
            note: why.
        """
        with self._turn() as state:
            state.trial(number, finished=False)
            self._add("abort", {"trial": number, "note": note})

    def add(self, rows: Sequence[Own | tuple[Any, ...]]) -> list[int]:
        """Enter trials that nobody proposed, as `Own` has them; their numbers.

        Parameters are those of a row, or of an earlier trial, if they are as printed (8
        digits).

        Raises:
            InputError: a parameter is missing, unknown or out of its range, by name; or
                a result as of `record`. Nothing is entered then.
        """
        return self._add_own([Own(*row) for row in rows], twice=True)[0]

    def add_new(self, rows: Sequence[Own]) -> tuple[list[int], list[int]]:
        """The same for those that are not there yet, such as the rows of a file that has grown.

        A trial with these parameters, in this context, of which this value was ever
        entered, is one of the rows; each trial is one row at most.

        Returns:
            Numbers of the new trials, and of those that were there.
        """
        return self._add_own(rows, twice=False)

    def _add_own(
        self, own: Sequence[Own], *, twice: bool
    ) -> tuple[list[int], list[int]]:
        """Numbers of the trials that were entered, and of those that were there, if that counts."""
        for row in own:
            checks.flag("failed", row.failed)
            for name in ("context", "operator", "time"):
                checks.optional(checks.text)(name, getattr(row, name))
        checked = [self._params(row.params) for row in own]
        results = [
            self._checked(checks.number()("value", row.value), row.columns, row.note)
            for row in own
        ]
        with self._turn() as state:
            trials = list[dict[str, Any]]()
            others, known = list(state.trials.values()), list[int]()
            for row, params, result in zip(own, checked, results, strict=True):
                params = _as_known(params, state.trials.values())
                trial = self._new(state, len(trials), params, {}, "The operator's own.")
                trial.context = state.context if row.context is None else row.context
                same = [other for other in others if _is_same(trial, row.value, other)]
                if same and not twice:
                    others.remove(same[0])
                    known.append(same[0].number)
                    continue
                given = _given(trial) | result | {"failed": bool(row.failed)}
                told = {"operator": row.operator, "time": row.time}
                trials.append(given | {key: word for key, word in told.items() if word})
            if trials or twice:
                self._add("add", {"trials": trials})
        return [trial["number"] for trial in trials], known

    @checks.checked("context.", name=checks.text)
    def context(self, name: str) -> None:
        """Go on in another context: other ground, shoes or motors; or in one that was before."""
        with self._turn() as state:
            if name == state.context:
                raise InputError("context", name, "another one than the present")
            self._add("context", {"name": name})

    @checks.checked("undo.", number=checks.optional(WHOLE))
    def undo(self, number: int | None = None) -> Entry:
        """Undo an entry, by default the operator's own last one; an undoing can be undone.

        Raises:
            InputError: no such entry stands, a later one is about the same trial, or
                all that stand are of others: these are undone by their numbers.
        """
        with self._turn():
            chosen = undoable(self._entries, number, self.operator)
            self._add("undo", {"entry": chosen.number})
        return chosen

    def best(self) -> Recommended:
        """The trial of the present context that is best by the model, with its interval.

        Raises:
            InputError: no trial is finished that neither failed nor broke a limit.
        """
        return self._advice(self.state).best()

    def repeat(self) -> int | None:
        """The trial of which a repeat would tell most: the least sure one that may be the best."""
        return self._advice(self.state).repeat()

    def worth(self) -> str:
        """Which simulated worlds the machine is like, or what the features are worth."""
        return self._advice(self.state).worth()

    def simulated(self) -> dict[int, float]:
        """The mean over the worlds of each finished trial; none without worlds."""
        rows = self.candidates.rows
        told = [
            trial for trial in self.state.trials.values() if trial.value is not None
        ]
        if not told or rows.worlds is None:
            return {}
        known = rows.worlds.costs @ rows.worlds.weights
        places = rows.space.unit(
            np.array([rows.space.row(trial.params) for trial in told])
        )
        values = rows.mixed(known[rows.numbers][:, None], places, places)[:, 0].tolist()
        return dict(zip([trial.number for trial in told], values, strict=True))

    def _tell(self, kind: str, number: int, result: dict[str, Any]) -> None:
        with self._turn() as state:
            trial = state.trial(number, finished=kind == "correct")
            if trial.failed and result["value"] is not None and "seconds" not in result:
                result["failed"] = False
            self._add(kind, {"trial": number} | result)

    def _checked(
        self,
        value: float | None,
        columns: Mapping[str, float] | None,
        note: str,
        failed_s: float | None = None,
    ) -> dict[str, Any]:
        """A result as an entry has it."""
        if value is not None and failed_s is not None:
            allowed = "the value, or after how long it failed, not both"
            raise InputError("seconds", failed_s, allowed)
        for name, given in (COLUMNS("columns", columns) or {}).items():
            if name not in self.plan.columns:
                known = (
                    listed(self.plan.columns, name)
                    or "none: [columns] of the file names them"
                )
                raise InputError(name, given, f"one of the columns {known}")
        note = checks.text("note", note)
        result = {"value": value, "columns": dict(columns or {}), "note": note}
        if failed_s is None:
            return result
        return result | {
            "value": self.plan.goal.of_failure(failed_s),
            "seconds": failed_s,
        }

    def _params(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters of the operator's own, each of its type and in its range."""
        space = self.space
        for name in dict.fromkeys([*space, *params]):
            if name not in space or name not in params:
                what = params.get(name, "missing")
                raise InputError(
                    name, what, f"one value of each of {listed(space, name)}"
                )
        found = dict[str, Any]()
        for name, of in space.items():
            try:
                found[name] = as_suggested(of, params[name])
            except ValueError:
                raise InputError(name, params[name], str(of)) from None
        return found

    def odd(self, value: float) -> str:
        """A warning of a value that no simulated world has, or far from those of all trials."""
        told = [trial.value for trial in self.state.trials.values()]
        others = [other for other in told if other is not None]
        if value in others:
            others.remove(value)  # the one that was just entered
        return odd_value(value, self._simulated, others)

    def doubts(self, number: int | None = None) -> list[str]:
        """What was perhaps entered wrongly, a line each.

        Args:
            number: of the trial that is asked about; None: all, and the file of the
                bench.
        """
        found = doubts(self.plan, self.state, self._simulated)
        if number is not None:
            return [f"trial {number}: {found[number]}"] if number in found else []
        lines = [f"trial {which}: {said}" for which, said in found.items()]
        return [*odd_failures(self.plan, self._simulated), *lines]

    @property
    def _simulated(self) -> Range | None:
        found: Range | None = self._begun["range"]
        return found

    def shown(self) -> optuna.Study:
        """The study that the dashboard shows."""
        return optuna.load_study(
            study_name=self.plan.name, storage=self._journal.storage
        )

    @property
    def _begun(self) -> Mapping[str, Any]:
        """The first entry."""
        return self._entries[0].data

    @contextmanager
    def _turn(self) -> Iterator[State]:
        """Alone, after the entries of others; in the end what is shown follows from all entries."""
        with self._journal.turn():
            self._entries = self._read()
            require_shown(self._journal.storage, self.plan)
            yield self.state
            show(self._journal.storage, self.plan, self.space, self.state)

    def _add(self, kind: str, data: Mapping[str, Any]) -> None:
        self._entries.append(self._journal.append(kind, data, self.operator))

    def _advice(self, state: State) -> Advice:
        return Advice(self.plan, self.candidates, self.space, state, self._simulated)


def _with_expectations(advice: Advice, trials: Sequence[Trial]) -> list[Trial]:
    """Trials with what is expected of them by now."""
    expected = advice.expected([trial.params for trial in trials])
    reasons = [trial.why.partition(EXPECTED)[0].strip() for trial in trials]
    return [
        replace(trial, why=f"{reason} {sentence}".strip())
        for trial, reason, sentence in zip(trials, reasons, expected, strict=True)
    ]


def _stands_for(typed: Any, value: Any) -> bool:
    """Whether something typed is a value as a sheet has it."""
    if isinstance(typed, float) and isinstance(value, float):
        return abs(typed - value) <= printed_tolerance(typed)
    return bool(typed == value)


def _is_same(new: Trial, value: float, other: Trial) -> bool:
    """Whether a trial of this value is there already, perhaps corrected since."""
    alike = new.params == other.params and new.context == other.context
    return alike and value in other.values


def _as_known(params: dict[str, Any], trials: Iterable[Trial]) -> dict[str, Any]:
    """Parameters that are as printed those of an earlier trial are that trial's."""
    for trial in trials:
        if all(
            _stands_for(params[name], value) for name, value in trial.params.items()
        ):
            return trial.params
    return params


def _given(trial: Trial) -> dict[str, Any]:
    """A new trial as an entry has it."""
    fields = asdict(trial)
    return {
        name: fields[name] for name in ("number", "params", "notes", "why", "context")
    }


def _require_failures(goal: Goal, simulated: Range | None) -> None:
    """Refuse failures that are worth more than a success, or than all that was simulated."""
    sign = -1.0 if goal.maximise else 1.0
    for key, value in goal.failures.items():
        if goal.success is not None and sign * value < sign * goal.success:
            allowed = f"a value worse than goal.success, {goal.success:g}"
            raise InputError(f"goal.{key}", value, allowed)
        if simulated is not None and sign * value < min(
            sign * end for end in simulated
        ):
            least, most = simulated
            allowed = f"a value worse than the best one simulated, of {least:.4g} to {most:.4g}"
            raise InputError(f"goal.{key}", value, allowed)
    if goal.failed is not None and sign * goal.failed[0] < sign * goal.failed[1]:
        allowed = f"a value no worse than goal.failed_at_once, {goal.failed[0]:g}"
        raise InputError("goal.failed_at_end", goal.failed[1], allowed)


def _require_limits(columns: Mapping[str, Column]) -> None:
    """Refuse limits that no number keeps."""
    for name, column in columns.items():
        if column.least > column.most:
            allowed = f"a number up to columns.{name}.most, {column.most:g}"
            raise InputError(f"columns.{name}.least", column.least, allowed)
