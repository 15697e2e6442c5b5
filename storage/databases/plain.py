"""Attributes and trials in a SQLite study database, written without SQLAlchemy.

SQLAlchemy, and what Optuna asks it before the first query, take a second of processor
time. A bench enters one number at a time; so an entry, and what a study shows of it, are
written here by SQLite itself, a transaction each. The tables are those of Optuna's known
schema; a file with any other is left to Optuna.
"""

import json
import math
import sqlite3
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from optuna.distributions import json_to_distribution
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from storage.databases.files import (
    BUSY_TIMEOUT_S,
    OF_TRIALS,
    OWNED,
    SCHEMA_VERSION,
    claim,
    reading,
    stays,
    studies_path,
)
from storage.databases.trial_rows import attribute_rows, naive_utc, rows_of

REVISION = "v3.2.0.a"  # of the schema, as Optuna's own upgrades name it
COMMIT = "storage.commit"  # the audit event of a transaction
SHOWN = ("trial_values", "trial_params", "trial_user_attributes")
PLACES = {  # columns of a row, beside the trial's
    "trial_values": ("objective", "value", "value_type"),
    "trial_params": ("param_name", "param_value", "distribution_json"),
    "trial_user_attributes": ("key", "value_json"),
    "trial_system_attributes": ("key", "value_json"),
}
MOMENT = "%Y-%m-%d %H:%M:%S.%f"  # of a time, as SQLAlchemy writes it to SQLite
known_distribution = cache(json_to_distribution)


def is_known(url: str) -> bool:
    """Whether a SQLite URL names a database with studies, of the known schema.

    Raises:
        InputError: a database that is refused.
    """
    with reading(url) as ask:
        if ask is None:
            return False
        found = ask(
            "SELECT schema_version, version_num FROM version_info, alembic_version"
        )
        return found == [(SCHEMA_VERSION, REVISION)]


class PlainStudies:
    """A SQLite study database of the known schema, which is written here.

    Args:
        url: of the file, which is there.
    """

    def __init__(self, url: str) -> None:
        path = studies_path(url)
        self._path: Path = path
        self._stays = stays(path)
        self._connection = sqlite3.connect(
            path,
            timeout=BUSY_TIMEOUT_S,
            isolation_level=None,
            check_same_thread=False,
        )
        claim(self._connection)
        self._connection.execute("PRAGMA synchronous=NORMAL")

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """All that is written in the block, or nothing; one within another is a part of it."""
        connection = self._connection
        if connection.in_transaction:
            yield
            return
        self._stays()
        connection.execute("BEGIN IMMEDIATE")
        try:
            yield
            sys.audit(COMMIT, str(self._path))
            connection.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                connection.rollback()
            raise

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def write_down(self) -> None:
        """Bring what lies in the write-ahead log into the file, as far as no reader holds it up."""
        self._connection.execute("PRAGMA wal_checkpoint(PASSIVE)")

    def set_attribute(self, study: str, key: str, value: Any) -> None:
        """Set a user attribute, a JSON value, of a study, which is made where it is missing."""
        with self.transaction():
            own = self._study(study, StudyDirection.MINIMIZE)
            told = {"study": own, **attribute_rows({key: value})[0]}
            self._do(
                "DELETE FROM study_user_attributes WHERE study_id = :study AND key = :key",
                {"study": own, "key": key},
            )
            self._do(
                "INSERT INTO study_user_attributes (study_id, key, value_json) "
                "VALUES (:study, :key, :value_json)",
                told,
            )

    def require_readable(self, study: str) -> None:
        """Read the trials of a study as Optuna would.

        Raises:
            ValueError: one that somebody has edited so that it cannot be read.
        """
        self._trials(study)

    def bring(
        self, study: str, direction: StudyDirection, wanted: Sequence[FrozenTrial]
    ) -> None:
        """Let a study have these trials, by their places; those that run may be finished.

        If that needs any other change, it is made anew: a dashboard keeps what it has
        read of a finished trial.
        """
        with self.transaction():
            found = self._trials(study)
            own = self._study(study, direction)
            told = [Shown.of(trial) for trial in wanted]
            pairs = list(zip(found, told, strict=False))
            if len(found) > len(told) or not all(
                old.shown == new or old.shown.may_become(new) for old, new in pairs
            ):
                self._delete(own)
                found, pairs = [], []
                own = self._study(study, direction)
            for (old, new), trial in zip(pairs, wanted, strict=False):
                if old.shown != new:
                    self._finish(old.key, trial)
            for number in range(len(found), len(wanted)):
                self._add(own, number, wanted[number])

    def _do(self, query: str, told: Mapping[str, Any]) -> sqlite3.Cursor:
        return self._connection.execute(query, told)

    def _study(self, name: str, direction: StudyDirection) -> int:
        """The number of a study, which is made where it is missing."""
        query = "SELECT study_id FROM studies WHERE study_name = :name"
        found = self._do(query, {"name": name}).fetchone()
        if found is not None:
            return int(found[0])
        own = self._do(
            "INSERT INTO studies (study_name) VALUES (:name)", {"name": name}
        )
        self._do(
            "INSERT INTO study_directions (study_id, objective, direction) "
            "VALUES (:study, 0, :direction)",
            {"study": own.lastrowid, "direction": direction.name},
        )
        return int(own.lastrowid or 0)

    def _trials(self, study: str) -> list["Found"]:
        """The trials of a study in the order of their numbers; none where it is not there."""
        told = {"name": study}
        query = (
            "SELECT direction FROM study_directions JOIN studies USING (study_id) "
            "WHERE study_name = :name"
        )
        for (direction,) in self._do(query, told):
            _ = StudyDirection[direction]
        query = (
            "SELECT trial_id, state FROM trials JOIN studies USING (study_id) "
            "WHERE study_name = :name ORDER BY number"
        )
        found = {
            key: Found(key, Shown(TrialState[state], {}, {}, {}))
            for key, state in self._do(query, told)
        }
        for table in SHOWN:
            columns = ", ".join(PLACES[table])
            query = (
                f"SELECT trial_id, {columns} FROM {table} JOIN trials USING (trial_id) "
                "JOIN studies USING (study_id) WHERE study_name = :name"
            )
            for key, *row in self._do(query, told):
                found[key].shown.take(table, row)
        return [*found.values()]

    def _delete(self, study: int) -> None:
        own = {"study": study}
        for table in OF_TRIALS:
            self._do(
                f"DELETE FROM {table} WHERE trial_id IN "
                "(SELECT trial_id FROM trials WHERE study_id = :study)",
                own,
            )
        for table in (*reversed(OWNED), "studies"):
            self._do(f"DELETE FROM {table} WHERE study_id = :study", own)

    def _add(self, study: int, number: int, trial: FrozenTrial) -> None:
        added = self._do(
            "INSERT INTO trials (study_id, number, state, datetime_start, "
            "datetime_complete) VALUES (:study, :number, :state, :begun, :ended)",
            {"study": study, "number": number, **_state_of(trial)},
        )
        self._tell(int(added.lastrowid or 0), trial)

    def _finish(self, key: int, trial: FrozenTrial) -> None:
        """Let a trial that runs be another one of the same parameters."""
        self._do(
            "UPDATE trials SET state = :state, datetime_complete = :ended "
            "WHERE trial_id = :trial",
            {"trial": key, **_state_of(trial)},
        )
        for table in PLACES:
            named = ""
            told: dict[str, Any] = {"trial": key}
            if "attributes" in table:  # others may have left notes
                names = [row["key"] for each, row in rows_of(trial) if each == table]
                told |= {f"key{place}": name for place, name in enumerate(names)}
                marks = ", ".join(f":key{place}" for place in range(len(names)))
                named = f" AND key IN ({marks})"
            self._do(f"DELETE FROM {table} WHERE trial_id = :trial{named}", told)
        self._tell(key, trial)

    def _tell(self, key: int, trial: FrozenTrial) -> None:
        for table, row in rows_of(trial):
            columns = PLACES[table]
            marks = ", ".join(f":{column}" for column in columns)
            self._do(
                f"INSERT INTO {table} (trial_id, {', '.join(columns)}) "
                f"VALUES (:trial, {marks})",
                {"trial": key, **row},
            )


