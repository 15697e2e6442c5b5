"""A database as it is, read alone: a refused one must not have been changed."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from json import JSONDecodeError
from pathlib import Path
from sqlite3 import Connection, connect
from typing import Any
from urllib.parse import quote

import sqlalchemy as sql
from optuna.storages import RDBStorage
from sqlalchemy.exc import SQLAlchemyError

from storage.databases.postgresql import unusable
from storage.databases.schema_version import TABLES
from taichi_nmm.errors import InputError

REVISION_TABLE = "alembic_version"
COUNTED = ("studies", "version_info", REVISION_TABLE)  # the last two have a row, which Optuna adds


@contextmanager
def looked_at(url: str, shown: str, options: dict[str, Any]) -> Iterator[RDBStorage | None]:
    """The studies of a database, to be read; None where it has no tables.

    Args:
        url: of the database.
        shown: what it is called in messages.
        options: of SQLAlchemy's engine; with them nothing can be written.

    Raises:
        InputError: not to be read, with values that are not JSON, somebody else's, or an Optuna
            schema of another version.
    """
    storage = None
    try:
        engine = sql.create_engine(url, **options)
        try:
            empty = _is_empty(engine, shown)
        finally:
            engine.dispose()
        if not empty:
            storage = RDBStorage(url, engine_kwargs=dict(options), skip_table_creation=True)
    except (SQLAlchemyError, RuntimeError) as error:
        raise unusable(shown, error) from None
    try:
        yield storage
    except (SQLAlchemyError, JSONDecodeError) as error:
        raise unusable(shown, error) from None
    finally:
        if storage is not None:
            storage.engine.dispose()


def _is_empty(engine: sql.Engine, shown: str) -> bool:
    """Whether there is nothing yet: no tables, or Optuna's without a study and without a version.

    These a killed process may have left, and Optuna finishes them. What is of another program is
    refused.
    """
    names = set(sql.inspect(engine).get_table_names())
    if not names:
        return True
    complete = names.issuperset(TABLES)
    with engine.connect() as connection:
        rows = {name: _count(connection, name) for name in COUNTED if complete and name in names}
    complete &= REVISION_TABLE in rows and rows["version_info"] == rows[REVISION_TABLE] == 1
    empty = not complete and rows.get("studies") == 0 and max(rows.values()) <= 1
    if not (complete or empty):
        raise InputError("storage", shown, "an Optuna database, or an empty one, or a new file")
    return empty


def _count(connection: sql.Connection, table: str) -> int:
    query = sql.select(sql.func.count()).select_from(sql.table(table))
    return int(connection.execute(query).scalar_one())


def sqlite_options(path: Path, timeout_s: float) -> dict[str, Any]:
    """Of an engine that reads a SQLite file.

    SQLite leaves files beside a database in WAL mode that it reads, unless it takes it to be
    immutable: which it is, for a moment, where there is no log beside it. What a crash left of a
    transaction, a journal, SQLite itself rolls back before anything can be read.
    """

    def beside(ending: str) -> bool:
        return path.with_name(path.name + ending).exists()

    mode = "mode=ro" if beside("-wal") else "mode=ro&immutable=1"
    name = quote(os.fsencode(path.absolute()).lstrip(b"/"))
    uri = f"file:///{name}?{'mode=rw' if beside('-journal') else mode}"

    def creator() -> Connection:
        return connect(uri, uri=True, timeout=timeout_s, check_same_thread=False)

    return {"creator": creator, "poolclass": sql.NullPool}
