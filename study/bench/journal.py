"""The entries of a bench, of which none is ever changed, and the trials that follow from them.

An entry is one attribute of an Optuna study, `NAME (log)`, written in one transaction:
it is there, or it is not. A correction and an undoing are entries too. The trials are
read from all entries that are not undone, in their order. What a clock says decides
nothing.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from typing import TYPE_CHECKING, Any

from storage.databases import plain
from storage.databases.files import (
    only_run,
    read_attributes,
    read_errors,
    storage_errors,
)
from storage.databases.urls import is_postgresql
from storage.inputs.errors import InputError, listed

if TYPE_CHECKING:
    from optuna.storages import RDBStorage

    from study.bench.optuna_studies import OptunaStudies

LOG = " (log)"  # after the name of the study whose attributes are the entries
KEY = "entry {:06d}"
WAIT_S = 20.0  # for another command on the same bench
MOST_TOLD = 6  # results of an entry that are shown with it


@dataclass(frozen=True)
class Entry:
    """Something that an operator did.

    Attributes:
        number: among all entries, from 0.
        kind: begin, next, record, fail, correct, abort, add, context or undo.
        time: of the operator's clock, ISO 8601.
        operator: who made it.
        data: what was entered, as JSON values.
    """

    number: int
    kind: str
    time: str
    operator: str
    data: Mapping[str, Any]

    @property
    def trials(self) -> list[int]:
        """Numbers of the trials that it is about."""
        if "trials" in self.data:
            return [int(trial["number"]) for trial in self.data["trials"]]
        return [int(self.data["trial"])] if "trial" in self.data else []

    def __str__(self) -> str:
        """One line."""
        what = ", ".join(map(str, self.trials))
        if self.kind == "undo":
            what = f"entry {self.data['entry']}"
        elif self.kind == "context":
            what = self.data.get("name", what)
        results = self.data.get("trials", [self.data])
        told = "; ".join(filter(None, map(_result_text, results[:MOST_TOLD])))
        if told and len(results) > MOST_TOLD:
            told += f"; and {len(results) - MOST_TOLD} more"
        head = f"{self.number:>4}  {self.time}  {self.operator}: {self.kind} {what}".rstrip()
        return f"{head}: {told}" if told else head


def _result_text(data: Mapping[str, Any]) -> str:
    """The numbers of a result as somebody has entered them; "": there are none."""
    parts = list[str]()
    is_timed = data.get("seconds") is not None
    if is_timed:
        parts.append(f"failed after {data['seconds']:.12g} s")
    if data.get("value") is not None:
        parts.append(f"{data['value']:.12g}")
    is_correction = "params" not in data
    if data.get("failed") is False and is_correction:
        parts.append("no longer a failure")
    if data.get("failed") and not is_timed:  # of an import
        parts.append("failed")
    parts += [f"{name} {value:.12g}" for name, value in data.get("columns", {}).items()]
    return ", ".join(parts)


@dataclass
class Trial:
    """A trial as the entries leave it.

    Attributes:
        number: among all trials, from 0.
        params: its parameters, by name.
        notes: of the sampler.
        context: in which it is tried.
        operator: who has it, or had it.
        why: it was proposed, in words.
        value: in the unit of the goal; None: nobody has entered a result.
        columns: other numbers that were entered, by the names of the bench's columns,
            in their units.
        failed: whether it failed.
        note: of whoever entered its result.
        aborted: times that it was broken off and nothing learned.
        time: when its result was entered, or when it was measured, ISO 8601.
        values: all that were ever entered for it, the last one counts.
    """

    number: int
    params: dict[str, Any]
    notes: dict[str, Any]
    context: str
    operator: str
    why: str = ""
    value: float | None = None
    columns: dict[str, float] = field(default_factory=dict)
    failed: bool = False
    note: str = ""
    aborted: int = 0
    time: str = ""
    values: list[float] = field(default_factory=list)

    @property
    def result(self) -> float:
        """The value of a finished trial."""
        assert self.value is not None
        return self.value


@dataclass
class State:
    """What all entries come to.

    Attributes:
        trials: by number; those of an entry that was undone are missing.
        context: the present one; "": it has no name.
        count: of numbers that were ever given to a trial.
        undone: numbers of the entries that were undone.
    """

    trials: dict[int, Trial]
    context: str
    count: int
    undone: frozenset[int]

    def of_context(self, context: str) -> list[Trial]:
        """The trials of a context, in their order."""
        return [trial for trial in self.trials.values() if trial.context == context]

    @property
    def finished(self) -> list[Trial]:
        """The trials that have a result."""
        return [trial for trial in self.trials.values() if trial.value is not None]

    @property
    def pending(self) -> list[Trial]:
        """The trials that have none yet."""
        return [trial for trial in self.trials.values() if trial.value is None]

    def trial(self, number: int, finished: bool) -> Trial:
        """A trial of this number.

        Raises:
            InputError: there is none, or it is finished where it must not be, or the
                reverse.
        """
        found = self.trials.get(number)
        if found is not None and (found.value is not None) == finished:
            return found
        waiting = [trial.number for trial in self.pending]
        pending = listed(waiting, number) or "none"
        if self.count == 0:
            allowed = "none: ask for the next one"
        elif number < self.count and found is None:
            allowed = f"a trial whose entry stands; pending: {pending}"
        elif found is None:
            allowed = f"0 to {self.count - 1}; pending: {pending}"
        elif finished:
            allowed = "a finished trial"
        else:
            allowed = (
                f"a pending trial ({pending}); "
                "`correct` changes the result of a finished one"
            )
        raise InputError("trial", number, allowed)


class Journal:
    """The entries of one bench in a study database."""

    def __init__(self, url: str, name: str) -> None:
        self.url = url
        self.name = name
        self._known = dict[str, Any]()  # attributes, as last read

    @cached_property
    def storage(self) -> "RDBStorage":
        """The database as Optuna has it; it is made where it is missing."""
        from storage.databases.studies import open_studies

        return open_studies(self.url)

    @cached_property
    def writer(self) -> "plain.PlainStudies | OptunaStudies":
        """What writes: SQLite itself, since Optuna takes a second to begin; on a server, Optuna.

        Reading does without: also where nothing may be written.
        """
        if is_postgresql(self.url):
            from study.bench.optuna_studies import OptunaStudies

            return OptunaStudies(self.storage)
        if not plain.is_known(self.url):
            self.storage.engine.dispose()  # which has made it
        return plain.PlainStudies(self.url)

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Be the only one who writes; wait for others.

        Raises:
            InputError: another command holds the bench for long, or the database cannot
                be written.
        """
        deadline_s = time.monotonic() + WAIT_S
        with ExitStack() as held:
            while True:
                try:
                    held.enter_context(only_run(self.url, self.name + LOG))
                    break
                except InputError as error:
                    if error.field != "study" or time.monotonic() > deadline_s:
                        raise
                    time.sleep(0.1)
            with storage_errors(self.url):
                yield
                self.writer.write_down()

    def entries(self) -> list[Entry]:
        """All entries, in their order; none where the bench has not begun."""
        known, names = read_attributes(self.url, self.name + LOG)
        if known is None:
            if self.name in names:
                raise InputError("name", self.name, "a name that no other study has")
            return []
        self._known = known
        found = list[Entry]()
        with read_errors(self.url):
            while (written := known.get(KEY.format(len(found)))) is not None:
                found.append(_entry(len(found), written))
        return found

    def kept(self, key: str) -> Any:
        """What was kept beside the entries under a key when they were read; None: nothing."""
        return self._known.get(key)

    def keep(self, key: str, value: Any) -> None:
        """Keep a JSON value beside the entries of a bench that has begun."""
        with self.turn():
            self.set(key, value)

    def set(self, key: str, value: Any) -> None:
        """The same, in a turn."""
        self.writer.set_attribute(self.name + LOG, key, value)
        self._known[key] = value

    def append(self, kind: str, data: Mapping[str, Any], operator: str) -> Entry:
        """Add an entry of an operator, in a turn."""
        number = len(self.entries())
        moment = datetime.now(UTC).isoformat(timespec="seconds")
        written = {"kind": kind, "time": moment, "by": operator, **data}
        self.writer.set_attribute(self.name + LOG, KEY.format(number), written)
        return _entry(number, written)


