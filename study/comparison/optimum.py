"""The optimum of a cost, as the paper estimates it: the best of many runs on level ground.

Each run of CMA-ES goes on until it has converged; a generation of several runs is one batch of the
simulator. The paper's sampler has a comparison beside them. The folder is the state:

search.json           written first: what is estimated, with which versions
evaluations.parquet   every point that CMA-ES tried, rewritten whole at each checkpoint
dog/                  the comparison's folder of the paper's sampler
runs.parquet          written at the end: the best of every run of both
optimum.json          written last: the best of all
.lock                 held by the one process that writes
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from storage.commit import commit_json
from storage.document import agree
from storage.folder import claimed
from storage.pool import Cluster, Pool
from storage.tables import read_stamped, write_stamped, write_table
from study.comparison.compare import Progress, Request, compare, opened_pool, work_through
from study.comparison.folder import in_order
from study.draws import Purpose, generator
from study.experiment.arms import PAPER_ARM, check_arms
from study.experiment.experiment import CmaesOptions, Experiment
from study.experiment.identity import GROWING, document, machine
from study.experiment.samplers import CmaEs
from study.experiment.trials import OUTCOMES, costs, finite, simulate_trials, walked
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, GAINS, lower_bounds, upper_bounds

METHODS = ("cmaes", "dog")
TRIALS_DONE = "all trials"
CUT = "max_generations"
BLOCK_RUNS = 10  # with STRETCH_GENERATIONS some 20 s of work; results depend on neither
STRETCH_GENERATIONS = 5

SEARCH_NAME = "search.json"
EVALUATIONS_NAME = "evaluations.parquet"
DOG_NAME = "dog"
RUNS_NAME = "runs.parquet"
OPTIMUM_NAME = "optimum.json"

_TRIED = [
    *((name, pa.float64()) for name in (*GAIN_NAMES, "cost")),
    ("walked", pa.bool_()),
    *((name, pa.float64()) for name in OUTCOMES),
]


def _schema(*first: tuple[str, pa.DataType]) -> pa.Schema:
    columns = [*first, *_TRIED]
    return pa.schema([pa.field(name, kind, nullable=False) for name, kind in columns])


EVALUATIONS = _schema(("run", pa.int32()), ("generation", pa.int32()), ("member", pa.int32()))
RUNS = _schema(
    ("method", pa.string()), ("run", pa.int32()), ("evaluations", pa.int64()), ("stop", pa.string())
)


Document = dict[str, Any]
Floats = NDArray[np.float64]


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
    """A unit of work: some runs, as far as they are, and how far they shall go.

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


def estimate(
    experiment: Experiment,
    out: Path,
    runs: int | None,
    workers: int,
    report_dog: Callable[[Progress], None],
    report_cmaes: Callable[[CmaesProgress], None],
    cluster: Cluster | None = None,
) -> Document:
    """Run both methods, or what is missing of them, and write the result.

    Args:
        experiment: level ground and the undisturbed body; its seed is also that of CMA-ES.
        out: folder of the estimate.
        runs: of each method; None is what the configuration says. A later call may ask for more.
        workers: processes of this machine.
        report_dog: called with the progress of the sampler's trials.
        report_cmaes: called with the progress of the generations.
        cluster: that works in place of the processes.

    Returns:
        The document of optimum.json.

    Raises:
        InputError: another ground or body, a folder of something else, and see `check_arms`,
            `compare` and `evolve`.
        KeyboardInterrupt: what is finished is kept.
    """
    _require_easiest(experiment)
    count = experiment.runs if runs is None else runs
    for name, value in (("runs", count), ("workers", workers)):
        if value < 1:
            raise InputError(name, value, "1 or more")
    arms = check_arms(experiment, (PAPER_ARM,), experiment.trials)
    began_s = time.monotonic()
    request = Request(out, workers=workers, cluster=cluster)
    own = _document(experiment)
    with (
        opened_pool(experiment, arms, request) as pool,
        claimed(out, SEARCH_NAME, "one of this command"),
    ):
        agree(out / SEARCH_NAME, own, growing=GROWING, remedy="another --out")
        pool.agree(out)
        read_evaluations(out, own)  # refused, if at all, before the work
        request = Request(out / DOG_NAME, arms=(PAPER_ARM,), runs=count, artifacts=False)
        dog = compare(experiment, request, report_dog, pool=pool).trials
        tried, stops = run_cmaes(experiment, count, out, pool, report_cmaes)
        best = [
            _best_of_runs("cmaes", tried, stops),
            _best_of_runs("dog", dog, [TRIALS_DONE] * count),
        ]
        table = pa.concat_tables(best)
        write_table(out / RUNS_NAME, table, own)
        found = result(experiment, table) | {
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "wall_s": round(time.monotonic() - began_s, 1),  # of the session that ended it
            "machine": machine(),
        }
        commit_json(out / OPTIMUM_NAME, found)
        return found


