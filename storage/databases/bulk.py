"""Many finished trials into a study database at once.

Optuna writes a trial in some thirty transactions, 56 ms on SQLite; the trials of an experiment are
written here a few thousand to a transaction. The tables are the database's own, reflected, so that
nothing private of Optuna is needed; a schema that is not the known one is refused.
"""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from typing import Any

import sqlalchemy as sql
from optuna.distributions import BaseDistribution, distribution_to_json
from optuna.storages import RDBStorage
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial

from storage.databases.look import known_tables
from storage.databases.postgresql import copy_rows

Rows = list[dict[str, Any]]
Owned = list[tuple[int, FrozenTrial]]
"""Trials with their ids in the database."""


def trial_row(study_id: int, number: int, trial: FrozenTrial) -> dict[str, Any]:
    """The trial itself.

    Raises:
        ValueError: it is not finished, or has intermediate values.
    """
    if not trial.state.is_finished() or trial.intermediate_values:
        raise ValueError(f"trial {number}: not finished, or with intermediate values")
    return {
        "study_id": study_id,
        "number": number,
        "state": trial.state.name,
        "datetime_start": _naive_utc(trial.datetime_start),
        "datetime_complete": _naive_utc(trial.datetime_complete),
    }


def value_row(trial_id: int, trial: FrozenTrial) -> dict[str, Any]:
    """Its one value, which it must have."""
    assert trial.value is not None
    if math.isfinite(trial.value):
        stored, kind = trial.value, "FINITE"
    else:
        stored, kind = None, "INF_POS" if trial.value > 0 else "INF_NEG"
    return {"trial_id": trial_id, "objective": 0, "value": stored, "value_type": kind}


def parameter_rows(owned: Owned) -> Rows:
    """A row a parameter."""
    return [
        {
            "trial_id": trial_id,
            "param_name": name,
            "param_value": distribution.to_internal_repr(trial.params[name]),
            "distribution_json": _as_json(distribution),
        }
        for trial_id, trial in owned
        for name, distribution in trial.distributions.items()
    ]


def attribute_rows(owned: Owned, kind: str) -> Rows:
    """A row an attribute; `kind` is "user" or "system"."""
    return [
        {"trial_id": trial_id, "key": key, "value_json": json.dumps(value)}
        for trial_id, trial in owned
        for key, value in getattr(trial, f"{kind}_attrs").items()
    ]


def _naive_utc(local: datetime | None) -> datetime | None:
    return None if local is None else local.astimezone(UTC).replace(tzinfo=None)


@cache
def _as_json(distribution: BaseDistribution) -> str:
    return distribution_to_json(distribution)


METRIC_ATTRIBUTE = "study:metric_names"  # where `optuna.Study.set_metric_names` puts them
TRIALS_PER_TRANSACTION = 2000  # 30 rows each: some 20 MB of memory, half a second


@dataclass(frozen=True)
class FinishedStudy:
    """A study of one objective to be minimised, and finished trials for it.

    Attributes:
        name: in the database; once in a call.
        trials: finished, without intermediate values, in the order of their numbers.
        first: number of the first of them; those before it are in the database already.
        user_attrs: of the study, plain values; written when the study is made.
        metric: what its objective is called; written where the study does not say it. Empty: not
            said.
    """

    name: str
    trials: Sequence[FrozenTrial]
    first: int = 0
    user_attrs: dict[str, Any] = field(default_factory=dict)
    metric: str = ""


def trial_counts(storage: RDBStorage) -> dict[str, int]:
    """How many trials each study has, by name."""
    tables = known_tables(storage)
    studies, trials = tables["studies"], tables["trials"]
    counts = (
        sql.select(studies.c.study_name, sql.func.count(trials.c.trial_id))
        .outerjoin(trials, trials.c.study_id == studies.c.study_id)
        .group_by(studies.c.study_name)
    )
    with storage.engine.connect() as connection:
        return {name: count for name, count in connection.execute(counts)}


def study_ids(storage: RDBStorage) -> dict[str, int]:
    """What the database, and the addresses of its dashboard, call each study, by its name."""
    studies = known_tables(storage)["studies"]
    with storage.engine.connect() as connection:
        return _pairs(connection, sql.select(studies.c.study_name, studies.c.study_id))


def study_attributes(storage: RDBStorage, key: str) -> dict[str, Any]:
    """The value of a user attribute in each study that has it, by the study's name."""
    tables = known_tables(storage)
    studies, attributes = tables["studies"], tables["study_user_attributes"]
    query = sql.select(studies.c.study_name, attributes.c.value_json).where(
        studies.c.study_id == attributes.c.study_id, attributes.c.key == key
    )
    with storage.engine.connect() as connection:
        return {name: json.loads(value) for name, value in connection.execute(query)}


