"""Trials of a bench as a file, and from one: all that a trial is goes out and comes in again."""

import csv
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from storage.foreign_tables import ForeignTable
from study.bench.bench import Bench, Own
from study.bench.candidates import choices_of
from taichi_nmm.errors import InputError, listed

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

    It needs the parameters and `value`. Columns of the bench, and the others of an export, count
    where they are there: without `context` the trials are of the present one.

    Raises:
        InputError: naming the column and what is wrong.
    """
    columns = bench.plan.columns
    params = _params_of(bench, path)
    file = ForeignTable.read("import", path, words=WORDS)
    values = file.numbers("value")
    told = {name: file.numbers(name) for name in columns if name in file.names}
    words = {name: file.values(name).tolist() for name in WORDS if name in file.names}
    failed = np.zeros(len(file))
    if "failed" in file.names:
        failed = np.nan_to_num(file.numbers("failed"))
        if not np.isin(failed, (0.0, 1.0)).all():
            raise InputError("import: failed", "other numbers", "0 or 1 in each row")
    found = list[Own]()
    for place in np.flatnonzero(~np.isnan(values)).tolist():
        said = {name: str(given[place] or "") for name, given in words.items()}
        own = Own(
            params={name: given[place] for name, given in params.items()},
            value=float(values[place]),
            columns={name: float(n[place]) for name, n in told.items() if not np.isnan(n[place])},
            failed=bool(failed[place]),
            note=said.get("note", ""),
            context=said.get("context"),
            operator=said.get("operator") or None,
            time=said.get("time") or None,
        )
        found.append(own)
    return found


def _params_of(bench: Bench, path: Path) -> dict[str, list[Any]]:
    """The columns of the parameters, of each one's type."""
    names = list(bench.space)
    known = ForeignTable.read("import", path)
    for name in (*names, "value"):
        if name not in known.names:
            allowed = f"a file with the columns {listed(names, name)}, value"
            raise InputError("import", name, allowed)
    choices = {name: choices_of(distribution) for name, distribution in bench.space.items()}
    named = [name for name in names if choices[name]]
    file = ForeignTable.read("import", path, words=named)
    params = dict[str, list[Any]]()
    for name in names:
        given = file.values(name)
        is_text = given.dtype.kind == "O" and name not in named
        params[name] = (file.numbers(name) if is_text else given).tolist()  # or says what is wrong
    for name in named:
        said = ["" if word is None else str(word) for word in params[name]]
        params[name] = [choices[name].get(word, word) for word in said]
    return params
