"""Study databases that Optuna, its dashboard and our commands share: SQLite files or PostgreSQL.

On SQLite, write-ahead logging lets the dashboard read while a study writes, and with
synchronous=NORMAL a trial of 16 parameters costs about 60 ms instead of 450. A crash of
the machine may lose the last transactions, never the file.

A database is looked at before it is opened: nothing of a refused one is changed.
"""

import json
import os
import sqlite3
import stat
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from json import JSONDecodeError
from pathlib import Path
from typing import Any
from urllib.parse import quote

import optuna
import sqlalchemy as sql
from optuna.exceptions import (
    ExperimentalWarning,
    StorageInternalError,
    UpdateFinishedTrialError,
)
from optuna.storages import BaseStorage, RDBStorage
from sqlalchemy import event
from sqlalchemy.exc import SQLAlchemyError

from storage import commit
from storage.commit import remove_orphans, require_writable, writable
from storage.databases import postgresql
from storage.databases.postgresql import unusable
from storage.databases.urls import FORMS, SQLITE, file_url, is_postgresql
from storage.databases.urls import public_url as public_url
from storage.inputs.errors import InputError

MEMORY_NAME = ":memory:"  # which SQLite takes for no file
# Optuna's KeyError for a study or trial that was deleted
NO_RECORD = "Record does not exist."
ALONE = "a study that no other program changes while it runs"
BUSY_TIMEOUT_S = 5.0  # a writer of ours holds the database for milliseconds

# Optuna 3.0 to 5.0, with the column types of revision v3.2.0.a and later
SCHEMA_VERSION = 12
_SCHEMA = json.loads(
    Path(__file__).with_name("schema.json").read_text(encoding="utf-8")
)
TABLES: dict[str, set[str]] = {name: set(columns) for name, columns in _SCHEMA.items()}
REVISION_TABLE = "alembic_version"
OWNED = (
    "study_directions",
    "study_user_attributes",
    "study_system_attributes",
    "trials",
)
OF_TRIALS = tuple(
    name
    for name, columns in TABLES.items()
    if "trial_id" in columns and name != "trials"
)
# the last two have a row, which Optuna adds
COUNTED = ("studies", "version_info", REVISION_TABLE)


ATTRIBUTES = """
SELECT key, value_json FROM study_user_attributes JOIN studies USING (study_id)
WHERE study_name = :name
"""


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
            _claim(connection)
        storage = _storage(url)
    except (OSError, sqlite3.Error, SQLAlchemyError, RuntimeError) as error:
        raise unusable(shown_url(url), error) from None
    relaxed = "PRAGMA synchronous=NORMAL"
    event.listen(
        storage.engine, "connect", lambda connection, _: connection.execute(relaxed)
    )
    event.listen(storage.engine, "begin", _stays(path))
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
        with _read_tables(url) as engine:
            if engine is not None:
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


def read_attributes(
    url: str, study_name: str
) -> tuple[dict[str, Any] | None, list[str]]:
    """The attributes that users have given to a study, None without it; and all studies' names.

    Optuna itself takes half a second to load what upgrades databases, which reading
    does not need.

    Raises:
        InputError: as `read_studies`.
    """
    with _read_tables(url) as engine:
        if engine is None:
            return None, []
        with engine.connect() as connection:
            names = (
                connection.execute(sql.text("SELECT study_name FROM studies"))
                .scalars()
                .all()
            )
            if study_name not in names:
                return None, list(names)
            found = connection.execute(sql.text(ATTRIBUTES), {"name": study_name})
            return {key: json.loads(value) for key, value in found}, list(names)


@contextmanager
def _read_tables(url: str) -> Iterator[sql.Engine | None]:
    """An engine that reads a database which was checked; None where there is none, or an empty one.

    Raises:
        InputError: as `read_studies`.
    """
    shown = shown_url(url)
    if not is_postgresql(url):
        path = studies_path(url)
        with writable(path, "storage"):
            there = path.exists()
        if not there:
            require_writable(path, "storage")
            yield None
            return
    address, options = _reading(url)
    with read_errors(url):
        engine = sql.create_engine(address, **options)
        try:
            with engine.connect() as connection:
                empty = _is_empty(connection, shown)
                if not empty:
                    _check_whole(connection, shown)
            yield None if empty else engine
        finally:
            engine.dispose()


