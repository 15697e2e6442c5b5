"""Study databases that Optuna, its dashboard and our commands share: SQLite files or PostgreSQL.

On SQLite, write-ahead logging lets the dashboard read while a study writes, and with
synchronous=NORMAL a trial of 16 parameters costs about 60 ms instead of 450. A crash of
the machine may lose the last transactions, never the file.

A database is looked at before it is opened: nothing of a refused one is changed.
"""

import os
import sqlite3
import warnings
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import optuna
import sqlalchemy as sql
from optuna.exceptions import ExperimentalWarning
from optuna.storages import BaseStorage, RDBStorage
from sqlalchemy import event
from sqlalchemy.exc import SQLAlchemyError

from storage import commit
from storage.commit import remove_orphans, require_writable
from storage.databases import postgresql
from storage.databases.files import (
    BUSY_TIMEOUT_S,
    SCHEMA_VERSION,
    TABLES,
    claim,
    connected_to_read,
    reading,
    stays,
    unusable,
)
from storage.databases.files import only_run as only_run
from storage.databases.files import read_errors as read_errors
from storage.databases.files import require_lockable as require_lockable
from storage.databases.files import shown_url as shown_url
from storage.databases.files import storage_errors as storage_errors
from storage.databases.files import studies_path as studies_path
from storage.databases.urls import SQLITE, file_url, is_postgresql
from storage.databases.urls import public_url as public_url
from storage.inputs.errors import InputError


def open_studies(url: str) -> RDBStorage:
    """The study database `sqlite:///FILE`, made where it is missing, or one of PostgreSQL.

    Raises:
        InputError: not such a URL, a place that cannot be written, no server, not a
            database, somebody else's database, an Optuna schema of another version, or
            locked by another program.
    """
    with read_studies(url):
        pass  # a database that is refused has not been changed
    if is_postgresql(url):
        return postgresql.open_database(url)
    path = studies_path(url)
    require_writable(path, "storage")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _make(path)
        with closing(sqlite3.connect(path, timeout=BUSY_TIMEOUT_S)) as connection:
            claim(connection)
        storage = _storage(url)
    except (OSError, sqlite3.Error, SQLAlchemyError, RuntimeError) as error:
        raise unusable(shown_url(url), error) from None
    relaxed = "PRAGMA synchronous=NORMAL"
    event.listen(
        storage.engine, "connect", lambda connection, _: connection.execute(relaxed)
    )
    event.listen(storage.engine, "begin", stays(path))
    storage.engine.dispose()  # connections made before the listener
    return storage


def write_down(storage: RDBStorage) -> None:
    """Bring what lies in SQLite's write-ahead log into the file, so that a copy of it is whole.

    SQLite does so by itself when the last program closes the file, and a server never
    does. Who reads at this moment is not waited for: what he holds up is written down
    the next time.
    """
    if storage.engine.dialect.name != "sqlite":
        return
    with storage.engine.connect() as connection:
        connection.exec_driver_sql("PRAGMA wal_checkpoint(PASSIVE)")


@contextmanager
def read_studies(url: str) -> Iterator[RDBStorage | None]:
    """The study database as it is, to be read alone; None where there is none yet, or an empty one.

    Optuna trusts a database, and raises any error where it is damaged: so whatever the
    block raises is reported as the database's fault, in one line.

    Raises:
        InputError: as `open_studies`, which would open it or make it; or the block
            raised.
    """
    storage, verbosity = None, optuna.logging.get_verbosity()
    try:
        with reading(url) as ask:
            if ask is not None:
                address, options = _reading(url)
                storage = RDBStorage(
                    address, engine_kwargs=options, skip_table_creation=True
                )
            # no warnings about damaged values
            optuna.logging.set_verbosity(optuna.logging.ERROR)
            yield storage
    finally:
        optuna.logging.set_verbosity(verbosity)
        if storage is not None:
            storage.engine.dispose()


def _reading(url: str) -> tuple[str, dict[str, Any]]:
    """Address and options of an engine that reads a database."""
    if is_postgresql(url):
        return url, dict(postgresql.READING_OPTIONS)
    path = studies_path(url)
    return SQLITE, {
        "creator": lambda: connected_to_read(path),
        "poolclass": sql.NullPool,
    }


def known_tables(storage: RDBStorage) -> dict[str, sql.Table]:
    """The database's tables by name, as they are there.

    Raises:
        InputError: the schema is of another version of Optuna.
    """
    metadata = sql.MetaData()
    metadata.reflect(storage.engine, only=lambda name, _: name in TABLES)
    version, found = metadata.tables.get("version_info"), "an unknown schema"
    if version is not None and len(metadata.tables) == len(TABLES):
        with storage.engine.connect() as connection:
            number = connection.execute(sql.select(version.c.schema_version)).scalar()
        if number == SCHEMA_VERSION:
            return dict(metadata.tables)
        found = f"schema {number}"
    allowed = (
        f"a database with Optuna's schema {SCHEMA_VERSION} (Optuna 5.0 makes such)"
    )
    raise InputError("storage", found, allowed)


def load_whole(storage: BaseStorage, name: str) -> optuna.Study:
    """A study that has been read completely: for an edited value, Optuna raises its error here."""
    study = optuna.load_study(study_name=name, storage=storage)
    _ = study.directions, study.user_attrs, study.metric_names
    study.get_trials(deepcopy=False)
    return study


def study_of_costs(storage: BaseStorage, name: str, metrics: list[str]) -> optuna.Study:
    """The study of that name, made where it is missing; its costs have these names, or others."""
    study = optuna.create_study(
        storage=storage,
        study_name=name,
        directions=["minimize"] * len(metrics),
        load_if_exists=True,
    )
    if study.metric_names is None:
        with warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
            study.set_metric_names(metrics)
    return study


def _storage(url: str, **options: Any) -> RDBStorage:
    literal = url.replace("{", "{{").replace("}", "}}")  # Optuna formats it
    connect_args = {"timeout": BUSY_TIMEOUT_S, **options}
    return RDBStorage(literal, engine_kwargs={"connect_args": connect_args})


class _Unjournaled(sqlite3.Connection):
    """A connection to a file that nobody knows yet: no journal beside it, no wait for the disk."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.execute("PRAGMA journal_mode=MEMORY")
        self.execute("PRAGMA synchronous=OFF")


def _make(path: Path) -> None:
    """Make the file with its tables, where there is none: it appears whole or not at all.

    SQLite commits each table by itself; a process killed between two would leave half a
    database.
    """
    remove_orphans(path)
    if path.exists():
        return
    with commit.temporary_sibling(path) as temporary:
        _storage(file_url(temporary), factory=_Unjournaled).engine.dispose()
        with closing(sqlite3.connect(temporary)) as connection:
            connection.execute("PRAGMA journal_mode=WAL")
        commit.sync(temporary)
        with suppress(
            OSError
        ):  # another process was faster; or no links here: it is made in place
            os.link(temporary, path)