def _entry(number: int, written: Mapping[str, Any]) -> Entry:
    """An entry as the database has it."""
    data = dict(written)
    return Entry(
        number=number,
        kind=data.pop("kind"),
        time=data.pop("time"),
        operator=data.pop("by"),
        data=data,
    )


def read_state(entries: list[Entry]) -> State:
    """The trials that follow from entries."""
    undone = set[int]()
    for entry in reversed(entries):
        if entry.kind == "undo" and entry.number not in undone:
            undone.add(int(entry.data["entry"]))
    state = State(trials={}, context="", count=0, undone=frozenset(undone))
    for entry in entries:
        state.count = max([state.count, *(number + 1 for number in entry.trials)])
        if entry.number in undone:
            continue
        data = entry.data
        if entry.kind == "context":
            state.context = data["name"]
        for given in data.get("trials", ()):
            trial = Trial(**{"operator": entry.operator, "time": entry.time} | given)
            trial.columns = dict(trial.columns)  # corrections must not reach the entry
            if trial.value is not None:
                trial.values.append(trial.value)
            state.trials[trial.number] = trial
        # Version 0.3.0 could bring an entry back whose trial is gone.
        if data.get("trial") in state.trials:
            _change(state.trials[data["trial"]], entry)
    return state


def _change(trial: Trial, entry: Entry) -> None:
    """What an entry about one trial changes."""
    data = entry.data
    if trial.value is None:
        trial.note = ""  # of a breakdown
    if entry.kind == "abort":  # who breaks it off has it again
        trial.aborted += 1
        trial.operator = entry.operator
    trial.note = data.get("note") or trial.note
    trial.columns |= data.get("columns", {})
    if data.get("value") is None:
        return
    trial.value = data["value"]
    trial.values.append(data["value"])
    trial.time = entry.time
    trial.failed = entry.kind == "fail" or data.get("seconds") is not None


