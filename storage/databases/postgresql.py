"""Study databases on a PostgreSQL server, which many machines share."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import sqlalchemy as sql
from optuna.storages import RDBStorage
from sqlalchemy.exc import DBAPIError, NoSuchModuleError, SQLAlchemyError

from storage.databases.urls import POSTGRESQL_FORM, public_url
from taichi_nmm.errors import InputError

CONNECT_TIMEOUT_S = 10
TABLES_LOCK = "taichi-nmm/tables"  # no study's name: those have three parts
# A server that was restarted between two checkpoints is noticed by the first, cheap question.
ENGINE_OPTIONS: dict[str, Any] = {
    "connect_args": {"connect_timeout": CONNECT_TIMEOUT_S},
    "pool_pre_ping": True,
}
READING_OPTIONS: dict[str, Any] = {
    "connect_args": {
        "connect_timeout": CONNECT_TIMEOUT_S,
        "options": "-c default_transaction_read_only=on",
    },
}


def require_server(url: str) -> str:
    """The name of the database in messages.

    Raises:
        InputError: not a URL of a PostgreSQL database, or no driver for it.
    """
    shown = public_url(url)
    try:
        parts = sql.make_url(url)
    except (SQLAlchemyError, ValueError):
        parts = None
    if parts is None or not parts.database or "@" in (parts.host or ""):
        raise InputError("storage", shown, f"{POSTGRESQL_FORM}; an @ in a password is %40")
    _engine(url, shown).dispose()
    return shown


def open_database(url: str) -> RDBStorage:
    """The study database of this URL; its tables are made where the database is empty.

    Raises:
        InputError: no driver, no server, no such database, or none that can be written.
    """
    shown = require_server(url)
    try:
        with locked(url, TABLES_LOCK, wait=True):  # of several at once, one makes them
            return RDBStorage(url, engine_kwargs=dict(ENGINE_OPTIONS))
    except (SQLAlchemyError, RuntimeError) as error:
        raise unusable(shown, error) from None


@contextmanager
def locked(url: str, name: str, wait: bool = False) -> Iterator[bool]:
    """Hold an advisory lock of the server on a study's name; yields whether it was free.

    The server gives the lock back when the connection ends, however this process ends.

    Args:
        url: of the database.
        name: of the study, or of other work that one process does at a time.
        wait: until it is free.
    """
    take = "pg_advisory_lock" if wait else "pg_try_advisory_lock"
    question = f"SELECT {take}(hashtextextended(:name, 0))"
    with (
        connected(url) as engine,
        engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection,
    ):
        free = connection.execute(sql.text(question), {"name": name}).scalar()
        yield wait or bool(free)


@contextmanager
def connected(url: str) -> Iterator[sql.Engine]:
    """An engine of the database; its connections are closed in the end, and so lose their locks.

    Raises:
        InputError: not such a URL, or an error of the server in the block.
    """
    shown = require_server(url)
    engine = _engine(url, shown)
    try:
        yield engine
    except SQLAlchemyError as error:
        raise unusable(shown, error) from None
    finally:
        engine.dispose()


def copy_rows(connection: sql.Connection, table: sql.Table, rows: Sequence[dict[str, Any]]) -> None:
    """Insert rows of the same columns by COPY, within the connection's transaction.

    Twice as fast as INSERT; columns that are not given take their defaults, keys from sequences
    too.
    """
    preparer = connection.dialect.identifier_preparer
    columns = ", ".join(preparer.quote(name) for name in rows[0])
    command = f"COPY {preparer.format_table(table)} ({columns}) FROM STDIN"
    driver: Any = connection.connection.driver_connection
    try:
        with driver.cursor() as cursor, cursor.copy(command) as copy:
            for row in rows:
                copy.write_row(tuple(row.values()))
    except connection.dialect.loaded_dbapi.Error as error:
        raise DBAPIError(command, None, error) from error


def unusable(shown: str, error: Exception) -> InputError:
    """The error of a database, in one line for its user."""
    cause = error.__cause__ or error
    words = str(getattr(cause, "orig", cause)).strip().splitlines()
    reason = words[0] if words else type(cause).__name__
    return InputError("storage", shown, f"a study database that can be written ({reason})")


def _engine(url: str, shown: str) -> sql.Engine:
    try:
        return sql.create_engine(url, **ENGINE_OPTIONS)
    except (ImportError, NoSuchModuleError):
        allowed = "an environment with its driver: pip install 'taichi-nmm[postgres]'"
        raise InputError("storage", shown, allowed) from None
