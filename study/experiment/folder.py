"""The identity of an experiment, and its folder with its tables: the state of a comparison.

The identity is all that decides the trials, as JSON values. There is one such document:
the folder, a study database and a live study all keep it, or its digest, and refuse to
go on with another.

experiment.json         written first: what is compared on what, with which stores and versions
arms/NAME.parquet       all finished trials of an arm, rewritten whole at each checkpoint
trials.parquet          written last: all arms
proposal_times.parquet  written last: how long the samplers took, which differs from run to run
run.json                when, on what machine, and how long
studies.db              the study database, unless another one is asked for
.lock                   held by the one process that writes

The tables of arms have two columns more than the results: the seconds that the sampler
took, and its notes in the trial, from which a stopped study is set up again.
"""

import os
import platform
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa

from storage.commit import TEMPORARY_SUFFIX, commit_json, writable
from storage.databases.studies import studies_path
from storage.databases.urls import is_postgresql
from storage.folder import Folder, remove
from storage.inputs.errors import InputError
from storage.inputs.reading import json_document
from storage.tables import FORMAT, document_hash, write_table
from study.experiment.arms import Arm
from study.experiment.experiment import (
    WALKED,
    Experiment,
    ends_of,
    store_digest,
    store_path,
)
from study.experiment.objective import GOAL_COLUMN
from study.experiment.walker import END_REASON, OUTCOMES, THETA_REF
from taichi_nmm import __version__
from taichi_nmm.parameters import GAIN_NAMES
from taichi_nmm.result import SCORE_FIELDS

EXPERIMENT_NAME = "experiment.json"
ROBOTS_NAME = "robots.json"  # of a comparison on robots before version 0.5
RESULTS_NAME = "trials.parquet"
TIMES_NAME = "proposal_times.parquet"
RUN_NAME = "run.json"
ARMS_NAME = "arms"
DATABASE_NAME = "studies.db"
ARTIFACTS_NAME = "artifacts"

Key = tuple[str, int]  # arm, run: a study of an experiment

MEASURED = "measured"  # the cost that samplers were told, where there is noise
PROPOSAL_TIME = "proposal_s"
NOTES = "notes"

WALKERS_OUTCOMES = {
    **dict.fromkeys(OUTCOMES, pa.float64()),
    END_REASON: pa.string(),
    **{name: pa.from_numpy_dtype(kind) for name, kind in SCORE_FIELDS},
}


def state_schema(document: Mapping[str, Any]) -> pa.Schema:
    """The columns of finished trials, from the document of an experiment.

    Of goals, by name, there is a column each. Then `cost` is the front cost of the
    trial alone, and `best_cost` that of the trials so far.
    """
    if "searched" in document:
        more = [name for name in document["searched"] if name != THETA_REF.name]
        parameters = (*GAIN_NAMES, THETA_REF.name, *more)
        outcomes = WALKERS_OUTCOMES
    else:
        parameters = tuple(document["parameters"])
        outcomes = dict.fromkeys(document["columns"], pa.float64())
    goals = map(GOAL_COLUMN.format, document["objective"].get("goals", ()))
    measured = (MEASURED,) if document["objective"].get("noise") else ()
    columns = {
        "experiment": pa.string(),
        "arm": pa.string(),
        "run": pa.int32(),
        "trial": pa.int32(),
        **dict.fromkeys(parameters, pa.float64()),
        "row": pa.int64(),
        **dict.fromkeys((*goals, "cost", *measured, "best_cost"), pa.float64()),
        WALKED: pa.bool_(),
        **outcomes,
        PROPOSAL_TIME: pa.float64(),
        NOTES: pa.string(),
    }
    return pa.schema(  # of columns without gaps
        pa.field(name, kind, nullable=False) for name, kind in columns.items()
    )


TIME_COLUMNS = ("arm", "run", "trial", PROPOSAL_TIME)


def results_of(table: pa.Table) -> pa.Table:
    """Trials without how they came about: the sampler's notes and its time."""
    return table.select(table.schema.names[:-2])


