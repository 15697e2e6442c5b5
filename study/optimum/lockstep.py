"""All runs of CMA-ES side by side: a generation of every run is one batch of the simulator."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from study.comparison.outcome import costs, finite, walked
from study.comparison.results import OUTCOMES
from study.comparison.simulation import simulate_trials
from study.optimum.config import OptimumConfig
from study.optimum.folder import EVALUATIONS, OptimumFolder
from study.optimum.search import Search
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES

Floats = NDArray[np.float64]

CHECKPOINT_S = 30.0


@dataclass(frozen=True)
class Progress:
    """How far CMA-ES is.

    Attributes:
        generation: that was simulated last, counted from 1.
        running: runs that go on.
        runs: of all.
        evaluations: of all runs so far.
        best_cost: of all runs so far.
    """

    generation: int
    running: int
    runs: int
    evaluations: int
    best_cost: float


class CmaesRuns:
    """The runs, as far as the folder has them, and onward.

    Args:
        config: of the estimate.
        runs: how many.
        folder: where evaluations go.

    Raises:
        InputError: what the folder has is not what these runs would have tried.
    """

    def __init__(self, config: OptimumConfig, runs: int, folder: OptimumFolder) -> None:
        """Replay what is there: a millisecond a generation."""
        self._config = config
        self._folder = folder
        self._tables = [folder.read_evaluations()]
        seed = config.experiment.seed
        self.searches = [Search(config.cmaes, seed, run) for run in range(runs)]
        self._written = len(self._tables[0])
        self._replay(self._tables[0])

    def run(self, report: Callable[[Progress], None]) -> pa.Table:
        """Go on until every run has stopped; the evaluations, by run, generation, member.

        Raises:
            InputError: what the simulator refuses, or a folder that is full.
            KeyboardInterrupt: finished generations are kept.
        """
        written_s = time.monotonic()
        try:
            while running := self._running():
                self._generation(running)
                report(self._progress())
                if time.monotonic() - written_s >= CHECKPOINT_S:
                    self.checkpoint()
                    written_s = time.monotonic()
        finally:
            self.checkpoint()
        return self._tables[0]

    def checkpoint(self) -> None:
        """Commit what is new."""
        order = [(name, "ascending") for name in ("run", "generation", "member")]
        table = pa.concat_tables(self._tables).sort_by(order).combine_chunks()
        self._tables = [table]
        if len(table) > self._written:
            self._folder.write_evaluations(table)
            self._written = len(table)

    def stops(self) -> list[str]:
        """Why each run has ended."""
        return [search.stopped(self._config.cmaes.max_generations) for search in self.searches]

    def _running(self) -> list[int]:
        return [run for run, stop in enumerate(self.stops()) if not stop]

    def _generation(self, running: list[int]) -> None:
        """One generation of each run: ask all, simulate once, tell all."""
        asked = [self.searches[run].ask() for run in running]
        sizes = [len(points) for points in asked]
        gains, run_of = np.vstack(asked), np.repeat(running, sizes)
        experiment = self._config.experiment
        rows = finite(simulate_trials(experiment, run_of, gains).rows)
        cost = costs(rows, experiment.cost)
        number = np.repeat([self.searches[run].generation for run in running], sizes)
        arrays = {
            "run": run_of,
            "generation": number,
            "member": np.concatenate([np.arange(size) for size in sizes]),
            **dict(zip(GAIN_NAMES, gains.T, strict=True)),
            "cost": cost,
            "walked": walked(rows),
            **{name: rows[name] for name in OUTCOMES},
        }
        columns = [
            pa.array(np.ascontiguousarray(arrays[each.name]), each.type) for each in EVALUATIONS
        ]
        self._tables.append(pa.Table.from_arrays(columns, schema=EVALUATIONS))
        ends = np.cumsum(sizes)[:-1]
        for run, told in zip(running, np.split(cost, ends), strict=True):
            self.searches[run].tell(told)

    def _replay(self, table: pa.Table) -> None:
        """Tell the runs what they were told before."""
        run, cost = table["run"].to_numpy(), table["cost"].to_numpy()
        gains = np.column_stack([table[name].to_numpy() for name in GAIN_NAMES])
        for number, search in enumerate(self.searches):
            own = np.flatnonzero(run == number)
            for first in range(0, len(own), search.population):
                points = own[first : first + search.population]
                if not np.array_equal(search.ask(), gains[points]):
                    allowed = "evaluations of these settings and this version of pycma"
                    raise InputError("out", f"run {number} in {self._folder.path}", allowed)
                search.tell(cost[points])

    def _progress(self) -> Progress:
        count = sum(len(table) for table in self._tables)
        best = min(float(table["cost"].to_numpy().min()) for table in self._tables if len(table))
        generation = max(search.generation for search in self.searches)
        return Progress(generation, len(self._running()), len(self.searches), count, best)
