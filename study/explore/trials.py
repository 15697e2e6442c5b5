"""The trials of a study as rows of a store: parameters, values, and attributes that are numbers.

The study may be anybody's, in a SQLite file or a journal of Optuna's. Of a study of the
walker, trials have gains; of one that this project ran, also the setting in which they
walked.
"""

import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import optuna
import pyarrow as pa
from optuna.storages.journal import JournalFileBackend
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from storage.databases.studies import load_whole, read_studies
from storage.databases.urls import file_url
from storage.inputs.errors import InputError, listed
from storage.inputs.reading import is_file, json_document, reading
from storage.simulator import SIMULATOR_KEY, WALKER
from storage.store import Store, open_store
from study.experiment import folder
from study.explore.words import Tables
from study.report.runs import goals_of
from taichi_nmm.parameters import GAIN_NAMES

TRIAL, STATE, VALUE = "trial", "state", "value"  # the first columns
SETTING = {"seed", "simulation", "body", "ground"}  # of a walker's experiment
OTHERWISE = "a store or a study database; for others: taichi-nmm report, dashboard or bench serve"
STORE_START = b"PAR1"  # of a Parquet file
BEGUN = tuple({*TrialState} - {TrialState.WAITING})
MOST_LISTED = 8  # studies; of more, the runs are not told apart


@dataclass(frozen=True)
class Trials(Store):
    """The trials of a study that have been begun; a number that one lacks is NaN.

    Attributes:
        ROW: name of the column of the trials' numbers.
        study: its name, with which `walk --trial STUDY/NUMBER` begins.
        rows: the table, a row a trial.
        best: number of the best trial, by its first value.
        document: of the walker's experiment, and the study's "run"; empty: unknown.
        goals: of a study of two, what their columns are called; empty: it has another
            number of them.
        front: numbers of the trials that no other beats in both goals.
    """

    ROW: ClassVar[str] = TRIAL

    study: str
    rows: pa.Table
    best: int
    document: Tables
    goals: dict[str, str]
    front: list[int]

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
    file = database if is_file(database) else path
    start = STORE_START
    if is_file(file):
        wanted = "a file that can be read"
        with reading("folder", file, wanted), file.open("rb") as content:
            start = content.read(len(STORE_START))
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
    names = [
        study.study_name
        for study in storage.get_all_studies()
        if name or storage.get_n_trials(study._study_id)
    ]
    if name is None and len(names) == 1:
        name = names[0]
    if name is None or name not in names:
        short = [re.sub(r"run-\d+$", "run-NNN", each) for each in names]
        shown = dict.fromkeys(names if len(names) <= MOST_LISTED else short)
        allowed = "a study with trials"
        if names:
            allowed = f"--study with one of {listed(shown, name or '')}"
        raise InputError("study", name or "none named", f"{allowed}, of {file}")
    study = load_whole(storage, name)
    trials = study.get_trials(deepcopy=False, states=BEGUN)
    sign = -1.0 if study.directions[0] is StudyDirection.MAXIMIZE else 1.0
    ranked = [
        (sign * trial.values[0], trial.number) for trial in trials if trial.values
    ]
    if not ranked:
        raise InputError("study", name, "a study of which a trial has a value")
    _, best = min(ranked)
    table, parameters = _table(trials)
    document = _document(study, file)
    goals = _goals(study, document)
    fixed = document.get("fixed_gains", {})
    walks = {*parameters, *fixed}.issuperset(GAIN_NAMES)
    return Trials(
        path=Path(name.replace("/", "-")),
        files=(),
        footers=({"rows": len(table)},),
        columns=tuple(table.column_names),
        specification={
            SIMULATOR_KEY: WALKER if walks else f"study {name}",
            "gains": dict.fromkeys(parameters),
            "fixed_gains": fixed,
        },
        study=name,
        rows=table,
        best=best,
        document=document,
        goals=goals,
        front=[trial.number for trial in study.best_trials] if goals else [],
    )


def _goals(study: optuna.Study, document: Tables) -> dict[str, str]:
    """Names of two goals by their columns, and what they pay for where this project knows."""
    columns = (VALUE, f"{VALUE}_1")
    if len(study.directions) != len(columns):
        return {}
    paid: dict[str, str] = {}
    with suppress(AttributeError):  # a study may say anything of itself
        paid = goals_of(document.get("objective", {}))
    names = study.metric_names or columns
    return {
        column: ": ".join(filter(None, (name, paid.get(name))))
        for column, name in zip(columns, names, strict=True)
    }


def _document(study: optuna.Study, file: Path) -> Tables:
    """What a study of the walker says of itself, or the comparison in whose folder it is."""
    known = study.user_attrs.get(folder.LIVE_ATTRIBUTE)
    beside = file.with_name(folder.EXPERIMENT_NAME)
    if isinstance(known, str) and is_file(beside):  # the name of a comparison
        compared = json_document("storage", beside, "a comparison's document")
        known = compared if compared.get("name") == known else {}
    _, _, run = study.study_name.rpartition("run-")
    if isinstance(known, dict) and known.keys() >= SETTING and run.isdecimal():
        return known | {"run": int(run)}
    return {}


def _table(trials: list[FrozenTrial]) -> tuple[pa.Table, list[str]]:
    """Columns of trials, and the names of those that are parameters.

    Names become words, each of one column, as selections need them.
    """
    columns: Tables = {
        TRIAL: [trial.number for trial in trials],
        STATE: [trial.state.name.lower() for trial in trials],
    }
    searched = [trial.params for trial in trials]
    parameters = []
    for part in (
        [
            {f"{VALUE}_{place}" if place else VALUE: value for place, value in each}
            for each in (enumerate(trial.values or ()) for trial in trials)
        ],
        searched,
        [trial.user_attrs for trial in trials],
    ):
        for key in dict.fromkeys(key for each in part for key in each):
            name = re.sub(r"\W", "_", key)
            while name in columns:
                name += "_"
            found = [each.get(key) for each in part]
            if all(value is None or isinstance(value, int | float) for value in found):
                columns[name] = np.array(found, np.float64)  # None becomes NaN
            elif part is searched:
                columns[name] = list(map(str, found))
            if part is searched:
                parameters.append(name)
    return pa.table(columns), parameters
