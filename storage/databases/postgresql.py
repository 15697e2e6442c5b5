"""Study databases on a PostgreSQL server, which many machines share; and crews.

A crew is several processes, on any machines, that work on one study. They take turns at
proposing, by a lock of the server, so that no row is proposed twice and no trial too
many is begun. A running trial has such a lock too, which ends with its process: without
one that is dead, or its machine, or its network. Optuna's heartbeats run within
`Study.optimize` alone, where there are no turns, and one that has stopped is known only
after a while.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Any

import sqlalchemy as sql
from optuna.storages import RDBStorage
from sqlalchemy.exc import NoSuchModuleError, SQLAlchemyError

from storage.databases.urls import POSTGRESQL_FORM, public_url, unusable
from storage.inputs.errors import InputError

CONNECT_TIMEOUT_S = 10
TABLES_LOCK = "taichi-nmm/tables"  # no study's name: those have three parts
CONNECT = {"connect_timeout": CONNECT_TIMEOUT_S}
READ_ONLY = {"options": "-c default_transaction_read_only=on"}
# A server that was restarted between two checkpoints is noticed by the first, cheap
# question.
ENGINE_OPTIONS: dict[str, Any] = {"connect_args": CONNECT, "pool_pre_ping": True}
READING_OPTIONS: dict[str, Any] = {"connect_args": CONNECT | READ_ONLY}

# By which the server ends the session, and so the locks, of a machine that is gone:
# after 30 s.
KEEPALIVES = {"idle": 10, "interval": 5, "count": 4}

KEY = "hashtextextended(:study, 0)"
TURN_KEY = "hashtextextended(:study || '/turn', 0)"
TRIAL_KEY = "hashtextextended(:study || '/trial/' || {number}, 0)"
DEAD = f"""
    SELECT number FROM trials JOIN studies USING (study_id)
    WHERE study_name = :study AND state = 'RUNNING' AND {TRIAL_KEY.format(number="number")} NOT IN (
        SELECT classid::int8 << 32 | objid::int8  -- the two halves of a key
        FROM pg_locks JOIN pg_database ON database = pg_database.oid
        WHERE locktype = 'advisory' AND datname = current_database()
    )
"""


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
        raise InputError(
            "storage", shown, f"{POSTGRESQL_FORM}; an @ in a password is %40"
        )
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
    The name may also be of other work that one process does at a time; `wait` until it
    is free.
    """
    take = "pg_advisory_lock" if wait else "pg_try_advisory_lock"
    with connected(url) as engine, _own(engine) as connection:
        free = connection.execute(
            sql.text(f"SELECT {take}({KEY})"), {"study": name}
        ).scalar()
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


@contextmanager
def asked(url: str) -> Iterator[Callable[..., list[Any]]]:
    """Ask a server's database, reading alone: a `files.Ask`."""
    engine = sql.create_engine(url, **READING_OPTIONS)
    try:
        with engine.connect() as connection:
            yield lambda query, told=None: [
                tuple(row) for row in connection.execute(sql.text(query), told or {})
            ]
    finally:
        engine.dispose()


class Crew:
    """One of several processes that work on a study; made by `joined`.

    `connection` holds the locks of this process, which end with it.
    """

    def __init__(self, connection: sql.Connection, study_name: str) -> None:
        self._connection = connection
        self._study = {"study": study_name}

    @staticmethod
    @contextmanager
    def joined(url: str, study_name: str) -> Iterator["Crew"]:
        """Be of the crew while the block lasts.

        Raises:
            InputError: a process has the study for itself, or the server is gone.
        """
        with connected(url) as engine, _own(engine) as connection:
            crew = Crew(connection, study_name)
            for name, value in KEEPALIVES.items():
                crew._do(f"SET tcp_keepalives_{name} = {value}")
            if not crew._do(f"SELECT pg_try_advisory_lock_shared({KEY})"):
                allowed = (
                    "a study that no process has for itself; one is running this one"
                )
                raise InputError("study", study_name, allowed)
            yield crew

    def turn(self) -> AbstractContextManager[None]:
        """Be alone of the crew in this block; wait for the others."""
        return self._holding(TURN_KEY)

    def dead(self) -> list[int]:
        """Numbers of running trials whose processes are gone; to be called within a turn."""
        return [*self._connection.execute(sql.text(DEAD), self._study).scalars()]

    def alive(self, number: int) -> AbstractContextManager[None]:
        """Show that a trial's process lives, while the block lasts; to be begun within a turn."""
        return self._holding(TRIAL_KEY.format(number=number))

    @contextmanager
    def _holding(self, key: str) -> Iterator[None]:
        self._do(f"SELECT pg_advisory_lock({key})")
        try:
            yield
        finally:
            with suppress(SQLAlchemyError):  # a server that is gone has no locks
                self._do(f"SELECT pg_advisory_unlock({key})")

    def _do(self, statement: str) -> object:
        """Run a statement; its first value, if it has one."""
        found = self._connection.execute(sql.text(statement), self._study)
        return found.scalar() if found.returns_rows else None


def _engine(url: str, shown: str) -> sql.Engine:
    try:
        return sql.create_engine(url, **ENGINE_OPTIONS)
    except (ImportError, NoSuchModuleError):
        allowed = "an environment with its driver: pip install 'taichi-nmm[postgres]'"
        raise InputError("storage", shown, allowed) from None


def _own(engine: sql.Engine) -> sql.Connection:
    """A connection, to be closed, whose statements commit by themselves."""
    return engine.connect().execution_options(isolation_level="AUTOCOMMIT")