def _reading(url: str) -> tuple[str, dict[str, Any]]:
    """Address and options of an engine that reads a database."""
    if is_postgresql(url):
        return url, dict(postgresql.READING_OPTIONS)
    return SQLITE, _sqlite_options(studies_path(url))


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


def _is_empty(connection: sql.Connection, shown: str) -> bool:
    """Whether there is nothing yet: no tables, or Optuna's without a study and without a version.

    A killed process may leave such tables, and Optuna finishes them. A database of
    another program is refused.
    """
    columns = {
        name: {column["name"] for column in listed}
        for (_, name), listed in sql.inspect(connection).get_multi_columns().items()
    }
    if not columns:
        return True
    complete = all(columns.get(name, set()) >= known for name, known in TABLES.items())
    rows = {
        name: _count(connection, name)
        for name in COUNTED
        if complete and name in columns
    }
    complete &= (
        REVISION_TABLE in rows and rows["version_info"] == rows[REVISION_TABLE] == 1
    )
    empty = not complete and rows.get("studies") == 0 and max(rows.values()) <= 1
    empty = empty and not any(_count(connection, name) for name in (*OWNED, *OF_TRIALS))
    if not (complete or empty):
        raise InputError(
            "storage", shown, "an Optuna database, or an empty one, or a new file"
        )
    return empty


def _check_whole(connection: sql.Connection, shown: str) -> None:
    """Refuse a SQLite file with a damaged page, or with rows of a study or trial that is gone.

    By itself SQLite reads the pages that it needs, and gives such rows to the next
    study or trial.
    """
    if connection.dialect.name == "sqlite":
        said = str(connection.execute(sql.text("PRAGMA quick_check(1)")).scalar())
        if said == "ok" and (
            orphan := connection.exec_driver_sql("PRAGMA foreign_key_check").first()
        ):
            said = f"a row of {orphan[0]} belongs to nothing"
        if said != "ok":
            allowed = f"a database that SQLite finds whole ({said.splitlines()[-1]})"
            raise InputError("storage", shown, allowed)


def _count(connection: sql.Connection, table: str) -> int:
    query = sql.select(sql.func.count()).select_from(sql.table(table))
    return int(connection.execute(query).scalar_one())


def _sqlite_options(path: Path) -> dict[str, Any]:
    """Options of an engine that reads a SQLite file.

    When SQLite reads a database in WAL mode, it leaves files beside it, unless the
    database is immutable: which it is, for a moment, where there is no log beside it. A
    journal that a crash left is rolled back by SQLite before anything can be read.
    """

    def beside(ending: str) -> bool:
        return path.with_name(path.name + ending).exists()

    mode = "mode=ro" if beside("-wal") else "mode=ro&immutable=1"
    name = quote(os.fsencode(path.absolute()).lstrip(b"/"))
    uri = f"file:///{name}?{'mode=rw' if beside('-journal') else mode}"

    def creator() -> sqlite3.Connection:
        return sqlite3.connect(
            uri, uri=True, timeout=BUSY_TIMEOUT_S, check_same_thread=False
        )

    return {"creator": creator, "poolclass": sql.NullPool}


def shown_url(url: str) -> str:
    """The name of a study database in messages: its file, or its URL without a password.

    Raises:
        InputError: the URL names no such database.
    """
    if is_postgresql(url):
        return postgresql.require_server(url)
    studies_path(url)
    return public_url(url).removeprefix(SQLITE)


def studies_path(url: str) -> Path:
    """The file that a URL of a study database names.

    Raises:
        InputError: it names none, or something else than a file.
    """
    name, shown = url.removeprefix(SQLITE), public_url(url)
    if name == url or not name or "?" in name:
        raise InputError("storage", shown, FORMS)
    path = Path(sql.make_url(url).database or "")  # which undoes %20 and its like
    if "\0" in str(path) or path.name == MEMORY_NAME:
        raise InputError("storage", shown, FORMS)
    with (
        writable(Path(shown.removeprefix(SQLITE)), "storage"),
        suppress(FileNotFoundError),
    ):
        if not stat.S_ISREG(path.stat().st_mode):
            raise InputError(
                "storage", shown.removeprefix(SQLITE), "a file, not a folder"
            )
    return path


