"""Study databases on a PostgreSQL server, which many machines share; and crews.

A crew is several processes, on any machines, that work on one study. They take turns at proposing,
by a lock of the server, so that no row is proposed twice and no trial too many is begun. A running
trial has a heartbeat, in Optuna's own table; without one its process, its machine or its network is
dead.

Optuna's own heartbeats run within `Study.optimize` alone. A crew asks and tells, so that a proposal
is made in a turn, and a process that finds itself alone need not wait until heartbeats are old.
"""

import threading
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import sqlalchemy as sql
from optuna.storages import RDBStorage
from sqlalchemy.exc import NoSuchModuleError, OperationalError, SQLAlchemyError

from storage.databases.urls import POSTGRESQL_FORM, public_url
from taichi_nmm.errors import InputError

CONNECT_TIMEOUT_S = 10
TABLES_LOCK = "taichi-nmm/tables"  # no study's name: those have three parts
CONNECT = {"connect_timeout": CONNECT_TIMEOUT_S}
READ_ONLY = {"options": "-c default_transaction_read_only=on"}
# A server that was restarted between two checkpoints is noticed by the first, cheap question.
ENGINE_OPTIONS: dict[str, Any] = {"connect_args": CONNECT, "pool_pre_ping": True}
READING_OPTIONS: dict[str, Any] = {"connect_args": CONNECT | READ_ONLY}

BEAT_S = 5.0
GRACE_S = 30.0  # without a beat: six of them lost, or a stall that long
JOIN_S = 10  # that a process alone with the study may take to tidy it
KEY = "hashtextextended(:study, 0)"
TURN_KEY = "hashtextextended(:study || '/turn', 0)"
NOW = "(now() AT TIME ZONE 'utc')"  # the server's clock, whatever zone a client is in
OF_STUDY = "trials JOIN studies USING (study_id) WHERE study_name = :study"
_TEXT = Path(__file__).with_name("heartbeats.toml").read_text(encoding="utf-8")
BEAT, STILL, DEAD = (
    tomllib.loads(_TEXT)[name].format(now=NOW, of_study=OF_STUDY)
    for name in ("beat", "still", "dead")
)


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

    The server gives the lock back when the connection ends, however this process ends. The name may
    also be of other work that one process does at a time; `wait` until it is free.
    """
    take = "pg_advisory_lock" if wait else "pg_try_advisory_lock"
    with connected(url) as engine, _own(engine) as connection:
        free = connection.execute(sql.text(f"SELECT {take}({KEY})"), {"study": name}).scalar()
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


class Crew:
    """One of several processes that work on a study; made by `joined`.

    `connection` holds the locks of this process, which end with it.
    """

    def __init__(self, engine: sql.Engine, connection: sql.Connection, study_name: str) -> None:
        self._engine = engine
        self._connection = connection
        self._study = {"study": study_name}

    @staticmethod
    @contextmanager
    def joined(url: str, study_name: str) -> Iterator["Crew"]:
        """Be of the crew while the block lasts.

        A process that finds nobody there ends the heartbeats of all running trials: they are dead.

        Raises:
            InputError: a process has the study for itself, or the server is gone.
        """
        with connected(url) as engine, _own(engine) as connection:
            crew = Crew(engine, connection, study_name)
            if crew._do(f"SELECT pg_try_advisory_lock({KEY})"):
                crew._do(STILL)
                crew._do(f"SELECT pg_advisory_lock_shared({KEY})")
                crew._do(f"SELECT pg_advisory_unlock({KEY})")
            else:
                crew._do(f"SET lock_timeout = '{JOIN_S}s'")
                try:
                    crew._do(f"SELECT pg_advisory_lock_shared({KEY})")
                except OperationalError:
                    allowed = "a study that no process has for itself; one is running this one"
                    raise InputError("study", study_name, allowed) from None
                crew._do("SET lock_timeout = 0")
            yield crew

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Be alone of the crew in this block; wait for the others."""
        self._do(f"SELECT pg_advisory_lock({TURN_KEY})")
        try:
            yield
        finally:
            with suppress(SQLAlchemyError):  # a server that is gone has no locks
                self._do(f"SELECT pg_advisory_unlock({TURN_KEY})")

    def dead(self) -> list[int]:
        """Numbers of running trials whose processes are gone; to be called within a turn."""
        found = self._connection.execute(sql.text(DEAD), self._study | {"grace": GRACE_S})
        return [int(number) for (number,) in found]

    @contextmanager
    def alive(self, number: int) -> Iterator[None]:
        """Show that a trial's process lives, while the block lasts; to be begun within a turn."""
        words, over = self._study | {"number": number}, threading.Event()
        self._connection.execute(sql.text(BEAT), words)

        def beat() -> None:
            while not over.wait(BEAT_S):
                with suppress(SQLAlchemyError), _own(self._engine) as connection:
                    connection.execute(sql.text(BEAT), words)

        thread = threading.Thread(target=beat, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()

    def _do(self, statement: str) -> object:
        """Run a statement; its first value, if it has one."""
        found = self._connection.execute(sql.text(statement), self._study)
        return found.scalar() if found.returns_rows else None


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


def _own(engine: sql.Engine) -> sql.Connection:
    """A connection, to be closed, whose statements commit by themselves."""
    return engine.connect().execution_options(isolation_level="AUTOCOMMIT")
