"""The trials of a study as rows of a store: parameters, values, and attributes that are numbers.

The study may be anybody's, in a SQLite file or a journal of Optuna's. Of a study of the
walker, trials have gains; of one that this project ran, also the setting in which they
walked.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import optuna
import pyarrow as pa
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

from storage.databases.studies import load_whole, read_studies
from storage.databases.urls import file_url
from storage.inputs.errors import InputError, listed
from storage.inputs.reading import is_file, json_document, reading
from storage.simulator import SIMULATOR_KEY, WALKER
from storage.store import Store, open_store
from study.experiment import folder
from taichi_nmm.parameters import GAIN_NAMES

TRIAL, STATE, VALUE = "trial", "state", "value"  # the first columns
SETTING = {
    "seed",
    "simulation",
    "body",
    "ground",
}  # in the document of a walker's experiment
OTHERWISE = "a store or a study database; for others: taichi-nmm report, dashboard or bench serve"
MOST_LISTED = 8  # studies; of more, the runs are not told apart


@dataclass(frozen=True)
class Trials(Store):
    """The trials of a study that have been begun; a number that one lacks is NaN.

    Attributes:
        ROW: name of the column of the trials' numbers.
        rows: the table, a row a trial.
        best: number of the best trial, by its first value.
        document: of the walker's experiment, and the study's "run"; empty: unknown.
    """

    ROW: ClassVar[str] = TRIAL

    rows: pa.Table
    best: int
    document: dict[str, Any]

    def tables(self, columns: Iterable[str] | None = None) -> Iterator[pa.Table]:
        """The one table, or columns of it."""
        yield self.rows.select(list(self.columns if columns is None else columns))


def open_rows(path: Path, study: str | None = None) -> Store:
    """The rows of a store, finished or not, or the trials of a study.

    The path is that of a store, of a study database or a journal, or of a comparison's
    folder with its database. Without its name, the study is the only one that has
    trials.

    Raises:
        InputError: none of these, or damaged; no such study, or one without a value.
    """
    database = path / folder.DATABASE_NAME
    file, start = database if is_file(database) else path, b"PAR1"
    if is_file(file):
        with (
            reading("folder", file, "a file that can be read"),
            file.open("rb") as content,
        ):
            start = content.read(4)
    if start[:1] == b"{":
        with reading("storage", file, "an undamaged journal of Optuna's"):
            journal = optuna.storages.JournalStorage(JournalFileBackend(str(file)))
            return _read(journal, file, study)
    if start in (b"SQLi", b""):
        with read_studies(file_url(file)) as storage:
            return _read(storage or optuna.storages.InMemoryStorage(), file, study)
    compared = (folder.EXPERIMENT_NAME, folder.ROBOTS_NAME, folder.RESULTS_NAME)
    if path.suffix.lower() == ".toml" or any(is_file(path / name) for name in compared):
        raise InputError("folder", str(path), OTHERWISE)
    if study is not None:
        raise InputError("study", study, "none: a store has no studies")
    store = open_store(path, unfinished=True)
    store.require_bounds()
    return store


def _read(storage: optuna.storages.BaseStorage, file: Path, name: str | None) -> Trials:
    studies = storage.get_all_studies()
    names = [
        each.study_name
        for each in studies
        if name or storage.get_n_trials(each._study_id)
    ]
    name = names[0] if name is None and len(names) == 1 else name
    if name is None or name not in names:
        short = [re.sub(r"run-\d+$", "run-NNN", each) for each in names]
        shown = dict.fromkeys(names if len(names) <= MOST_LISTED else short)
        allowed = "a study with trials"
        if names:
            allowed = f"--study with one of {listed(shown, name or '')}"
        raise InputError("study", name or "none named", f"{allowed}, of {file}")
    study = load_whole(storage, name)
    trials = [
        each for each in study.get_trials(False) if each.state is not TrialState.WAITING
    ]
    sign = -1.0 if study.directions[0] is optuna.study.StudyDirection.MAXIMIZE else 1.0
    ranked = sorted(
        (sign * each.values[0], each.number) for each in trials if each.values
    )
    if not ranked:
        raise InputError("study", name, "a study of which a trial has a value")
    table, parameters, document = *_table(trials), _document(study, file)
    fixed = document.get("fixed_gains", {})
    walks = {*parameters, *fixed}.issuperset(GAIN_NAMES)
    specification = {
        SIMULATOR_KEY: WALKER if walks else f"study {name}",
        "gains": dict.fromkeys(parameters),
        "fixed_gains": fixed,
    }
    return Trials(
        Path(name.replace("/", "-")),
        (),
        ({"rows": len(table)},),
        tuple(table.column_names),
        specification,
        table,
        ranked[0][1],
        document,
    )


def _document(study: optuna.Study, file: Path) -> dict[str, Any]:
    """What a study of the walker says of itself, or the comparison in whose folder it is."""
    known, run = (
        study.user_attrs.get(folder.LIVE_ATTRIBUTE),
        study.study_name.rpartition("run-")[2],
    )
    beside, name = file.with_name(folder.EXPERIMENT_NAME), known
    if isinstance(name, str) and is_file(beside):
        known = json_document("storage", beside, "a comparison's document")
        known = known if known.get("name") == name else {}
    if (
        not isinstance(known, dict)
        or not known.keys() >= SETTING
        or not run.isdecimal()
    ):
        return {}
    return known | {"run": int(run)}


def _table(trials: list[FrozenTrial]) -> tuple[pa.Table, list[str]]:
    """Columns of trials, and the names of those that are parameters.

    Names become words, each of one column, as selections need them.
    """
    columns: dict[str, Any] = {TRIAL: [each.number for each in trials]}
    columns[STATE] = [each.state.name.lower() for each in trials]
    values = [enumerate(each.values or ()) for each in trials]
    named = [
        {f"{VALUE}_{place}" if place else VALUE: value for place, value in each}
        for each in values
    ]
    searched, noted = (
        [each.params for each in trials],
        [each.user_attrs for each in trials],
    )
    parameters = []
    for part in (named, searched, noted):
        for key in dict.fromkeys(key for each in part for key in each):
            name, found = re.sub(r"\W", "_", key), [each.get(key) for each in part]
            while name in columns:
                name += "_"
            if all(value is None or isinstance(value, int | float) for value in found):
                numbers = [np.nan if value is None else value for value in found]
                columns[name] = np.array(numbers, np.float64)
            elif part is searched:
                columns[name] = list(map(str, found))
            if part is searched:
                parameters.append(name)
    return pa.table(columns), parameters
