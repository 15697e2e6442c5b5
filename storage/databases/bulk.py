"""Many finished trials into a study database at once.

Optuna writes a trial in some thirty transactions, 56 ms on SQLite; the trials of an
experiment are written here a few thousand to a transaction. The tables are the
database's own, reflected, so that nothing private of Optuna is needed; a schema that is
not the known one is refused.
"""

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import sqlalchemy as sql
from optuna.storages import RDBStorage
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial

from storage.databases.studies import known_tables
from storage.databases.trial_rows import Row, attribute_rows, naive_utc, rows_of

Tables = dict[str, sql.Table]
# where `optuna.Study.set_metric_names` puts them
METRIC_ATTRIBUTE = "study:metric_names"
TRIALS_PER_TRANSACTION = 2000  # 30 rows each: some 20 MB of memory, half a second


@dataclass(frozen=True)
class FinishedStudy:
    """A study of objectives to be minimised, and finished trials for it.

    Attributes and metrics are written when the study is made.

    Attributes:
        name: in the database; once in a call.
        trials: without intermediate values, in the order of their numbers.
        first: number of the first of them; those before it are in the database already.
        user_attrs: of the study, as JSON values.
        metrics: names of its objectives; empty: it has one, without a name.
    """

    name: str
    trials: Sequence[FrozenTrial]
    first: int = 0
    user_attrs: dict[str, Any] = field(default_factory=dict)
    metrics: Sequence[str] = ()


def trial_counts(storage: RDBStorage) -> dict[str, int]:
    """How many trials each study has, by name."""
    tables = known_tables(storage)
    studies, trials = tables["studies"].c, tables["trials"].c
    query = sql.select(studies.study_name, sql.func.count(trials.trial_id))
    query = query.outerjoin(tables["trials"], trials.study_id == studies.study_id)
    with storage.engine.connect() as connection:
        return _pairs(connection, query.group_by(studies.study_name))


def study_ids(storage: RDBStorage) -> dict[str, int]:
    """The number of each study in the database, and in addresses of its dashboard, by name."""
    studies = known_tables(storage)["studies"]
    with storage.engine.connect() as connection:
        return _pairs(connection, sql.select(studies.c.study_name, studies.c.study_id))


def study_attributes(storage: RDBStorage, key: str) -> dict[str, Any]:
    """The value of a user attribute in each study that has it, by the study's name."""
    tables = known_tables(storage)
    studies, attributes = tables["studies"].c, tables["study_user_attributes"].c
    query = sql.select(studies.study_name, attributes.value_json).where(
        studies.study_id == attributes.study_id, attributes.key == key
    )
    with storage.engine.connect() as connection:
        return {
            name: json.loads(value) for name, value in _pairs(connection, query).items()
        }


def write_studies(storage: RDBStorage, studies: Iterable[FinishedStudy]) -> int:
    """Make the studies that are not there, and add the trials that they do not have yet.

    A trial is there whole or not at all, however this process ends; called again, it
    goes on. The trials are those that `optuna.study.Study.add_trial` would have made.
    Returns how many were added.

    Raises:
        InputError: a database of another Optuna version.
        ValueError: a trial that is not finished, or `first` leaves a gap.
    """
    tables = known_tables(storage)
    added = 0
    for batch in _batches(studies):
        with storage.engine.begin() as connection:
            added += _write(connection, tables, batch)
    return added


def attach(storage: RDBStorage, study: str, number: int, key: str, value: Any) -> None:
    """Add a system attribute to a finished trial, which Optuna itself does not let anyone do.

    The trial is of a study of this name, the value a plain one. An attribute that the
    trial has already is left as it is.

    Raises:
        InputError: a database of another Optuna version.
        KeyError: a trial that is not there.
    """
    tables = known_tables(storage)
    studies, trials = tables["studies"].c, tables["trials"].c
    known = tables["trial_system_attributes"].c
    with storage.engine.begin() as connection:
        _lock(connection, tables["studies"], [study])
        query = sql.select(trials.trial_id).where(
            trials.study_id == studies.study_id,
            studies.study_name == study,
            trials.number == number,
        )
        trial_id = connection.execute(query).scalar()
        if trial_id is None:
            raise KeyError(study, number)
        there = sql.select(known.key).where(
            known.trial_id == trial_id, known.key == key
        )
        if connection.execute(there).first() is None:
            row = {"trial_id": trial_id, **attribute_rows({key: value})[0]}
            _insert(connection, tables, {"trial_system_attributes": [row]})


