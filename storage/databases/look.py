"""A database as it is, read alone: a refused one must not have been changed.

So is one whose schema is not the one of Optuna's that `bulk` knows how to write.
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


def known_tables(storage: RDBStorage) -> dict[str, sql.Table]:
    """The database's tables by name, as they are there.

    Raises:
        InputError: the schema is of another version of Optuna.
    """
    metadata = sql.MetaData()
    metadata.reflect(storage.engine, only=lambda name, _: name in TABLES)
    version = metadata.tables.get("version_info")
    if version is None or len(metadata.tables) < len(TABLES):
        raise _refusal("an unknown schema")
    with storage.engine.connect() as connection:
        found = connection.execute(sql.select(version.c.schema_version)).scalar()
    if found != SCHEMA_VERSION:
        raise _refusal(f"schema {found}")
    return dict(metadata.tables)


def _refusal(found: str) -> InputError:
    allowed = f"a database with Optuna's schema {SCHEMA_VERSION} (Optuna 5.0 makes such)"
    return InputError("storage", found, allowed)


REVISION_TABLE = "alembic_version"
OWNED = ("study_directions", "study_user_attributes", "study_system_attributes", "trials")
OF_TRIALS = tuple(
    name for name, columns in TABLES.items() if "trial_id" in columns and name != "trials"
)
NAMES = tuple(
    (table, name)
    for table, columns in TABLES.items()
    for name in ("study_name", "key", "param_name")
    if name in columns
)
COUNTED = ("studies", "version_info", REVISION_TABLE)  # the last two have a row, which Optuna adds


@contextmanager
def looked_at(url: str, shown: str, options: dict[str, Any]) -> Iterator[RDBStorage | None]:
    """The studies of a database, to be read; None where it has no tables.

    What the block raises is the database's fault, in one line: Optuna, which believes it, raises
    whatever it meets in there.

    Args:
        url: of the database.
        shown: what it is called in messages.
        options: of SQLAlchemy's engine; with them nothing can be written.

    Raises:
        InputError: not to be read, somebody else's, an Optuna schema of another version, or the
            block raised.
    """
    storage = None
    said = optuna.logging.get_verbosity()
    try:
        engine = sql.create_engine(url, **options)
        try:
            empty = _is_empty(engine, shown)
            if not empty:
                _require_whole(engine, shown)
                _require_named(engine, shown)
                _require_owned(engine, shown)
        finally:
            engine.dispose()
        if not empty:
            storage = RDBStorage(url, engine_kwargs=dict(options), skip_table_creation=True)
        optuna.logging.set_verbosity(optuna.logging.ERROR)  # what it thinks of a damaged value
        yield storage
    except InputError:
        raise
    except Exception as error:
        raise unusable(shown, error) from None
    finally:
        optuna.logging.set_verbosity(said)
        if storage is not None:
            storage.engine.dispose()


def _is_empty(engine: sql.Engine, shown: str) -> bool:
    """Whether there is nothing yet: no tables, or Optuna's without a study and without a version.

    These a killed process may have left, and Optuna finishes them. What is of another program is
    refused.
    """
    columns = {
        name: {column["name"] for column in listed}
        for (_, name), listed in sql.inspect(engine).get_multi_columns().items()
    }
    if not columns:
        return True
    complete = all(columns.get(name, set()) >= known for name, known in TABLES.items())
    with engine.connect() as connection:
        rows = {name: _count(connection, name) for name in COUNTED if complete and name in columns}
        complete &= REVISION_TABLE in rows and rows["version_info"] == rows[REVISION_TABLE] == 1
        empty = not complete and rows.get("studies") == 0 and max(rows.values()) <= 1
        empty = empty and not any(_count(connection, name) for name in (*OWNED, *OF_TRIALS))
    if not (complete or empty):
        raise InputError("storage", shown, "an Optuna database, or an empty one, or a new file")
    return empty


def _require_whole(engine: sql.Engine, shown: str) -> None:
    """Refuse a file of which SQLite cannot read every page: by itself it reads those it needs."""
    if engine.dialect.name != "sqlite":
        return
    with engine.connect() as connection:
        said = connection.execute(sql.text("PRAGMA quick_check(1)")).scalar()
    if said != "ok":
        reason = str(said).splitlines()[-1]
        raise InputError("storage", shown, f"a database that SQLite finds whole ({reason})")


def _require_named(engine: sql.Engine, shown: str) -> None:
    """Refuse names of studies, attributes or parameters that are no texts.

    SQLite keeps whatever it is given, and Optuna compares it with texts.
    """
    if engine.dialect.name != "sqlite":
        return
    with engine.connect() as connection:
        for table, name in NAMES:
            other = f"SELECT {name} FROM {table} WHERE typeof({name}) <> 'text' LIMIT 1"
            for (found,) in connection.execute(sql.text(other)):
                allowed = f"a database whose {table} have texts for {name}, not {found!r}"
                raise InputError("storage", shown, allowed)


def _require_owned(engine: sql.Engine, shown: str) -> None:
    """Refuse what belongs to a study or a trial that is gone: it would be given to the next one.

    Of trials, whose rows are many, only those matter that come after the last one.
    """
    with engine.connect() as connection:
        known = {row[0] for row in connection.execute(sql.text("SELECT study_id FROM studies"))}
        for name in OWNED:
            query = sql.text(f"SELECT DISTINCT study_id FROM {name}")
            if not {row[0] for row in connection.execute(query)} <= known:
                raise _not_owned(shown, name, "study")
        last = "SELECT COALESCE(MAX(trial_id), 0) FROM trials"
        for name in OF_TRIALS:
            query = sql.text(f"SELECT (SELECT MAX(trial_id) FROM {name}) > ({last})")
            if connection.execute(query).scalar():
                raise _not_owned(shown, name, "trial")


def _not_owned(shown: str, table: str, owner: str) -> InputError:
    allowed = f"a database without rows in {table} of a {owner} that is not there"
    return InputError("storage", shown, allowed)


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