def write_studies(storage: RDBStorage, studies: Iterable[FinishedStudy]) -> int:
    """Make the studies that are not there, and add the trials that they do not have yet.

    A trial is there whole or not at all, however this process ends; called again, it goes on. The
    trials are those that `optuna.study.Study.add_trial` would have made. Returns how many were
    added.

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


def attach(
    storage: RDBStorage, attributes: Iterable[tuple[str, int, str, Any]]
) -> set[tuple[str, int]]:
    """Add system attributes to finished trials, which Optuna itself does not let anyone do.

    A key that the trial has already is left as it is.

    Args:
        storage: of the trials.
        attributes: name of the study, number of the trial, key, plain value.

    Returns which trials got something: name of the study, number.

    Raises:
        InputError: a database of another Optuna version.
        KeyError: a trial that is not there.
    """
    tables = known_tables(storage)
    studies, trials = tables["studies"], tables["trials"]
    table = tables["trial_system_attributes"]
    joined = sql.join(trials, studies, trials.c.study_id == studies.c.study_id)
    wanted = list(attributes)
    with storage.engine.begin() as connection:
        _lock(connection, studies, [name for name, *_ in wanted])
        query = sql.select(studies.c.study_name, trials.c.number, trials.c.trial_id)
        query = query.select_from(joined).where(
            studies.c.study_name.in_({name for name, *_ in wanted}),
            trials.c.number.in_({number for _, number, *_ in wanted}),
        )
        ids = {(name, number): trial_id for name, number, trial_id in connection.execute(query)}
        known = sql.select(table.c.trial_id, table.c.key).where(table.c.trial_id.in_(ids.values()))
        there = {(trial_id, key) for trial_id, key in connection.execute(known)}
        new = [item for item in wanted if (ids[item[0], item[1]], item[2]) not in there]
        rows = [
            {"trial_id": ids[name, number], "key": key, "value_json": json.dumps(value)}
            for name, number, key, value in new
        ]
        _insert(connection, table, rows)
    return {(name, number) for name, number, *_ in new}


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
    connection: sql.Connection, tables: dict[str, sql.Table], batch: list[FinishedStudy]
) -> int:
    ids = _study_ids(connection, tables, batch)
    _name_metrics(connection, tables["study_system_attributes"], ids, batch)
    counts = _counts(connection, tables["trials"], list(ids.values()))
    fresh: list[tuple[int, int, FrozenTrial]] = []  # study id, number, trial
    for study in batch:
        study_id = ids[study.name]
        have = counts.get(study_id, 0)
        if have < study.first:
            raise ValueError(f"{study.name}: {have} trials, so none can be number {study.first}")
        numbered = enumerate(study.trials, start=study.first)
        fresh += [(study_id, number, trial) for number, trial in numbered if number >= have]
    _insert(connection, tables["trials"], [trial_row(*item) for item in fresh])
    trial_ids = _trial_ids(connection, tables["trials"], {study_id for study_id, _, _ in fresh})
    owned = [(trial_ids[study_id, number], trial) for study_id, number, trial in fresh]
    values = [value_row(*item) for item in owned if item[1].value is not None]
    _insert(connection, tables["trial_values"], values)
    _insert(connection, tables["trial_params"], parameter_rows(owned))
    for kind in ("user", "system"):
        rows = attribute_rows(owned, kind)
        _insert(connection, tables[f"trial_{kind}_attributes"], rows)
    return len(fresh)


def _study_ids(
    connection: sql.Connection, tables: dict[str, sql.Table], batch: list[FinishedStudy]
) -> dict[str, int]:
    """Ids by name; the studies are made where they are missing, and locked for this transaction."""
    table = tables["studies"]
    names = [study.name for study in batch]
    _lock(connection, table, names)
    select = sql.select(table.c.study_name, table.c.study_id).where(table.c.study_name.in_(names))
    ids = _pairs(connection, select)
    new = [study for study in batch if study.name not in ids]
    if new:
        _insert(connection, table, [{"study_name": study.name} for study in new])
        ids = _pairs(connection, select)
        direction = {"objective": 0, "direction": StudyDirection.MINIMIZE.name}
        directions = [{"study_id": ids[study.name], **direction} for study in new]
        _insert(connection, tables["study_directions"], directions)
        attributes = [
            {"study_id": ids[study.name], "key": key, "value_json": json.dumps(value)}
            for study in new
            for key, value in study.user_attrs.items()
        ]
        _insert(connection, tables["study_user_attributes"], attributes)
    return ids


def _name_metrics(
    connection: sql.Connection, table: sql.Table, ids: dict[str, int], batch: list[FinishedStudy]
) -> None:
    """Say what objectives are called in those studies that do not."""
    query = sql.select(table.c.study_id).where(
        table.c.key == METRIC_ATTRIBUTE, table.c.study_id.in_(ids.values())
    )
    named = set(connection.execute(query).scalars())
    unnamed = [study for study in batch if study.metric and ids[study.name] not in named]
    rows = [
        {
            "study_id": ids[study.name],
            "key": METRIC_ATTRIBUTE,
            "value_json": json.dumps([study.metric]),
        }
        for study in unnamed
    ]
    _insert(connection, table, rows)


def _lock(connection: sql.Connection, studies: sql.Table, names: list[str]) -> None:
    """Hold these studies until the transaction ends.

    Writing is the one way to lock that every database has; SQLite's lock lies on the whole file.
    """
    named = studies.c.study_name.in_(names)
    connection.execute(sql.update(studies).where(named).values(study_name=studies.c.study_name))


def _counts(connection: sql.Connection, trials: sql.Table, study_ids: list[int]) -> dict[int, int]:
    query = sql.select(trials.c.study_id, sql.func.count()).where(trials.c.study_id.in_(study_ids))
    return _pairs(connection, query.group_by(trials.c.study_id))


def _pairs(connection: sql.Connection, query: sql.Select[Any]) -> dict[Any, Any]:
    return {key: value for key, value in connection.execute(query)}


def _trial_ids(
    connection: sql.Connection, trials: sql.Table, study_ids: set[int]
) -> dict[tuple[int, int], int]:
    query = sql.select(trials.c.study_id, trials.c.number, trials.c.trial_id)
    rows = connection.execute(query.where(trials.c.study_id.in_(study_ids)))
    return {(study_id, number): trial_id for study_id, number, trial_id in rows}


def _insert(connection: sql.Connection, table: sql.Table, rows: Rows) -> None:
    if rows and connection.dialect.name == "postgresql":
        copy_rows(connection, table, rows)
    elif rows:
        connection.execute(sql.insert(table), rows)
