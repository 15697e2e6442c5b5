"""The folder of an experiment, and its tables. The folder is the state of a comparison.

experiment.json         written first: what is compared on what, with which stores and versions
arms/NAME.parquet       all finished trials of an arm, rewritten whole at each checkpoint
trials.parquet          written last: all arms
proposal_times.parquet  written last: what the samplers took, which no two runs agree upon
run.json                when, on what machine, and how long
studies.db              the study database, where no other is asked for
artifacts/              pictures and films of each study's best trial
.lock                   held by the one process that writes

The tables of arms have two columns more than the results: the seconds that the sampler took, and
what it noted in the trial, from which a stopped study is set up again.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage.commit import TEMPORARY_SUFFIX, commit_json, writable
from storage.databases.studies import studies_path
from storage.databases.urls import is_postgresql
from storage.document import agree, agreed
from storage.folder import claimed, remove, require_claimable
from storage.tables import read_stamped, write_stamped, write_table
from study.experiment.experiment import Experiment
from study.experiment.identity import GROWING
from study.experiment.trials import KEPT, OUTCOMES, walked
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, LOW_LEVEL_GAINS
from taichi_nmm.reading import json_document
from taichi_nmm.result import END_REASONS, RESULT_DTYPE, SCORE_FIELDS

EXPERIMENT_NAME = "experiment.json"
RESULTS_NAME = "trials.parquet"
TIMES_NAME = "proposal_times.parquet"
RUN_NAME = "run.json"
ARMS_NAME = "arms"
DATABASE_NAME = "studies.db"
ARTIFACTS_NAME = "artifacts"
KIND = "an experiment's"  # folder, for messages

Document = dict[str, Any]
Floats = NDArray[np.float64]
Key = tuple[str, int]  # arm, run: a study of an experiment

THETA_REF = next(parameter for parameter in LOW_LEVEL_GAINS if parameter.name == "theta_ref")
PROPOSAL_TIME = "proposal_s"
NOTES = "notes"
ARROW_TYPES = {"f8": pa.float64(), "i4": pa.int32()}

_COLUMNS: tuple[tuple[str, pa.DataType], ...] = (
    ("experiment", pa.string()),
    ("arm", pa.string()),
    ("run", pa.int32()),
    ("trial", pa.int32()),
    *((name, pa.float64()) for name in GAIN_NAMES),
    (THETA_REF.name, pa.float64()),
    ("row", pa.int64()),
    ("cost", pa.float64()),
    ("best_cost", pa.float64()),
    ("walked", pa.bool_()),
    *((name, pa.float64()) for name in OUTCOMES),
    ("end_reason", pa.string()),
    *((name, ARROW_TYPES[kind]) for name, kind in SCORE_FIELDS),
)


def _schema(columns: tuple[tuple[str, pa.DataType], ...]) -> pa.Schema:
    return pa.schema([pa.field(name, kind, nullable=False) for name, kind in columns])


RESULT_SCHEMA = _schema(_COLUMNS)
STATE_SCHEMA = _schema((*_COLUMNS, (PROPOSAL_TIME, pa.float64()), (NOTES, pa.string())))
TIME_COLUMNS = ("arm", "run", "trial", PROPOSAL_TIME)


def state_table(experiment: Experiment, columns: dict[str, Any], gains: Floats) -> pa.Table:
    """Finished trials as a table of `STATE_SCHEMA`.

    Args:
        experiment: of the trials.
        columns: arm, run, trial, row, cost, best_cost, proposal_s, notes (dictionaries), each [n],
            and rows: what the simulator returned, [n].
        gains: the searched parameters, [n, 16 + k].
    """
    rows: NDArray[np.void] = columns["rows"]
    arrays: dict[str, Any] = {name: values for name, values in columns.items() if name != "rows"}
    arrays["experiment"] = [experiment.name] * len(gains)
    arrays[THETA_REF.name] = np.full(len(gains), THETA_REF.default)
    arrays |= dict(zip(experiment.names, gains.T, strict=True))
    arrays |= {name: rows[name] for name in KEPT}
    arrays["end_reason"] = np.array(END_REASONS)[rows["end_reason"]]
    arrays["walked"] = walked(rows)
    arrays[NOTES] = [json.dumps(notes) for notes in columns[NOTES]]
    made = [pa.array(_contiguous(arrays[field.name]), field.type) for field in STATE_SCHEMA]
    return pa.Table.from_arrays(made, schema=STATE_SCHEMA)


def walkers(table: pa.Table) -> set[Key]:
    """The studies that have a trial which walked."""
    found = table.filter(table["walked"])
    return set(zip(found["arm"].to_pylist(), found["run"].to_pylist(), strict=True))


def as_if_gone_on(table: pa.Table) -> pa.Table:
    """Studies that ended with a walker, its trial again in place of those that others needed.

    Args:
        table: trials of an experiment with `until_walker`, of any columns with arm, run, trial and
            walked, without gaps; in any order.
    """
    ordered = table.sort_by([("arm", "ascending"), ("run", "ascending"), ("trial", "ascending")])
    arm, run, trial = (ordered[name].to_numpy() for name in ("arm", "run", "trial"))
    last = np.append((run[1:] != run[:-1]) | (arm[1:] != arm[:-1]), len(table) > 0)
    ended = np.flatnonzero(last & ordered["walked"].to_numpy(zero_copy_only=False))
    most = int(trial.max()) + 1 if len(trial) else 0
    repeats = np.ones(len(table), dtype=np.int64)
    repeats[ended] += most - 1 - trial[ended]
    index = np.repeat(np.arange(len(table)), repeats)
    first = np.repeat(np.cumsum(repeats) - repeats, repeats)
    longer = ordered.take(index)
    numbers = pa.array(
        trial[index] + np.arange(len(index)) - first, longer.schema.field("trial").type
    )
    return longer.set_column(longer.schema.get_field_index("trial"), "trial", numbers)


def _contiguous(values: Any) -> Any:
    return values if isinstance(values, list) else np.ascontiguousarray(values)


def in_order(tables: list[pa.Table], keys: tuple[str, ...] = ("arm", "run", "trial")) -> pa.Table:
    """Tables of one schema as one, sorted."""
    joined = pa.concat_tables(tables)
    order = joined.sort_by([(key, "ascending") for key in keys])
    return order.combine_chunks()


def gains_of(experiment: Experiment, table: pa.Table) -> Floats:
    """The searched parameters of a table's trials, [n, 16 + k]."""
    columns = [table[name].to_numpy() for name in experiment.names]
    return np.column_stack(columns).astype(np.float64)


def outcomes_of(table: pa.Table) -> NDArray[np.void]:
    """What a table says of the simulator's result rows, in their form, [n]; the rest is zero."""
    rows = np.zeros(len(table), RESULT_DTYPE)
    for name in KEPT:
        rows[name] = table[name].to_numpy()
    reasons = {reason: number for number, reason in enumerate(END_REASONS)}
    rows["end_reason"] = [reasons[reason] for reason in table["end_reason"].to_pylist()]
    return rows


def by_study(table: pa.Table) -> Iterator[tuple[str, int, pa.Table]]:
    """The trials of each study of a table, by arm and run: arm, run, its rows by trial.

    Where studies begin is looked up in the sorted rows: Arrow's `group_by` promises no order.
    """
    ordered = in_order([table])
    arms, runs = ordered["arm"].to_pylist(), ordered["run"].to_pylist()
    keys = list(zip(arms, runs, strict=True))
    starts = [n for n in range(len(keys)) if n == 0 or keys[n] != keys[n - 1]]
    for start, end in pairwise([*starts, len(keys)]):
        yield *keys[start], ordered.slice(start, end - start)


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