def walkers(table: pa.Table) -> set[Key]:
    """The studies that have a trial which walked."""
    found = table.filter(table["walked"])
    return set(zip(found["arm"].to_pylist(), found["run"].to_pylist(), strict=True))


def as_if_gone_on(table: pa.Table) -> pa.Table:
    """The table as if studies that ended with a walker had gone on, repeating their last trial.

    Its trials are of an experiment with `until_walker`, without gaps, in any order; it
    has the columns arm, run, trial and walked, and any others.
    """
    ordered = in_order([table])
    arm, run, trial = (ordered[name].to_numpy() for name in ("arm", "run", "trial"))
    last = np.append((run[1:] != run[:-1]) | (arm[1:] != arm[:-1]), len(table) > 0)
    ended = np.flatnonzero(last & ordered["walked"].to_numpy(zero_copy_only=False))
    repeats = np.ones(len(table), dtype=np.int64)
    repeats[ended] += trial.max(initial=0) - trial[ended]
    index = np.repeat(np.arange(len(table)), repeats)
    first = np.repeat(np.cumsum(repeats) - repeats, repeats)
    place = table.schema.get_field_index("trial")
    numbers = pa.array(
        trial[index] + np.arange(len(index)) - first, table.schema.types[place]
    )
    return ordered.take(index).set_column(place, "trial", numbers)


def in_order(tables: list[pa.Table]) -> pa.Table:
    """Tables of one schema as one, sorted by arm, run and trial."""
    keys = [(key, "ascending") for key in ("arm", "run", "trial")]
    return pa.concat_tables(tables).sort_by(keys).combine_chunks()


def without_gaps(table: pa.Table) -> bool:
    """Whether a table of one arm has the trials 0, 1, 2, ... of each run, in their order."""
    run, trial = table["run"].to_numpy(), table["trial"].to_numpy()
    counts = np.unique(run, return_counts=True)[1]
    whole = np.concatenate([np.arange(0), *map(np.arange, counts)])
    return bool((np.diff(run) >= 0).all()) and np.array_equal(trial, whole)


def by_study(table: pa.Table) -> Iterator[tuple[str, int, pa.Table]]:
    """The trials of each study of a table, by arm and run: arm, run, its rows by trial.

    Arrow's `group_by` promises no order.
    """
    ordered = in_order([table])
    keys = list(
        zip(ordered["arm"].to_pylist(), ordered["run"].to_pylist(), strict=True)
    )
    starts = [n for n in range(len(keys)) if n == 0 or keys[n] != keys[n - 1]]
    for start, end in pairwise([*starts, len(keys)]):
        yield *keys[start], ordered.slice(start, end - start)


def table_files(folder: Path) -> list[Path]:
    """The final table of a comparison, if there is one, and the checkpoints of its arms."""
    return [
        *folder.glob(RESULTS_NAME),
        *sorted((folder / ARMS_NAME).glob("[!.]*.parquet")),
    ]


def live_artifacts(url: str, out: Path) -> Path:
    """The folder of pictures of live studies: beside their database's file, or else in `out`.

    Raises:
        InputError: the URL names no study database.
    """
    return (out if is_postgresql(url) else studies_path(url).parent) / ARTIFACTS_NAME


FINGERPRINT_LENGTH = 16
# of a live study: its document; of a comparison's: a name
LIVE_ATTRIBUTE = "experiment"


def document(experiment: Experiment, arms: Iterable[Arm]) -> dict[str, Any]:
    """The identity of an experiment. Runs and trials may grow, so they are no part of it.

    Arms and stores are those of one call; a folder gathers them. The architecture is no
    part of it either: what was begun on one machine may go on on another.
    """
    by_name = sorted(arms, key=lambda arm: arm.name)
    stores = sorted({arm.store for arm in by_name if arm.store})
    return {
        "format": FORMAT,
        "versions": versions(*experiment.packages),
        **experiment.document(),
        "parameters": {name: ends_of(of) for name, of in experiment.space.items()},
        "arms": {arm.name: arm.definition for arm in by_name},
        "stores": {key: store_digest(store_path(experiment, key)) for key in stores},
    }