def _batches(studies: Iterable[FinishedStudy]) -> Iterator[list[FinishedStudy]]:
    batch: list[FinishedStudy] = []
    for study in studies:
        batch.append(study)
        if sum(len(study.trials) + 1 for study in batch) >= TRIALS_PER_TRANSACTION:
            yield batch
            batch = []
    if batch:
        yield batch


def _write(
    connection: sql.Connection, tables: Tables, batch: list[FinishedStudy]
) -> int:
    ids = _study_ids(connection, tables, batch)
    trials = tables["trials"].c
    counted = sql.select(trials.study_id, sql.func.count()).group_by(trials.study_id)
    counts = _pairs(connection, counted.where(trials.study_id.in_(ids.values())))
    fresh: list[tuple[int, int, FrozenTrial]] = []  # study id, number, trial
    for study in batch:
        study_id = ids[study.name]
        have = counts.get(study_id, 0)
        if have < study.first:
            raise ValueError(
                f"{study.name}: {have} trials, so none can be number {study.first}"
            )
        numbered = enumerate(study.trials, start=study.first)
        fresh += [
            (study_id, number, trial) for number, trial in numbered if number >= have
        ]
    _insert(connection, tables, {"trials": [_trial_row(*item) for item in fresh]})
    query = sql.select(trials.study_id, trials.number, trials.trial_id).where(
        trials.study_id.in_({study_id for study_id, _, _ in fresh})
    )
    trial_ids = {
        (study_id, number): key for study_id, number, key in connection.execute(query)
    }
    rows: dict[str, list[Row]] = defaultdict(list)
    for study_id, number, trial in fresh:
        for table, row in rows_of(trial):
            rows[table].append({"trial_id": trial_ids[study_id, number]} | row)
    _insert(connection, tables, rows)
    return len(fresh)


def _trial_row(study_id: int, number: int, trial: FrozenTrial) -> Row:
    """The trial itself."""
    if not trial.state.is_finished() or trial.intermediate_values:
        raise ValueError(f"trial {number}: not finished, or with intermediate values")
    return {
        "study_id": study_id,
        "number": number,
        "state": trial.state.name,
        "datetime_start": trial.datetime_start and naive_utc(trial.datetime_start),
        "datetime_complete": trial.datetime_complete
        and naive_utc(trial.datetime_complete),
    }


def _study_ids(
    connection: sql.Connection, tables: Tables, batch: list[FinishedStudy]
) -> dict[str, int]:
    """Ids by name; the studies are made where they are missing, and locked for this transaction."""
    table = tables["studies"]
    names = [study.name for study in batch]
    _lock(connection, table, names)
    select = sql.select(table.c.study_name, table.c.study_id).where(
        table.c.study_name.in_(names)
    )
    ids = _pairs(connection, select)
    new = [study for study in batch if study.name not in ids]
    if new:
        _insert(
            connection,
            tables,
            {"studies": [{"study_name": study.name} for study in new]},
        )
        ids = _pairs(connection, select)
        rows: dict[str, list[Row]] = defaultdict(list)
        for study in new:
            own = {"study_id": ids[study.name]}
            for objective in range(len(study.metrics) or 1):
                direction = {
                    "objective": objective,
                    "direction": StudyDirection.MINIMIZE.name,
                }
                rows["study_directions"].append(own | direction)
            rows["study_user_attributes"] += [
                own | row for row in attribute_rows(study.user_attrs)
            ]
            named = {METRIC_ATTRIBUTE: list(study.metrics)} if study.metrics else {}
            rows["study_system_attributes"] += [
                own | row for row in attribute_rows(named)
            ]
        _insert(connection, tables, rows)
    return ids


def _lock(connection: sql.Connection, studies: sql.Table, names: list[str]) -> None:
    """Hold these studies until the transaction ends.

    Writing is the one way to lock that every database has; SQLite's lock lies on the
    whole file.
    """
    named = studies.c.study_name.in_(names)
    connection.execute(
        sql.update(studies).where(named).values(study_name=studies.c.study_name)
    )


def _pairs(connection: sql.Connection, query: sql.Executable) -> dict[Any, Any]:
    return {key: value for key, value in connection.execute(query)}


def _insert(
    connection: sql.Connection, tables: Tables, rows: dict[str, list[Row]]
) -> None:
    """Rows by the names of their tables."""
    for name, of_table in rows.items():
        if of_table:
            connection.execute(sql.insert(tables[name]), of_table)