def _require_easiest(experiment: Experiment) -> None:
    """Refuse what is not the paper's easiest setting, of which runs are repetitions."""
    conditions = experiment.conditions
    if conditions.ground.kind != "flat":
        raise InputError("terrain.kind", conditions.ground.kind, "flat, for the optimum's estimate")
    if conditions.disturbance:
        allowed = "0, for the optimum's estimate"
        raise InputError("body.disturbance", conditions.disturbance, allowed)
    if experiment.searched:
        raise InputError("searched", list(experiment.searched), "none, for the optimum's estimate")


def _document(experiment: Experiment) -> Document:
    """What decides the result of CMA-ES; the number of runs and of generations may grow."""
    cmaes = asdict(experiment.cmaes)
    cmaes.pop("max_generations")
    return document(experiment, ()) | {"cmaes": cmaes}


def read_evaluations(folder: Path, own: Document) -> pa.Table:
    """What CMA-ES has tried, by run, generation and member.

    Args:
        folder: of the estimate.
        own: its document.

    Raises:
        InputError: a damaged or edited file, or one of something else.
    """
    path = folder / EVALUATIONS_NAME
    if not path.exists():
        return EVALUATIONS.empty_table()
    table = read_stamped(path, own, GROWING)
    if not table.schema.equals(EVALUATIONS):
        raise InputError("out", str(path), "points that CMA-ES tried, in this version's form")
    return table


