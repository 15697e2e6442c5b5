"""A database read as it is: nothing of a refused one may be changed.

A database is refused, too, if it has another schema of Optuna than the one that `bulk` writes.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from sqlite3 import Connection, connect
from typing import Any
from urllib.parse import quote

import optuna
import sqlalchemy as sql
from optuna.storages import RDBStorage

from storage.databases.postgresql import unusable
from taichi_nmm.errors import InputError

SCHEMA_VERSION = 12  # Optuna 3.0 to 5.0, with the column types of revision v3.2.0.a and later
TABLES: dict[str, set[str]] = {  # with their columns
    "studies": {"study_id", "study_name"},
    "study_directions": {"study_direction_id", "direction", "study_id", "objective"},
    "study_user_attributes": {"study_user_attribute_id", "study_id", "key", "value_json"},
    "study_system_attributes": {"study_system_attribute_id", "study_id", "key", "value_json"},
    "trials": {"trial_id", "number", "study_id", "state", "datetime_start", "datetime_complete"},
    "trial_values": {"trial_value_id", "trial_id", "objective", "value", "value_type"},
    "trial_params": {"param_id", "trial_id", "param_name", "param_value", "distribution_json"},
    "trial_user_attributes": {"trial_user_attribute_id", "trial_id", "key", "value_json"},
    "trial_system_attributes": {"trial_system_attribute_id", "trial_id", "key", "value_json"},
    "trial_intermediate_values": {
        "trial_intermediate_value_id", "trial_id", "step", "intermediate_value",
        "intermediate_value_type",
    },
    "trial_heartbeats": {"trial_heartbeat_id", "trial_id", "heartbeat"},
    "version_info": {"version_info_id", "schema_version", "library_version"},
}  # fmt: skip


REVISION_TABLE = "alembic_version"
OWNED = ("study_directions", "study_user_attributes", "study_system_attributes", "trials")
OF_TRIALS = tuple(
    name for name, columns in TABLES.items() if "trial_id" in columns and name != "trials"
)
NAMES = ("study_name", "key", "param_name")  # columns of texts
COUNTED = ("studies", "version_info", REVISION_TABLE)  # the last two have a row, which Optuna adds


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
    allowed = f"a database with Optuna's schema {SCHEMA_VERSION} (Optuna 5.0 makes such)"
    raise InputError("storage", found, allowed)


@contextmanager
def looked_at(url: str, shown: str, options: dict[str, Any]) -> Iterator[RDBStorage | None]:
    """The studies of a database, to be read; None where it has no tables.

    Optuna trusts a database, and raises any error where it is damaged: so whatever the block raises
    is reported as the database's fault, in one line.

    Args:
        url: of the database.
        shown: its name in messages.
        options: of SQLAlchemy's engine; with them nothing can be written.

    Raises:
        InputError: not to be read, somebody else's, an Optuna schema of another version, or the
            block raised.
    """
    storage = None
    verbosity = optuna.logging.get_verbosity()
    try:
        engine = sql.create_engine(url, **options)
        try:
            with engine.connect() as connection:
                empty = _is_empty(connection, shown)
                if not empty:
                    _check_texts(connection, shown)
                    _check_owners(connection, shown)
        finally:
            engine.dispose()
        if not empty:
            storage = RDBStorage(url, engine_kwargs=dict(options), skip_table_creation=True)
        optuna.logging.set_verbosity(optuna.logging.ERROR)  # no warnings about damaged values
        yield storage
    except InputError:
        raise
    except Exception as error:
        raise unusable(shown, error) from None
    finally:
        optuna.logging.set_verbosity(verbosity)
        if storage is not None:
            storage.engine.dispose()


def _is_empty(connection: sql.Connection, shown: str) -> bool:
    """Whether there is nothing yet: no tables, or Optuna's without a study and without a version.

    A killed process may leave such tables, and Optuna finishes them. A database of another program
    is refused.
    """
    columns = {
        name: {column["name"] for column in listed}
        for (_, name), listed in sql.inspect(connection).get_multi_columns().items()
    }
    if not columns:
        return True
    complete = all(columns.get(name, set()) >= known for name, known in TABLES.items())
    rows = {name: _count(connection, name) for name in COUNTED if complete and name in columns}
    complete &= REVISION_TABLE in rows and rows["version_info"] == rows[REVISION_TABLE] == 1
    empty = not complete and rows.get("studies") == 0 and max(rows.values()) <= 1
    empty = empty and not any(_count(connection, name) for name in (*OWNED, *OF_TRIALS))
    if not (complete or empty):
        raise InputError("storage", shown, "an Optuna database, or an empty one, or a new file")
    return empty


def _check_texts(connection: sql.Connection, shown: str) -> None:
    """Refuse a SQLite file with a damaged page, or with a number for a name.

    By itself SQLite reads the pages that it needs, and keeps any value; Optuna compares names with
    texts.
    """
    if connection.dialect.name != "sqlite":
        return
    said = str(connection.execute(sql.text("PRAGMA quick_check(1)")).scalar())
    if said != "ok":
        allowed = f"a database that SQLite finds whole ({said.splitlines()[-1]})"
        raise InputError("storage", shown, allowed)
    for table, columns in TABLES.items():
        for name in columns.intersection(NAMES):
            other = f"SELECT {name} FROM {table} WHERE typeof({name}) <> 'text' LIMIT 1"
            for (found,) in connection.execute(sql.text(other)):
                allowed = f"a database whose {table} have texts for {name}, not {found!r}"
                raise InputError("storage", shown, allowed)


def _check_owners(connection: sql.Connection, shown: str) -> None:
    """Refuse rows of a study or a trial that is gone: they would be given to the next one.

    Trials have many rows; only rows after the last trial matter.
    """
    known = "SELECT 1 FROM studies WHERE studies.study_id = owned.study_id"
    last = "SELECT COALESCE(MAX(trial_id), 0) FROM trials"
    for name in (*OWNED, *OF_TRIALS):
        owner, gone = "study", f"NOT EXISTS ({known})"
        if name in OF_TRIALS:
            owner, gone = "trial", f"trial_id > ({last})"
        query = sql.text(f"SELECT 1 FROM {name} AS owned WHERE {gone} LIMIT 1")
        if connection.execute(query).first():
            allowed = f"a database without rows in {name} of a {owner} that is not there"
            raise InputError("storage", shown, allowed)


def _count(connection: sql.Connection, table: str) -> int:
    query = sql.select(sql.func.count()).select_from(sql.table(table))
    return int(connection.execute(query).scalar_one())


def sqlite_options(path: Path, timeout_s: float) -> dict[str, Any]:
    """Options of an engine that reads a SQLite file.

    When SQLite reads a database in WAL mode, it leaves files beside it, unless the database is
    immutable: which it is, for a moment, where there is no log beside it. A journal that a crash
    left is rolled back by SQLite before anything can be read.
    """

    def beside(ending: str) -> bool:
        return path.with_name(path.name + ending).exists()

    mode = "mode=ro" if beside("-wal") else "mode=ro&immutable=1"
    name = quote(os.fsencode(path.absolute()).lstrip(b"/"))
    uri = f"file:///{name}?{'mode=rw' if beside('-journal') else mode}"

    def creator() -> Connection:
        return connect(uri, uri=True, timeout=timeout_s, check_same_thread=False)

    return {"creator": creator, "poolclass": sql.NullPool}
