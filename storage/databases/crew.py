"""Several processes, on any machines, that work on one study of a PostgreSQL server.

They take turns at proposing, by a lock of the server, so that no row is proposed twice and no trial
too many is begun. A running trial has a heartbeat, in Optuna's own table; without one its process,
its machine or its network is dead.

Optuna's own heartbeats run within `Study.optimize` alone. A crew asks and tells, so that a proposal
is made in a turn, and a process that finds itself alone need not wait until heartbeats are old.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import sqlalchemy as sql
from sqlalchemy.exc import OperationalError, SQLAlchemyError

from storage.databases import postgresql
from taichi_nmm.errors import InputError

BEAT_S = 5.0
GRACE_S = 30.0  # without a beat: six of them lost, or a stall that long
JOIN_S = 10  # that a process alone with the study may take to tidy it
KEY = "hashtextextended(:study, 0)"
TURN_KEY = "hashtextextended(:study || '/turn', 0)"
NOW = "(now() AT TIME ZONE 'utc')"  # the server's clock, whatever zone a client is in
OF_STUDY = "trials JOIN studies USING (study_id) WHERE study_name = :study"
BEAT = f"""
    INSERT INTO trial_heartbeats (trial_id, heartbeat)
    SELECT trial_id, {NOW} FROM {OF_STUDY} AND number = :number
    ON CONFLICT (trial_id) DO UPDATE SET heartbeat = {NOW}
"""
STILL = f"""
    DELETE FROM trial_heartbeats
    WHERE trial_id IN (SELECT trial_id FROM {OF_STUDY} AND state = 'RUNNING')
"""
DEAD = f"""
    SELECT number FROM {OF_STUDY} AND state = 'RUNNING' AND NOT EXISTS (
        SELECT 1 FROM trial_heartbeats
        WHERE trial_heartbeats.trial_id = trials.trial_id
        AND heartbeat >= {NOW} - make_interval(secs => :grace)
    )
"""


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
        with postgresql.connected(url) as engine, _own(engine) as connection:
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


@contextmanager
def _own(engine: sql.Engine) -> Iterator[sql.Connection]:
    """A connection whose statements commit by themselves."""
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        yield connection
