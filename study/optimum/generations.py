"""All runs of CMA-ES: a generation of some of them is one batch of the simulator.

A stretch of runs is a unit of work, as in a comparison: it depends on nothing but what it is given.
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from storage.pool import Pool
from study.experiment.experiment import Experiment
from study.experiment.trials import OUTCOMES, costs, finite, simulate_trials, walked
from study.optimum.cmaes_run import CmaesRun
from study.optimum.optimum_folder import EVALUATIONS, OptimumFolder
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES

CHECKPOINT_S = 20.0
BLOCK_RUNS = 10  # with STRETCH_GENERATIONS some 20 s of work; results depend on neither
STRETCH_GENERATIONS = 5


@dataclass(frozen=True)
class CmaesProgress:
    """How far CMA-ES is.

    Attributes:
        generation: the latest of any run, counted from 1.
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


@dataclass(frozen=True)
class Stretch:
    """Some runs, as far as they are, and how far they shall go.

    Attributes:
        experiment: of the runs.
        runs: their numbers.
        known: what they have tried, `EVALUATIONS`.
        generations: that each is to have, unless it stops before.
        where: their folder, for messages.
    """

    experiment: Experiment
    runs: tuple[int, ...]
    known: pa.Table
    generations: int
    where: str


@dataclass(frozen=True)
class Evolved:
    """What has come of a stretch.

    Attributes:
        tried: what its runs have tried beyond what was known, `EVALUATIONS`.
        stops: why runs have ended, by number; those that go on are not in it.
    """

    tried: pa.Table
    stops: dict[int, str]

    @property
    def generations(self) -> list[int]:
        """Generations of the points tried, from 0."""
        numbers: list[int] = self.tried["generation"].to_pylist()
        return numbers


def evolve(stretch: Stretch) -> Evolved:
    """Take the runs of a stretch on.

    Raises:
        InputError: what is known is not what these runs try, or what the simulator refuses.
    """
    experiment = stretch.experiment
    runs = {run: CmaesRun(experiment.cmaes, experiment.seed, run) for run in stretch.runs}
    for run, strategy in runs.items():
        known = stretch.known.filter(pc.equal(stretch.known["run"], run))
        _replay(strategy, known, f"run {run} in {stretch.where}")
    tables = [EVALUATIONS.empty_table()]
    last = min(stretch.generations, experiment.cmaes.max_generations)
    while going := {r: s for r, s in runs.items() if not s.stopped(last)}:
        tables.append(_generation(experiment, going))
    found = {run: s.stopped(experiment.cmaes.max_generations) for run, s in runs.items()}
    stops = {run: reason for run, reason in found.items() if reason}
    return Evolved(pa.concat_tables(tables), stops)


def run_cmaes(
    experiment: Experiment,
    runs: int,
    folder: OptimumFolder,
    pool: Pool,
    report: Callable[[CmaesProgress], None],
) -> tuple[pa.Table, list[str]]:
    """Go on until every run has stopped.

    Args:
        experiment: of the runs.
        runs: how many.
        folder: where evaluations are kept.
        pool: that does the work.
        report: called whenever a stretch of generations is finished.

    Returns:
        The evaluations by run, generation, member; and why each run has ended.

    Raises:
        InputError: as `evolve`, or a folder that is full.
        KeyboardInterrupt: finished stretches are kept.
    """
    experiment = experiment.on_one_thread() if pool.shares_machine else experiment
    size = min(BLOCK_RUNS, -(-runs // pool.slots))
    tried = folder.read_evaluations()
    parts = [tuple(range(first, min(first + size, runs))) for first in range(0, runs, size)]
    stops: dict[int, str] = {}
    generation = 0

    def next_stretch(part: tuple[int, ...]) -> Stretch:
        known = tried.filter(pc.is_in(tried["run"], pa.array(part, pa.int32())))
        latest = known.group_by("run").aggregate([("generation", "max")])
        done = dict(zip(*(column.to_pylist() for column in latest.columns), strict=True))
        least = min(done.get(run, -1) + 1 for run in part if run not in stops)
        return Stretch(experiment, part, known, least + STRETCH_GENERATIONS, str(folder.path))

    units = deque(map(next_stretch, parts))
    committed, committed_s = len(tried), time.monotonic()
    try:
        for stretch, evolved in pool.results(evolve, units):
            order = [(name, "ascending") for name in ("run", "generation", "member")]
            tried = pa.concat_tables([tried, evolved.tried]).sort_by(order).combine_chunks()
            stops |= evolved.stops
            if not all(run in stops for run in stretch.runs):
                units.append(next_stretch(stretch.runs))
            generation = max(
                [generation, *(1 + g for g in evolved.tried["generation"].to_pylist())]
            )
            best = float(np.min(tried["cost"].to_numpy(), initial=np.inf))
            report(CmaesProgress(generation, runs - len(stops), runs, len(tried), best))
            if time.monotonic() - committed_s >= CHECKPOINT_S and len(tried) > committed:
                folder.write_evaluations(tried)
                committed, committed_s = len(tried), time.monotonic()
    finally:
        if len(tried) > committed:
            folder.write_evaluations(tried)
    return tried, [stops[run] for run in range(runs)]


def _generation(experiment: Experiment, going: dict[int, CmaesRun]) -> pa.Table:
    """One generation of each run: ask all, simulate once, tell all."""
    asked = [run.ask() for run in going.values()]
    sizes = [len(points) for points in asked]
    gains, run_of = np.vstack(asked), np.repeat(list(going), sizes)
    rows = finite(simulate_trials(experiment, run_of, gains).rows)
    cost = costs(rows, experiment.cost)
    arrays = {
        "run": run_of,
        "generation": np.repeat([run.generation for run in going.values()], sizes),
        "member": np.concatenate([np.arange(size) for size in sizes]),
        **dict(zip(GAIN_NAMES, gains.T, strict=True)),
        "cost": cost,
        "walked": walked(rows),
        **{name: rows[name] for name in OUTCOMES},
    }
    columns = [pa.array(np.ascontiguousarray(arrays[each.name]), each.type) for each in EVALUATIONS]
    for run, told in zip(going.values(), np.split(cost, np.cumsum(sizes)[:-1]), strict=True):
        run.tell(told)
    return pa.Table.from_arrays(columns, schema=EVALUATIONS)


def _replay(strategy: CmaesRun, known: pa.Table, where: str) -> None:
    """Tell a run what it was told before: a millisecond a generation."""
    gains = np.column_stack([known[name].to_numpy() for name in GAIN_NAMES])
    cost = known["cost"].to_numpy()
    for first in range(0, len(cost), strategy.population):
        points = slice(first, first + strategy.population)
        if not np.array_equal(strategy.ask(), gains[points]):
            allowed = "evaluations of these settings and this version of pycma"
            raise InputError("out", where, allowed)
        strategy.tell(cost[points])