def run_cmaes(
    experiment: Experiment,
    runs: int,
    folder: Path,
    pool: Pool,
    report: Callable[[CmaesProgress], None],
) -> tuple[pa.Table, list[str]]:
    """Go on until every run has stopped.

    Args:
        experiment: of the runs.
        runs: how many.
        folder: of the estimate, held by this process.
        pool: that does the work.
        report: called whenever a stretch of generations is finished.

    Returns:
        The evaluations by run, generation, member; and why each run has ended.

    Raises:
        InputError: as `evolve`, or a folder that is full.
        KeyboardInterrupt: finished stretches are kept.
    """
    own = _document(experiment)
    experiment = experiment.on_one_thread() if pool.shares_machine else experiment
    size = min(BLOCK_RUNS, -(-runs // pool.slots))
    tried = read_evaluations(folder, own)
    committed, generation = len(tried), 0
    stops: dict[int, str] = {}

    def next_stretch(part: tuple[int, ...]) -> Stretch:
        known = tried.filter(pc.is_in(tried["run"], pa.array(part, pa.int32())))
        latest = known.group_by("run").aggregate([("generation", "max")])
        done = dict(zip(*(column.to_pylist() for column in latest.columns), strict=True))
        least = min(done.get(run, -1) + 1 for run in part if run not in stops)
        return Stretch(experiment, part, known, least + STRETCH_GENERATIONS, str(folder))

    def take(stretch: Stretch, evolved: Evolved) -> Iterator[Stretch]:
        nonlocal tried, generation, stops
        tried = in_order([tried, evolved.tried], ("run", "generation", "member"))
        stops |= evolved.stops
        if not all(run in stops for run in stretch.runs):
            yield next_stretch(stretch.runs)
        new = evolved.tried["generation"].to_pylist()
        generation = max([generation, *(1 + number for number in new)])
        best = float(np.min(tried["cost"].to_numpy(), initial=np.inf))
        report(CmaesProgress(generation, runs - len(stops), runs, len(tried), best))

    def commit(_goes_on: bool) -> None:
        nonlocal committed
        if len(tried) > committed:
            write_stamped(folder / EVALUATIONS_NAME, tried, own)
            committed = len(tried)

    parts = [tuple(range(first, min(first + size, runs))) for first in range(0, runs, size)]
    work_through(pool, evolve, map(next_stretch, parts), take, commit)
    return tried, [stops[run] for run in range(runs)]


def evolve(stretch: Stretch) -> Evolved:
    """Take the runs of a stretch on.

    Raises:
        InputError: what is known is not what these runs try, or what the simulator refuses.
    """
    experiment = stretch.experiment
    most = experiment.cmaes.max_generations
    runs = {run: new_run(experiment.cmaes, experiment.seed, run) for run in stretch.runs}
    for run, search in runs.items():
        known = stretch.known.filter(pc.equal(stretch.known["run"], run))
        _replay(search, known, f"run {run} in {stretch.where}")
    tables = [EVALUATIONS.empty_table()]
    last = min(stretch.generations, most)
    while going := {run: search for run, search in runs.items() if not ended(search, last)}:
        tables.append(_generation(experiment, going))
    stops = {run: reason for run, search in runs.items() if (reason := ended(search, most))}
    return Evolved(pa.concat_tables(tables), stops)


def new_run(options: CmaesOptions, seed: int, run: int) -> CmaEs:
    """A run of CMA-ES from a random point; it depends on the arguments and on nothing else."""
    start = generator(seed, Purpose.CMAES_MEAN, run).random(len(GAINS))
    more = {"popsize": options.population} if options.population else {}
    draws = generator(seed, Purpose.CMAES, run)
    return CmaEs(start, options.sigma, draws, tolfun=options.tolerance, **more)


def ended(search: CmaEs, max_generations: int) -> str:
    """Why a run has ended: pycma's criteria, or the limit; "" while it goes on."""
    return search.stopped or (CUT if search.generation >= max_generations else "")


def asked_gains(search: CmaEs) -> Floats:
    """The gains of a run's generation, [population, 16]."""
    low, high = lower_bounds(), upper_bounds()
    return np.asarray(np.clip(low + (high - low) * search.ask(), low, high))


def _generation(experiment: Experiment, going: dict[int, CmaEs]) -> pa.Table:
    """One generation of each run: ask all, simulate once, tell all."""
    asked = [asked_gains(search) for search in going.values()]
    sizes = [len(points) for points in asked]
    gains, run_of = np.vstack(asked), np.repeat(list(going), sizes)
    rows = finite(simulate_trials(experiment, run_of, gains).rows)
    cost = costs(rows, experiment.cost)
    arrays = {
        "run": run_of,
        "generation": np.repeat([search.generation for search in going.values()], sizes),
        "member": np.concatenate([np.arange(size) for size in sizes]),
        **dict(zip(GAIN_NAMES, gains.T, strict=True)),
        "cost": cost,
        "walked": walked(rows),
        **{name: rows[name] for name in OUTCOMES},
    }
    columns = [pa.array(np.ascontiguousarray(arrays[each.name]), each.type) for each in EVALUATIONS]
    for search, told in zip(going.values(), np.split(cost, np.cumsum(sizes)[:-1]), strict=True):
        search.tell(told.tolist())
    return pa.Table.from_arrays(columns, schema=EVALUATIONS)


def _replay(search: CmaEs, known: pa.Table, where: str) -> None:
    """Tell a run what it was told before: a millisecond a generation."""
    gains = np.column_stack([known[name].to_numpy() for name in GAIN_NAMES])
    cost = known["cost"].to_numpy()
    for first in range(0, len(cost), search.population):
        points = slice(first, first + search.population)
        if not np.array_equal(asked_gains(search), gains[points]):
            allowed = "evaluations of these settings and this version of pycma"
            raise InputError("out", where, allowed)
        search.tell(cost[points].tolist())


def result(experiment: Experiment, runs: pa.Table) -> dict[str, Any]:
    """The best of all, and how each method's runs are distributed."""
    best = runs.slice(int(np.argmin(runs["cost"].to_numpy())), 1).to_pylist()[0]
    return {
        "cost": experiment.cost,
        "best_cost": best["cost"],
        "method": best["method"],
        "run": best["run"],
        "gains": {name: best[name] for name in GAIN_NAMES},
        "outcome": {
            name: value
            for name, value in best.items()
            if name not in (*GAIN_NAMES, "method", "run", "cost", "evaluations", "stop")
        },
        "methods": {method: _distribution(runs, method) for method in METHODS},
        "config": _document(experiment)
        | {
            "dog": {"trials": experiment.trials},
            "max_generations": experiment.cmaes.max_generations,
        },
    }


def _best_of_runs(method: str, tried: pa.Table, stops: list[str]) -> pa.Table:
    """The cheapest point of each run, the first of equals, in the form of `RUNS`."""
    run, cost = tried["run"].to_numpy(), tried["cost"].to_numpy()
    own = [np.flatnonzero(run == number) for number in range(len(stops))]
    best = tried.take(pa.array([rows[np.argmin(cost[rows])] for rows in own], pa.int64()))
    added = {
        "method": [method] * len(own),
        "evaluations": [len(rows) for rows in own],
        "stop": stops,
    }
    columns = [
        pa.array(added[each.name], each.type)
        if each.name in added
        else best[each.name].combine_chunks()
        for each in RUNS
    ]
    return pa.Table.from_arrays(columns, schema=RUNS)


def _distribution(runs: pa.Table, method: str) -> dict[str, Any]:
    own = [row for row in runs.to_pylist() if row["method"] == method]
    cost = np.array([row["cost"] for row in own])
    stops = [row["stop"] for row in own]
    quartiles = np.quantile(cost, [0.25, 0.5, 0.75])
    return {
        "runs": len(own),
        "runs_that_walk": sum(row["walked"] for row in own),
        "evaluations": sum(row["evaluations"] for row in own),
        "best": float(cost.min()),
        "quartiles": [float(value) for value in quartiles],
        "worst": float(cost.max()),
        "stops": {stop: stops.count(stop) for stop in sorted(set(stops))},
    }
