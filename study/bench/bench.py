"""A bench: what to try next on a real machine, what came of it, and what all of it tells.

The entries are kept by `journal`; `advice` computes from them what comes next and what
is best, and `doubts` what was perhaps entered wrongly.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import optuna
from optuna.distributions import (
    BaseDistribution,
    distribution_to_json,
    json_to_distribution,
)

from storage.databases.files import read_errors, shown_url
from storage.inputs import checks
from storage.inputs.documents import difference
from storage.inputs.errors import InputError, listed
from storage.inputs.version import __version__
from study.bench.advice import (
    EXPECTED,
    NOT_ENTERED,
    Advice,
    Recommended,
    places_of,
    simulated_range,
)
from study.bench.doubts import Range, doubts, odd_failures
from study.bench.journal import Entry, Journal, State, Trial, read_state, undoable
from study.bench.limits import require_limits
from study.bench.own import COLUMNS, LINE, a_trial
from study.bench.own import Own as Own
from study.bench.plan import Plan, read_plan, require_failures
from study.bench.shown import require_shown, show
from study.bench.words import operator_here, require_names
from study.sampler.space import as_suggested, printed_tolerance
from study.sampler.table import FeatureTable

WHOLE = checks.whole(0)
RESULT = {
    "number": WHOLE,
    "value": checks.optional(checks.number()),
    "failed_s": checks.optional(checks.number()),
    "columns": checks.optional(COLUMNS),
    "note": LINE,
}
MOST_BATCH = 1000


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

    @checks.checked(path=checks.path, operator=checks.optional(checks.text))
    def __init__(self, path: str | Path, operator: str | None = None) -> None:
        self.plan: Plan = read_plan(Path(path))
        self.operator = operator or operator_here()
        self.journal = Journal(self.plan.url, self.plan.name)
        self._entries = self.journal.entries()
        if not self._entries:
            return
        with read_errors(self.plan.url):  # which somebody may have edited
            found = difference(self.plan.document, self._begun["plan"])
            _ = self.space, self._simulated, self.state  # all of it can be read
        if found:
            field, ours, theirs = found
            begun = "without it" if theirs is None else f"with {theirs!r}"
            allowed = f"as the bench was begun, {begun}; or another name for a new one"
            value = "none" if ours is None else ours
            raise InputError(f"{self.plan.path.name}: {field}", value, allowed)

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
            require_limits(bench.plan.columns)
            require_failures(bench.plan.goal, simulated)
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
        found = self.journal.entries()
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
            InputError: no candidate is left, or none within [safety] and [limit].
        """
        with self._turn() as state:
            advice = self._advice(state)
            mine = [
                trial
                for trial in state.pending
                if (trial.context, trial.operator) == (state.context, self.operator)
            ]
            asked = list[Trial]()
            if repeat is not None:
                again = state.trial(repeat, finished=True).params
                mine.sort(key=lambda trial: trial.params != again)
                if not mine or mine[0].params != again:
                    why = f"Once more what trial {repeat} was."
                    asked.append(self._new(state, len(asked), again, {}, why))
                    mine = mine[: batch - 1]
            while len(mine) + len(asked) < batch:
                asked.append(self._new(state, len(asked), *advice.propose(asked)))
            if asked:
                told = _with_expectations(advice, asked)
                self._add("next", {"trials": [_given(trial) for trial in told]})
            new = [self.state.trials[trial.number] for trial in asked]
            found = [*_with_expectations(advice, mine[:batch]), *new]
            if advice.sampler.errors.keys() != self._errors.keys():
                self.journal.set(self._errors_key, advice.sampler.errors)
            return found

    def _new(
        self,
        state: State,
        place: int,
        params: dict[str, Any],
        notes: dict[str, Any],
        why: str,
    ) -> Trial:
        """The trial of this place among those of an entry that is about to be made."""
        return Trial(
            number=state.count + place,
            params=params,
            notes=notes,
            context=state.context,
            operator=self.operator,
            why=why,
        )

    def pending(self) -> list[Trial]:
        """Trials without a result, with what is expected of each by now."""
        state = self.state
        found = list[Trial]()
        for context in dict.fromkeys(trial.context for trial in state.pending):
            trials = [trial for trial in state.pending if trial.context == context]
            advice = self._advice(replace(state, context=context))
            found += _with_expectations(advice, trials)
        return found

    @checks.checked(params=checks.each(checks.by_name(checks.anything)))
    def expected(self, params: Sequence[Mapping[str, Any]]) -> list[str]:
        """What is expected of each candidate by now, in a sentence.

        Args:
            params: of the candidates, by name.
        """
        return self._advice(self.state).expected(params)

    @checks.checked(**RESULT)
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
            allowed = "the trial's value, or after how long it failed"
            raise InputError("value", None, allowed)
        result = self._result(value, failed_s, columns, note)
        with self._turn() as state:
            state.trial(number, finished=False)
            kind = "record" if failed_s is None else "fail"
            self._add(kind, {"trial": number} | result)

    @checks.checked(**RESULT)
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
        result = self._result(value, failed_s, columns, note)
        with self._turn() as state:
            trial = state.trial(number, finished=True)
            if trial.failed and value is not None:
                result["failed"] = False
            self._add("correct", {"trial": number} | result)

    @checks.checked(number=WHOLE, note=LINE)
    def abort(self, number: int, note: str = "") -> None:
        """Enter that a trial was broken off: nothing is learned, and it is the next one again.

        Args:
            number: of a pending trial.
            note: why.
        """
        with self._turn() as state:
            state.trial(number, finished=False)
            self._add("abort", {"trial": number, "note": note})

    @checks.checked(rows=checks.each(a_trial))
    def add(self, rows: Sequence[Own | tuple[Any, ...]]) -> list[int]:
        """Enter trials that nobody proposed, as `Own` has them; their numbers.

        Parameters are those of a row, or of an earlier trial, if they are as printed (8
        digits).

        Raises:
            InputError: a parameter is missing, unknown or out of its range, by name; or
                a result as of `record`. Nothing is entered then.
        """
        own = [row if isinstance(row, Own) else Own(*row) for row in rows]
        return self._add_own(own, twice=True)[0]

    @checks.checked(rows=checks.each(checks.instance(Own)))
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
        params_of = [self._params(row.params) for row in own]
        results = [self._result(row.value, None, row.columns, row.note) for row in own]
        with self._turn() as state:
            trials = list[dict[str, Any]]()
            known = list[int]()
            for row, params, result in zip(own, params_of, results, strict=True):
                params = _as_known(params, state.trials.values())
                context = state.context if row.context is None else row.context.strip()
                same = [
                    trial.number
                    for trial in state.trials.values()
                    if trial.params == params
                    and trial.context == context
                    and row.value in trial.values  # perhaps corrected since
                    and trial.number not in known
                ]
                if same and not twice:
                    known.append(same[0])
                    continue
                told = {
                    "number": state.count + len(trials),
                    "params": params,
                    "notes": {},
                    "why": "The operator's own.",
                    "context": context,
                    **result,
                    "failed": bool(row.failed),
                }
                if row.operator:
                    told["operator"] = row.operator
                if row.time:
                    told["time"] = row.time
                trials.append(told)
            if trials or twice:
                self._add("add", {"trials": trials})
        return [trial["number"] for trial in trials], known

    @checks.checked("context.", name=LINE)
    def context(self, name: str) -> None:
        """Go on in another context: other ground, shoes or motors; or in one that was before."""
        name = name.strip()
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
        """The trial of the best reading in the present context, with its interval.

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
        told = self.state.finished
        if not told or rows.worlds is None:
            return {}
        known = rows.worlds.costs @ rows.worlds.weights
        places = places_of(rows, told)
        costs = known[rows.numbers][:, None]
        values = rows.between().at(costs, places, places)[:, 0].tolist()
        return dict(zip([trial.number for trial in told], values, strict=True))

    def _result(
        self,
        value: float | None,
        failed_s: float | None,
        columns: Mapping[str, float] | None,
        note: str,
    ) -> dict[str, Any]:
        """A result as an entry has it."""
        columns = dict(columns or {})
        for name, given in columns.items():
            if name not in self.plan.columns:
                known = listed(self.plan.columns, name) or "none in [columns]"
                raise InputError(name, given, f"one of the columns {known}")
        result = {"value": value, "columns": columns, "note": note}
        if failed_s is None:
            return result
        if value is not None:
            allowed = "the value, or after how long it failed, not both"
            raise InputError("seconds", failed_s, allowed)
        result["value"] = self.plan.goal.of_failure(failed_s)
        return result | {"seconds": failed_s}

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

    @checks.checked(number=checks.optional(WHOLE))
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
            study_name=self.plan.name, storage=self.journal.storage
        )

    @property
    def _begun(self) -> Mapping[str, Any]:
        """The first entry."""
        return self._entries[0].data

    @contextmanager
    def _turn(self) -> Iterator[State]:
        """Alone, after the entries of others; in the end what is shown follows from all entries."""
        with self.journal.turn():
            self._entries = self._read()
            require_shown(self.journal, self.plan)
            yield self.state
            show(self.journal, self.plan, self.space, self.state)

    def _add(self, kind: str, data: Mapping[str, Any]) -> None:
        self._entries.append(self.journal.append(kind, data, self.operator))

    @property
    def _errors_key(self) -> str:
        """Where errors of predictions are kept, which take long to compute."""
        return f"errors {self.candidates.digest} {__version__}"

    @property
    def _errors(self) -> Mapping[str, list[float]]:
        with read_errors(self.plan.url):  # which somebody may have edited
            known = self.journal.kept(self._errors_key) or {}
            return {key: [*map(float, each)] for key, each in known.items()}

    def _advice(self, state: State) -> Advice:
        return Advice(
            self.plan,
            self.candidates,
            self.space,
            state,
            self._simulated,
            self._errors,
        )


def _with_expectations(advice: Advice, trials: Sequence[Trial]) -> list[Trial]:
    """Trials with what is expected of them by now."""
    expected = advice.expected([trial.params for trial in trials])
    reasons = [
        trial.why.partition(EXPECTED)[0].partition(NOT_ENTERED)[0].strip()
        for trial in trials
    ]
    return [
        replace(trial, why=f"{reason} {sentence}".strip())
        for trial, reason, sentence in zip(trials, reasons, expected, strict=True)
    ]


def _given(trial: Trial) -> dict[str, Any]:
    """What an entry has of a trial that is asked for."""
    names = ("number", "params", "notes", "why", "context")
    return {name: getattr(trial, name) for name in names}


def _as_known(params: dict[str, Any], trials: Iterable[Trial]) -> dict[str, Any]:
    """Parameters that are as printed those of an earlier trial are that trial's."""
    for trial in trials:
        if all(_stands_for(params[name], own) for name, own in trial.params.items()):
            return trial.params
    return params


def _stands_for(typed: Any, value: Any) -> bool:
    """Whether something typed is a value as a sheet has it."""
    if isinstance(typed, float) and isinstance(value, float):
        return abs(typed - value) <= printed_tolerance(typed)
    return bool(typed == value)
