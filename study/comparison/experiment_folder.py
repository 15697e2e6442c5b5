"""The folder of an experiment. The folder is the state; this class knows every file in it.

experiment.json         written first: what is compared on what, with which stores and versions
arms/NAME.parquet       all finished trials of an arm, rewritten whole at each checkpoint
trials.parquet          written last: all arms
proposal_times.parquet  written last: what the samplers took, which no two runs agree upon
run.json                when, on what machine, and how long
studies.db              the study database, where no other is asked for
artifacts/              pictures and films of each study's best trial
.lock                   held by the one process that writes
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from storage.claim import claimed, remove, require_claimable
from storage.commit import TEMPORARY_SUFFIX, commit_json, writable
from storage.databases.studies import studies_path
from storage.databases.urls import is_postgresql
from storage.document import agree, agreed
from storage.shard import write_table
from storage.stamped import read_stamped, write_stamped
from study.comparison.results import RESULT_SCHEMA, STATE_SCHEMA, TIME_COLUMNS, in_order
from study.experiment.identity import GROWING
from taichi_nmm.errors import InputError
from taichi_nmm.reading import json_document

EXPERIMENT_NAME = "experiment.json"
RESULTS_NAME = "trials.parquet"
TIMES_NAME = "proposal_times.parquet"
RUN_NAME = "run.json"
ARMS_NAME = "arms"
DATABASE_NAME = "studies.db"
ARTIFACTS_NAME = "artifacts"
KIND = "an experiment's"  # folder, for messages

Document = dict[str, Any]


def live_artifacts(url: str, out: Path) -> Path:
    """The folder of pictures of live studies: beside their database's file, or else in `out`.

    Raises:
        InputError: the URL names no study database.
    """
    return (out if is_postgresql(url) else studies_path(url).parent) / ARTIFACTS_NAME


@dataclass(frozen=True)
class ExperimentFolder:
    """A folder being filled; made by `claim`, which gives one process the right to write.

    Attributes:
        path: of the folder.
        document: what is compared on what.
    """

    path: Path
    document: Document

    @staticmethod
    @contextmanager
    def claim(path: Path, document: Document) -> Iterator["ExperimentFolder"]:
        """Hold the folder: new, or begun with the same document (arms and stores may be added).

        Raises:
            InputError: in use by another process, of something else, of another document, or not
                writable.
        """
        with claimed(path, EXPERIMENT_NAME, KIND):
            agreed = agree(
                path / EXPERIMENT_NAME, document, growing=GROWING, remedy="another --out"
            )
            with writable(path):
                (path / ARMS_NAME).mkdir(exist_ok=True)
            remove(path / ARMS_NAME, f".*{TEMPORARY_SUFFIX}")
            yield ExperimentFolder(path, agreed)

    @staticmethod
    def check(path: Path, document: Document) -> None:
        """Refuse what cannot be gone on with, before anything is written.

        Raises:
            InputError: as `claim`, of a folder that nobody else holds, and `read_arm`.
        """
        require_claimable(path, EXPERIMENT_NAME, KIND)
        known = agreed(path / EXPERIMENT_NAME, document, growing=GROWING, remedy="another --out")
        folder = ExperimentFolder(path, known)
        for name in folder.arms():
            folder.read_arm(name)

    def arms(self) -> list[str]:
        """Arms that have finished trials here."""
        return sorted(file.stem for file in (self.path / ARMS_NAME).glob("*.parquet"))

    def read_arm(self, name: str) -> pa.Table:
        """The finished trials of an arm, by run and trial; empty for one that is new.

        Raises:
            InputError: a damaged or edited file, one of another experiment or of something else, or
                one with a gap.
        """
        path = self._arm(name)
        if not path.exists():
            return STATE_SCHEMA.empty_table()
        table = read_stamped(path, self.document, GROWING)
        if not table.schema.equals(STATE_SCHEMA) or set(table["arm"].to_pylist()) - {name}:
            raise InputError("out", str(path), f"finished trials of {name}, in this version's form")
        _require_complete(table, path)
        return table

    def write_arm(self, name: str, table: pa.Table) -> None:
        """Commit the finished trials of an arm."""
        write_stamped(self._arm(name), table, self.document)

    def write_results(self) -> pa.Table:
        """Commit the tables of all arms that have trials here, and return the results."""
        state = in_order([STATE_SCHEMA.empty_table(), *map(self.read_arm, self.arms())])
        results = state.select(RESULT_SCHEMA.names)
        write_table(self.path / RESULTS_NAME, results, self.document)
        write_table(self.path / TIMES_NAME, state.select(TIME_COLUMNS), self.document)
        return results

    def note_session(self, session: Document) -> None:
        """Add a session to run.json, or replace the last one if that began at the same time."""
        path = self.path / RUN_NAME
        try:
            sessions = list(json_document("out", path, "a list of sessions")["sessions"])
        except (InputError, KeyError, TypeError):  # it says when, and decides nothing
            sessions = []
        last = sessions[-1] if sessions else None
        if isinstance(last, dict) and last.get("started") == session["started"]:
            sessions.pop()
        commit_json(path, {"sessions": [*sessions, session]})

    def _arm(self, name: str) -> Path:
        return self.path / ARMS_NAME / f"{name}.parquet"


def _require_complete(table: pa.Table, path: Path) -> None:
    """Refuse a table whose runs do not have the trials 0, 1, ... without a gap."""
    run, trial = table["run"].to_numpy(), table["trial"].to_numpy()
    first = np.ones(len(run), dtype=bool)
    first[1:] = run[1:] != run[:-1]
    sound = trial[first] == 0, np.diff(trial)[~first[1:]] == 1, np.diff(run) >= 0
    if not all(part.all() for part in sound):
        raise InputError("out", str(path), "every run's trials in their order, without a gap")
