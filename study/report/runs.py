"""The runs of a comparison's arms as arrays: of its folder, finished or not, or of a table."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from study.comparison.folder import (
    RESULTS_NAME,
    TIMES_NAME,
    as_if_gone_on,
)
from study.report.documents import read_facts
from study.report.files import read_trials, table_files
from taichi_nmm.errors import InputError

COLUMNS = ("experiment", "arm", "run", "trial", "cost", "best_cost", "walked")
LARGEST_SMOOTH_COST = 20.0  # the smooth cost is below 1.4 unless a walker races; a fall is 300


@dataclass(frozen=True, eq=False)
class ArmRuns:
    """The runs of one arm, as far as all of them have come: r runs of t trials.

    Attributes:
        arm: its name.
        runs: their numbers, ascending, [r].
        best: the best cost so far, [r, t].
        walks: whether a trial walked, bool [r, t].
        found: trials in the table.
        repeated: trials in the arrays that stand for those after a run's end with its first walker.
        proposal_ms: median time that the sampler took for a trial; None where it is not known.
    """

    arm: str
    runs: NDArray[np.int64]
    best: NDArray[np.float64]
    walks: NDArray[np.bool_]
    found: int
    proposal_ms: float | None = None
    repeated: int = 0

    @property
    def trials(self) -> int:
        """Trials that every run has, t."""
        return int(self.best.shape[1])

    @cached_property
    def first_walker(self) -> NDArray[np.float64]:
        """The trial that was the first to walk, counted from 1; infinite where none did, [r]."""
        any_walks = self.walks.any(axis=1)
        return np.where(any_walks, self.walks.argmax(axis=1) + 1.0, np.inf)

    @cached_property
    def has_walker(self) -> NDArray[np.bool_]:
        """Whether a run has a walker after so many trials, [r, t]."""
        return np.asarray(np.logical_or.accumulate(self.walks, axis=1))

    @property
    def walkers(self) -> int:
        """Runs with a walker."""
        return int(self.has_walker[:, -1].sum())


@dataclass(frozen=True, eq=False)
class Results:
    """One experiment.

    Attributes:
        folder: where it lies.
        name: of the experiment.
        cost: "smooth" or "walking".
        arms: by name, in the order of the table.
        facts: of experiment.json and run.json; empty where there are none.
    """

    folder: Path
    name: str
    cost: str
    arms: dict[str, ArmRuns]
    facts: dict[str, Any]

    @property
    def runs(self) -> int:
        """The most runs that an arm has."""
        return max(len(arm.runs) for arm in self.arms.values())

    @property
    def trials(self) -> int:
        """The most trials that all runs of an arm have."""
        return max(arm.trials for arm in self.arms.values())

    @property
    def found(self) -> int:
        """Trials in the table."""
        return sum(arm.found for arm in self.arms.values())

    @property
    def planned(self) -> int:
        """Trials that the table would have if every arm had as many runs and trials as the most.

        Runs that ended with their first walker lack none.
        """
        repeated = sum(arm.repeated for arm in self.arms.values())
        return len(self.arms) * self.runs * self.trials - repeated

    @property
    def complete(self) -> bool:
        """Whether no arm lags behind another."""
        return self.found == self.planned


def read_results(folder: str | Path) -> Results:
    """Read the folder of a comparison, finished or not.

    Of each arm the table or its checkpoint counts, whichever has more trials.

    Raises:
        InputError: no such folder, no trials in it, a table or document that cannot be read or has
            something else in it than a report can be made of.
    """
    folder = Path(folder)
    arms: dict[str, pa.Table] = {}
    for path in table_files(folder):
        for arm, rows in _by_arm(read_trials(path, COLUMNS)).items():
            if arm not in arms or len(arms[arm]) < len(rows):
                arms[arm] = rows
    if not arms:
        allowed = f"the output of taichi-nmm compare: {RESULTS_NAME}, with trials"
        raise InputError("folder", str(folder), allowed)
    times = _proposal_times(folder)
    facts = read_facts(folder)
    found = {arm: len(rows) for arm, rows in arms.items()}
    if facts.get("until_walker"):
        arms = _by_arm(as_if_gone_on(pa.concat_tables(arms.values())))
    runs = {
        arm: _arm_runs(str(folder), arm, rows, times.get(arm), found[arm])
        for arm, rows in arms.items()
    }
    first = next(iter(arms.values()))
    return Results(folder, first["experiment"][0].as_py(), _cost(facts, runs), runs, facts)


def runs_of(trials: pa.Table) -> dict[str, ArmRuns]:
    """The runs of each arm of a table in memory, in the order of the arms' names.

    Args:
        trials: as `trials.parquet` has them, in any order.

    Raises:
        InputError: a run lacks a trial between others, or has one twice.
    """
    arms = _by_arm(trials.select(COLUMNS))
    return {arm: _arm_runs("trials", arm, rows, None, len(rows)) for arm, rows in arms.items()}


def _by_arm(table: pa.Table) -> dict[str, pa.Table]:
    """The rows of each arm, in the order of the runs and trials."""
    ordered = table.sort_by([("arm", "ascending"), ("run", "ascending"), ("trial", "ascending")])
    arms, starts = np.unique(ordered["arm"].to_numpy(), return_index=True)
    ends = np.append(starts, len(ordered))[1:]
    return {
        str(arm): ordered.slice(start, end - start)
        for arm, start, end in zip(arms, starts, ends, strict=True)
    }


def _arm_runs(
    source: str, arm: str, table: pa.Table, proposal_ms: float | None, found: int
) -> ArmRuns:
    """Arrays of a table of which `found` trials were made, the others repeated."""
    runs, counts = np.unique(table["run"].to_numpy(), return_counts=True)
    trial = table["trial"].to_numpy()
    if not np.array_equal(trial, np.concatenate([np.arange(count) for count in counts])):
        raise InputError(source, f"arm {arm}", "trials 0, 1, 2, ... of each run, each once")
    shared = trial < counts.min()

    def square(name: str) -> NDArray[Any]:
        return np.asarray(table[name].to_numpy()[shared].reshape(len(runs), -1))

    return ArmRuns(
        arm=arm,
        runs=runs.astype(np.int64),
        best=square("best_cost"),
        walks=square("walked").astype(bool),
        found=found,
        proposal_ms=proposal_ms,
        repeated=len(table) - found,
    )


def _proposal_times(folder: Path) -> dict[str, float]:
    """Median milliseconds of each arm, where the folder has them."""
    path = folder / TIMES_NAME
    if not path.exists():
        return {}
    table = read_trials(path, ("arm", "proposal_s"))
    arm, seconds = table["arm"].to_numpy(), table["proposal_s"].to_numpy()
    return {str(name): 1e3 * float(np.median(seconds[arm == name])) for name in np.unique(arm)}


def _cost(facts: Mapping[str, Any], arms: Mapping[str, ArmRuns]) -> str:
    """The cost's name, as configured; where that is not known, as its size tells."""
    largest = max(float(arm.best[:, 0].max()) for arm in arms.values())
    as_its_size_tells = "smooth" if largest < LARGEST_SMOOTH_COST else "walking"
    return str(facts.get("objective", {}).get("cost", as_its_size_tells))
