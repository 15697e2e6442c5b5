"""Study databases before Optuna opens them: their files, whether they are whole, who has them.

SQLAlchemy and what upgrades databases take a second to load, of which a command of a
bench that reads or enters one number has no use. So this file does without: it looks
into a SQLite file by itself, and into a server by `storage.databases.postgresql`, which
is loaded where a URL names one.
"""

import json
import os
import sqlite3
import stat
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from json import JSONDecodeError
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

from optuna.exceptions import StorageInternalError, UpdateFinishedTrialError

from storage import commit
from storage.commit import remove_orphans, require_writable, writable
from storage.databases.urls import FORMS, SQLITE, is_postgresql, public_url
from storage.databases.urls import unusable as unusable
from storage.inputs.errors import InputError

Ask = Callable[..., list[Any]]
"""The rows that a query gives, whose `:name` are in a second argument."""

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


COLUMNS = """
SELECT m.name, c.name FROM sqlite_master AS m, pragma_table_info(m.name) AS c
WHERE m.type = 'table' AND m.name NOT LIKE 'sqlite_%'
"""
COLUMNS_OF_SERVER = """
SELECT table_name, column_name FROM information_schema.columns
JOIN information_schema.tables USING (table_schema, table_name)
WHERE table_schema = current_schema() AND table_type = 'BASE TABLE'
"""
ATTRIBUTES = """
SELECT key, value_json FROM study_user_attributes JOIN studies USING (study_id)
WHERE study_name = :name
"""


def shown_url(url: str) -> str:
    """The name of a study database in messages: its file, or its URL without a password.

    Raises:
        InputError: the URL names no such database.
    """
    if is_postgresql(url):
        from storage.databases.postgresql import require_server

        return require_server(url)
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
    path = Path(unquote(name))
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
def reading(url: str) -> Iterator[Ask | None]:
    """Ask a database that was checked; None where there is none, or an empty one.

    Raises:
        InputError: not such a database, a damaged one, or the block raised.
    """
    shown = shown_url(url)
    if is_postgresql(url):
        from storage.databases.postgresql import asked

        opened = asked(url)
    else:
        path = studies_path(url)
        with writable(path, "storage"):
            there = path.exists()
        if not there:
            require_writable(path, "storage")
            yield None
            return
        opened = _asked(path)
    with read_errors(url), opened as ask:
        query = COLUMNS_OF_SERVER if is_postgresql(url) else COLUMNS
        empty = _is_empty(ask, ask(query), shown)
        if not empty and not is_postgresql(url):
            _check_whole(ask, shown)
        yield None if empty else ask


@contextmanager
def _asked(path: Path) -> Iterator[Ask]:
    with closing(connected_to_read(path)) as connection:

        def ask(query: str, told: Mapping[str, Any] | None = None) -> list[Any]:
            return connection.execute(query, told or {}).fetchall()

        yield ask


def connected_to_read(path: Path) -> sqlite3.Connection:
    """A connection that reads a SQLite file.

    When SQLite reads a database in WAL mode, it leaves files beside it, unless the
    database is immutable: which it is, for a moment, where there is no log beside it. A
    journal that a crash left is rolled back by SQLite before anything can be read.
    """

    def beside(ending: str) -> bool:
        return path.with_name(path.name + ending).exists()

    mode = "mode=ro" if beside("-wal") else "mode=ro&immutable=1"
    name = quote(os.fsencode(path.absolute()).lstrip(b"/"))
    uri = f"file:///{name}?{'mode=rw' if beside('-journal') else mode}"
    return sqlite3.connect(
        uri, uri=True, timeout=BUSY_TIMEOUT_S, check_same_thread=False
    )


def _is_empty(ask: Ask, columns: list[tuple[str, str]], shown: str) -> bool:
    """Whether there is nothing yet: no tables, or Optuna's without a study and without a version.

    A killed process may leave such tables, and Optuna finishes them. A database of
    another program is refused. `columns` are the tables and the names in each.
    """
    found = dict[str, set[str]]()
    for table, column in columns:
        found.setdefault(table, set()).add(column)
    if not found:
        return True

    def count(table: str) -> int:
        return int(ask(f"SELECT count(*) FROM {table}")[0][0])

    complete = all(found.get(name, set()) >= known for name, known in TABLES.items())
    rows = {name: count(name) for name in COUNTED if complete and name in found}
    complete &= (
        REVISION_TABLE in rows and rows["version_info"] == rows[REVISION_TABLE] == 1
    )
    empty = not complete and rows.get("studies") == 0 and max(rows.values()) <= 1
    empty = empty and not any(map(count, (*OWNED, *OF_TRIALS)))
    if not (complete or empty):
        raise InputError(
            "storage", shown, "an Optuna database, or an empty one, or a new file"
        )
    return empty


def _check_whole(ask: Ask, shown: str) -> None:
    """Refuse a SQLite file with a damaged page, or with rows of a study or trial that is gone.

    By itself SQLite reads the pages that it needs, and gives such rows to the next
    study or trial.
    """
    said = str(ask("PRAGMA quick_check(1)")[0][0])
    if said == "ok" and (orphans := ask("PRAGMA foreign_key_check")):
        said = f"a row of {orphans[0][0]} belongs to nothing"
    if said != "ok":
        allowed = f"a database that SQLite finds whole ({said.splitlines()[-1]})"
        raise InputError("storage", shown, allowed)


def read_attributes(
    url: str, study_name: str
) -> tuple[dict[str, Any] | None, list[str]]:
    """The attributes that users have given to a study, None without it; and all studies' names.

    Raises:
        InputError: as `reading`.
    """
    with reading(url) as ask:
        if ask is None:
            return None, []
        names = [str(name) for (name,) in ask("SELECT study_name FROM studies")]
        if study_name not in names:
            return None, names
        found = ask(ATTRIBUTES, {"name": study_name})
        return {key: json.loads(value) for key, value in found}, names


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
    except Exception as error:
        known = sqlite3.Error, StorageInternalError, JSONDecodeError
        if not isinstance(error, known) and not is_of_sqlalchemy(error):
            raise
        raise unusable(shown_url(url), error) from None


def is_of_sqlalchemy(error: Exception) -> bool:
    """Whether it is an error of SQLAlchemy, which need not be loaded."""
    return any(kind.__module__ == "sqlalchemy.exc" for kind in type(error).__mro__)


@contextmanager
def read_errors(url: str) -> Iterator[None]:
    """The same for a block that only reads: any error is taken to be the database's fault."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise unusable(shown_url(url), error) from None


@contextmanager
def only_run(url: str, study_name: str) -> Iterator[None]:
    """Hold a study for this process: two runs of it would take each other's trials for dead.

    The lock is a file beside the database, or a lock of the server; it ends with the
    process, however that ends.
    """
    allowed = "one run of a study at a time; another process is running this one"
    taken = InputError("study", study_name, allowed)
    if is_postgresql(url):
        from storage.databases.postgresql import locked

        with locked(url, study_name) as free:
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


def claim(connection: sqlite3.Connection) -> None:
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


def stays(path: Path) -> Callable[..., None]:
    """A check, before each transaction, that the file still has its name.

    Without it SQLite goes on to write to the removed file, and all is lost with the
    process.
    """
    opened = path.stat()

    def check(*_: object) -> None:
        with suppress(OSError):
            if os.path.samestat(opened, path.stat()):
                return
        allowed = (
            "a file that stays where it is while a study runs; it was removed or replaced, "
            "and no trial since then is kept"
        )
        raise InputError("storage", str(path), allowed)

    return check
