"""Study databases that Optuna, its dashboard and our commands share: SQLite files, or PostgreSQL.

On SQLite, write-ahead logging lets the dashboard read while a study writes, and with
synchronous=NORMAL a trial of 16 parameters costs about 60 ms instead of 450. A crash of the machine
may lose the last transactions, never the file.
"""

import fcntl
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from optuna.exceptions import StorageInternalError
from optuna.storages import RDBStorage
from sqlalchemy import event
from sqlalchemy.exc import SQLAlchemyError

from storage.databases import postgresql
from storage.databases.postgresql import unusable
from taichi_nmm.errors import InputError

URL_PREFIX = "sqlite:///"
BUSY_TIMEOUT_S = 5.0  # a writer of ours holds the database for milliseconds
OPTUNA_TABLE = "studies"  # a database that has tables, but not this one, is somebody else's


def open_studies(url: str) -> RDBStorage:
    """The study database `sqlite:///FILE`, made where it is missing, or one of PostgreSQL.

    Raises:
        InputError: not such a URL, a place that cannot be written, no server, not a database,
            somebody else's database, an Optuna schema of another version, or locked by another
            program.
    """
    if postgresql.is_postgresql(url):
        return postgresql.open_database(url)
    path = studies_path(url)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with closing(sqlite3.connect(path, timeout=BUSY_TIMEOUT_S)) as connection:
            _claim(connection, path)
        storage = RDBStorage(url, engine_kwargs={"connect_args": {"timeout": BUSY_TIMEOUT_S}})
    except (OSError, sqlite3.Error, SQLAlchemyError, RuntimeError) as error:
        raise unusable(str(path), error) from None
    event.listen(storage.engine, "connect", _relax_synchronous)
    storage.engine.dispose()  # connections made before the listener
    return storage


def public_url(url: str) -> str:
    """The URL without a password, so that it may be printed."""
    return postgresql.without_password(url) if postgresql.is_postgresql(url) else url


def shown_url(url: str) -> str:
    """What a study database is called in messages: its file, or its URL without a password.

    Raises:
        InputError: the URL names no such database.
    """
    if postgresql.is_postgresql(url):
        return postgresql.without_password(url)
    return str(studies_path(url))


def studies_path(url: str) -> Path:
    """The file that a URL of a study database names."""
    path = url.removeprefix(URL_PREFIX)
    if path == url or not path or "?" in path:
        shown = url.split("://")[0] + "://..." if "@" in url else url  # it may hold a password
        raise InputError("storage", shown, f"{URL_PREFIX}FILE or {postgresql.URL_FORM}")
    if Path(path).is_dir():
        raise InputError("storage", path, "a file, not a folder")
    return Path(path)


@contextmanager
def storage_errors(url: str) -> Iterator[None]:
    """Turn what a database can do to a running study into one line for its user."""
    try:
        yield
    except (SQLAlchemyError, StorageInternalError) as error:
        raise unusable(shown_url(url), error) from None


@contextmanager
def only_run(url: str, study_name: str) -> Iterator[None]:
    """Hold a study for this process: two runs of it would take each other's trials for dead.

    The lock is a file beside the database, or a lock of the server; it ends with the process,
    however that ends.
    """
    if postgresql.is_postgresql(url):
        with postgresql.locked(url, study_name) as free:
            if not free:
                raise _taken(study_name)
            yield
        return
    path = studies_path(url)
    lock = path.with_name(f"{path.name}.{study_name.replace('/', '-')}.lock")
    try:
        file = lock.open("a")  # never removed: another process may be about to lock it
    except OSError as error:
        raise unusable(str(path), error) from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise _taken(study_name) from None
        yield


def _taken(study_name: str) -> InputError:
    allowed = "one run of a study at a time; another process is running this one"
    return InputError("study", study_name, allowed)


def _claim(connection: sqlite3.Connection, path: Path) -> None:
    """See that the database is ours to write, and put it into WAL mode (kept by the file)."""
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
    if tables and OPTUNA_TABLE not in tables:
        raise InputError("storage", str(path), "an Optuna database, or a file that does not exist")
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("BEGIN IMMEDIATE")
    connection.rollback()


def _relax_synchronous(connection: Any, _record: Any) -> None:
    """Called by SQLAlchemy with each new connection."""
    connection.execute("PRAGMA synchronous=NORMAL")
