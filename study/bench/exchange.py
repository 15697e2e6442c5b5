"""Trials of a bench as a file, and from one: all that a trial is goes out and comes in again."""

import csv
import math
import warnings
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from storage.foreign_tables import ForeignTable
from storage.inputs.errors import InputError, listed
from study.bench.bench import Bench, Own
from study.bench.candidates import choices_of
from study.bench.words import plain

WORDS = ("context", "operator", "time", "note")  # columns that are never numbers


def export_text(bench: Bench) -> str:
    """All trials as CSV, pending ones without a value."""
    parameters, columns = list(bench.space), list(bench.plan.columns)
    text = StringIO()
    write = csv.writer(text, lineterminator="\n").writerow
    head = ["trial", "context", "value", "failed"]
    write([*head, *parameters, *columns, "operator", "time", "note"])
    for trial in bench.state.trials.values():
        row: list[Any] = [trial.number, trial.context, trial.value, int(trial.failed)]
        row += [trial.params[name] for name in parameters]
        row += [trial.columns.get(name) for name in columns]
        write([*row, trial.operator, trial.time, trial.note])
    return text.getvalue()


def read_trials(bench: Bench, path: Path) -> list[Own]:
    """The finished trials of a file; those without a value are left out.

    It needs the parameters and `value`. Columns of the bench, and the others of an
    export, count where they are there: without `context` the trials are of the present
    one.

    Raises:
        InputError: naming the column and what is wrong.
    """
    columns = bench.plan.columns
    choices = {name: choices_of(each) for name, each in bench.space.items()}
    named = [name for name, known in choices.items() if known]
    file = ForeignTable.read("import", path, words=[*WORDS, *named])
    _require_used(file.names, [*choices, *columns, "trial", "value", "failed", *WORDS])
    params = {name: _parameter(file, name, known) for name, known in choices.items()}
    values = file.numbers("value")
    told = {name: file.numbers(name) for name in columns if name in file.names}
    words = {name: file.words(name) for name in WORDS if name in file.names}
    failed = np.zeros(len(file))
    if "failed" in file.names:
        failed = np.nan_to_num(file.numbers("failed"))
        if not np.isin(failed, (0.0, 1.0)).all():
            raise InputError("import: failed", "other numbers", "0 or 1 in each row")
    is_empty = np.isnan(values)
    if (is_empty & (failed > 0.0)).any():
        row = int((is_empty & (failed > 0.0)).argmax())
        allowed = "the value of each trial that failed"
        raise InputError(f"import.value[{row}]", "nothing", allowed)
    if is_empty.all():
        raise InputError("import", str(path), "a file with a value in one row at least")
    found = list[Own]()
    for place in np.flatnonzero(~is_empty).tolist():
        numbers = {name: float(given[place]) for name, given in told.items()}
        said = {name: given[place] for name, given in words.items()}
        own = Own(
            params={name: given[place] for name, given in params.items()},
            value=float(values[place]),
            columns={name: n for name, n in numbers.items() if not math.isnan(n)},
            failed=bool(failed[place]),
            **said,
        )
        found.append(own)
    return found


def _require_used(names: Sequence[str], known: Sequence[str]) -> None:
    """Refuse a column that is one of these but for its spelling; warn of others.

    Raises:
        InputError: naming the column.
    """
    others = [name for name in names if name not in known]
    meant = {plain(name): name for name in known}
    for name in others:
        if plain(name) in meant:
            allowed = f"{meant[plain(name)]}, as the bench has it"
            raise InputError("import", name, allowed)
    if others:
        unused = f"columns that are no part of a trial: {listed(others)}"
        warnings.warn(unused, stacklevel=3)


def _parameter(file: ForeignTable, name: str, choices: Mapping[str, Any]) -> list[Any]:
    """A column of a parameter, of its type; `choices` by what a file has for them, if any."""
    given = file.values(name)
    if choices:
        said = ["" if word is None else str(word) for word in given.tolist()]
        return [choices.get(word, word) for word in said]
    numbers = file.numbers(name) if given.dtype.kind == "O" else given
    return list(numbers.tolist())