@dataclass(frozen=True)
class Shown:
    """What a study shows of a trial.

    Attributes:
        state: of the trial.
        values: by the number of the objective.
        params: value and distribution of each, by name.
        notes: user attributes, by key.
    """

    state: TrialState
    values: dict[int, float | None]
    params: dict[str, tuple[float, str]]
    notes: dict[str, Any]

    @classmethod
    def of(cls, trial: FrozenTrial) -> "Shown":
        """What is to be shown."""
        found = cls(trial.state, {}, {}, {})
        for table, row in rows_of(trial):
            if table in SHOWN:
                found.take(table, [row[column] for column in PLACES[table]])
        return found

    def take(self, table: str, row: Sequence[Any]) -> None:
        """Take a row of a table in.

        Raises:
            ValueError: a row that Optuna could not read.
        """
        if table == "trial_values":
            objective, value, kind = row
            if objective != 0 or (kind not in INFINITE and not _is_number(value)):
                raise ValueError(f"{objective!r}, {value!r}, {kind!r}: no value")
            self.values[objective] = INFINITE.get(kind, value)
        elif table == "trial_params":
            name, number, text = row
            if not _is_number(number):
                raise ValueError(f"{number!r}: no parameter")
            _ = known_distribution(text).to_external_repr(number)
            self.params[name] = number, text
        else:
            name, text = row
            self.notes[name] = json.loads(text)

    def may_become(self, other: "Shown") -> bool:
        """Whether a trial that runs may become the other one."""
        is_open = (
            self.state is TrialState.RUNNING and other.state is not TrialState.FAIL
        )
        return is_open and self.params == other.params


INFINITE = {"INF_POS": math.inf, "INF_NEG": -math.inf}


@dataclass(frozen=True)
class Found:
    """A trial of the database.

    Attributes:
        key: its number there.
        shown: what it shows.
    """

    key: int
    shown: Shown


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float)


def _state_of(trial: FrozenTrial) -> dict[str, Any]:
    moments = {"begun": trial.datetime_start, "ended": trial.datetime_complete}
    told = {
        name: None if at is None else naive_utc(at).strftime(MOMENT)
        for name, at in moments.items()
    }
    return {"state": trial.state.name, **told}