def _changed_by(entry: Entry, entries: list[Entry]) -> set[int]:
    """Numbers of the trials that an entry changes; an undoing, those of what it undoes."""
    while entry.kind == "undo":
        entry = entries[entry.data["entry"]]
    return set(entry.trials)


def undoable(entries: list[Entry], number: int | None, operator: str) -> Entry:
    """The entry to undo: this one, or the operator's own last one that is no undoing itself.

    Raises:
        InputError: there is none, or a later entry stands on it.
    """
    undone = read_state(entries).undone
    standing = [entry for entry in entries[1:] if entry.number not in undone]
    if number is None:
        done = [entry for entry in standing if entry.kind != "undo"]
        found = [entry for entry in done if entry.operator == operator]
        if done and not found:
            last = " ".join(str(done[-1]).split())
            none = f"none of which is {operator}'s; the last one is {last}"
            allowed = f"the number of an entry, {none}"
            raise InputError("undo", "the last", allowed)
    else:
        found = [entry for entry in standing if entry.number == number]
    if not found:
        refused = "the last" if number is None else number
        numbers = listed([entry.number for entry in standing], number or "")
        allowed = f"an entry that stands: {numbers or 'there is none'}"
        raise InputError("undo", refused, allowed)
    chosen = found[-1]
    for later in standing:
        # An undoing counts if what it undid is earlier: what comes back must find its
        # trial there.
        stands_on = later.data.get("entry", 0) < chosen.number < later.number
        if stands_on and not _changed_by(chosen, entries).isdisjoint(
            _changed_by(later, entries)
        ):
            allowed = f"entry {later.number} first, which is about the same trial"
            raise InputError("undo", chosen.number, allowed)
    return chosen