@contextmanager
def storage_errors(url: str) -> Iterator[None]:
    """Turn whatever a database, or another user of it, does to a running study into one line."""
    try:
        yield
    except UpdateFinishedTrialError:
        raise InputError(
            "storage", shown_url(url), f"{ALONE}; it told a running trial"
        ) from None
    except KeyError as error:
        if error.args != (NO_RECORD,):
            raise
        raise InputError(
            "storage", shown_url(url), f"{ALONE}; it deleted this one"
        ) from None
    except (SQLAlchemyError, StorageInternalError, JSONDecodeError) as error:
        raise unusable(shown_url(url), error) from None


@contextmanager
def read_errors(url: str) -> Iterator[None]:
    """The same for a block that only reads: any error is taken to be the database's fault."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise unusable(shown_url(url), error) from None


def load_whole(storage: BaseStorage, name: str) -> optuna.Study:
    """A study that has been read completely: for an edited value, Optuna raises its error here."""
    study = optuna.load_study(study_name=name, storage=storage)
    _ = study.directions, study.user_attrs, study.metric_names
    study.get_trials(deepcopy=False)
    return study


@contextmanager
def only_run(url: str, study_name: str) -> Iterator[None]:
    """Hold a study for this process: two runs of it would take each other's trials for dead.

    The lock is a file beside the database, or a lock of the server; it ends with the
    process, however that ends.
    """
    allowed = "one run of a study at a time; another process is running this one"
    taken = InputError("study", study_name, allowed)
    if is_postgresql(url):
        with postgresql.locked(url, study_name) as free:
            if not free:
                raise taken
            yield
        return
    lock = _lock_file(url, study_name)
    try:
        file = lock.open("a")  # never removed: another process may be about to lock it
    except OSError as error:
        raise unusable(shown_url(url), error) from None
    with file:
        commit.lock_now(file.fileno(), lock, "storage", taken)
        yield


def require_lockable(url: str, study_name: str) -> None:
    """Refuse a study of a SQLite file that another process holds; nothing is touched.

    The database is not read: a process that was stopped while it wrote holds that as
    well.

    Raises:
        InputError: naming the study, or the file that cannot be made for its lock.
    """
    if is_postgresql(url):
        return
    lock = _lock_file(url, study_name)
    require_writable(lock, "storage")
    if lock.exists():
        with only_run(url, study_name):
            pass


def _lock_file(url: str, study_name: str) -> Path:
    """Beside the database's own name: the same file for all links that lead to it."""
    path = studies_path(url)
    with writable(path, "storage"):
        path = path.resolve()
        if path.exists():
            # a second name may be that of a process killed while it made it
            remove_orphans(path)
            names = path.stat().st_nlink
            if names > 1:  # SQLite itself takes two names for two databases
                allowed = f"a file with one name; this has {names} hard links"
                raise InputError("storage", str(path), allowed)
    return path.with_name(f"{path.name}.{study_name.replace('/', '-')}.lock")


def _stays(path: Path) -> Callable[[sql.Connection], None]:
    """A check, before each transaction, that the file still has its name.

    Without it SQLite goes on to write to the removed file, and all is lost with the
    process.
    """
    opened = path.stat()

    def check(_: sql.Connection) -> None:
        with suppress(OSError):
            if os.path.samestat(opened, path.stat()):
                return
        allowed = (
            "a file that stays where it is while a study runs; it was removed or replaced, "
            "and no trial since then is kept"
        )
        raise InputError("storage", str(path), allowed)

    return check


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


def _claim(connection: sqlite3.Connection) -> None:
    """Check that the database can be written, and put it into WAL mode, which the file keeps.

    When others open the file as well, SQLite does not wait for the mode, whatever the
    timeout.
    """
    deadline_s = time.monotonic() + BUSY_TIMEOUT_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode=WAL")
            break
        except sqlite3.OperationalError:
            if time.monotonic() > deadline_s:
                raise
            time.sleep(0.01)
    connection.execute("BEGIN IMMEDIATE")
    connection.rollback()