@cache
def versions(*packages: str) -> dict[str, str]:
    """The versions of this project and of packages that decide results."""
    return {"taichi-nmm": __version__} | {name: version(name) for name in packages}


@lru_cache(maxsize=16)
def fingerprint(experiment: Experiment) -> str:
    """A short digest of all that decides trials but the arms: for databases and file names."""
    return document_hash(document(experiment, ()))[:FINGERPRINT_LENGTH]


def machine() -> dict[str, Any]:
    """The machine that runs the trials."""
    return {
        "system": platform.system(),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
    }


@dataclass(frozen=True)
class ExperimentFolder(Folder):
    """The folder of a comparison; its document says what is compared on what."""

    KIND = "an experiment's"
    FIRST = EXPERIMENT_NAME
    GROWING = ("arms", "stores")

    @classmethod
    @contextmanager
    def claim(
        cls, path: Path, document: dict[str, Any], fresh: bool = False
    ) -> Iterator[Self]:
        """As of any folder; arms and stores may be added to the document."""
        with super().claim(path, document, fresh) as folder:
            with writable(path):
                (path / ARMS_NAME).mkdir(exist_ok=True)
            remove(path / ARMS_NAME, f".*{TEMPORARY_SUFFIX}")
            yield folder

    @classmethod
    def check(cls, path: Path, document: dict[str, Any]) -> Self:
        """As of any folder; the tables of all arms are read as well.

        Raises:
            InputError: as `claim`, of a folder that nobody else holds, and `read_arm`.
        """
        folder = super().check(path, document)
        for name in folder.arms():
            folder.read_arm(name)
        return folder

    @property
    def schema(self) -> pa.Schema:
        """Of its finished trials."""
        return state_schema(self.document)

    def arms(self) -> list[str]:
        """Arms that have finished trials here."""
        return sorted(file.stem for file in (self.path / ARMS_NAME).glob("*.parquet"))

    def read_arm(self, name: str) -> pa.Table:
        """The finished trials of an arm, by run and trial; empty for one that is new.

        Raises:
            InputError: a damaged or edited file, one of another experiment or of
                something else, or one with a gap.
        """
        file, content = f"{ARMS_NAME}/{name}.parquet", f"finished trials of {name}"
        table = self.read_state(file, self.schema, content)
        if set(table["arm"].to_pylist()) - {name}:
            raise InputError(
                "out", str(self.path / file), f"{content}, and of no other arm"
            )
        if not without_gaps(table):
            allowed = "every run's trials in their order, without a gap"
            raise InputError("out", str(self.path / file), allowed)
        return table

    def write_arm(self, name: str, table: pa.Table) -> None:
        """Commit the finished trials of an arm."""
        self.write_state(f"{ARMS_NAME}/{name}.parquet", table)

    def write_results(self) -> pa.Table:
        """Commit the tables of all arms that have trials here, and return the results."""
        state = in_order([self.schema.empty_table(), *map(self.read_arm, self.arms())])
        results = results_of(state)
        write_table(self.path / RESULTS_NAME, results, self.document)
        write_table(self.path / TIMES_NAME, state.select(TIME_COLUMNS), self.document)
        return results

    def note_session(self, session: dict[str, Any]) -> None:
        """Add a session to run.json, or replace the last one if that began at the same time."""
        path = self.path / RUN_NAME
        try:
            sessions = list(
                json_document("out", path, "a list of sessions")["sessions"]
            )
        except (InputError, KeyError, TypeError):  # run.json decides nothing
            sessions = []
        last = sessions[-1] if sessions else None
        if isinstance(last, dict) and last.get("started") == session["started"]:
            sessions.pop()
        commit_json(path, {"sessions": [*sessions, session]})
