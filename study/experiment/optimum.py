"""The optimum of a cost, as the paper estimates it: the best of many runs on level ground.

Each run of CMA-ES goes on until it has converged; a generation of several runs is one batch of the
simulator. The paper's arm runs beside them, as a comparison. The folder is the state:

search.json           written first: what is estimated, with which versions
evaluations.parquet   every point that CMA-ES tried, rewritten whole at each checkpoint
dog/                  the comparison's folder of the paper's arm
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
from storage.folder import Folder
from storage.pool import Cluster, Pool
from storage.tables import write_table
from study.experiment.arms import PAPER_ARM, check_arms
from study.experiment.compare import Request, compare, opened_pool, work_through
from study.experiment.experiment import CmaesOptions, Experiment
from study.experiment.folder import cheapest, in_order, schema_of, table_of
from study.experiment.identity import GROWING, document, machine
from study.experiment.samplers import CmaEs
from study.experiment.trials import OUTCOMES, costs, finite, simulate_trials, walked
from study.sampler.draws import Purpose, generator
from taichi_nmm import checks
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, GAINS, lower_bounds, upper_bounds

CMAES = "cmaes"
TRIALS_DONE = "all trials"
CUT = "max_generations"
BLOCK_RUNS = 10  # with STRETCH_GENERATIONS some 20 s of work; results depend on neither
STRETCH_GENERATIONS = 5

OPTIMUM_NAME = "optimum.json"
RUNS_NAME = "runs.parquet"
EVALUATIONS_NAME = "evaluations.parquet"

_TRIED = [
    *((name, pa.float64()) for name in (*GAIN_NAMES, "cost")),
    ("walked", pa.bool_()),
    *((name, pa.float64()) for name in OUTCOMES),
]
_KEYS = ("run", "generation", "member")
EVALUATIONS = schema_of(*((name, pa.int32()) for name in _KEYS), *_TRIED)
RUNS = schema_of(
    ("method", pa.string()),
    ("run", pa.int32()),
    ("evaluations", pa.int64()),
    ("stop", pa.string()),
    *_TRIED,
)


class OptimumFolder(Folder):
    """The folder of an estimate; its document says what decides the result of CMA-ES."""

    KIND = "one of this command"
    FIRST = "search.json"
    GROWING = GROWING

    def evaluations(self) -> pa.Table:
        """The points that CMA-ES has tried, by run, generation and member.

        Raises:
            InputError: a damaged or edited file, or one of something else.
        """
        return self.read_state(EVALUATIONS_NAME, EVALUATIONS, "points that CMA-ES tried")


@dataclass(frozen=True)
class Stretch:
    """A unit of work: some runs of CMA-ES, to be taken on by some generations."""

    experiment: Experiment
    runs: tuple[int, ...]  # their numbers
    known: pa.Table  # the points that they have tried, `EVALUATIONS`
    where: str  # their folder, for messages


def estimate(
    experiment: Experiment,
    out: Path,
    runs: int | None,
    workers: int,
    report: Callable[[str], None],
    cluster: Cluster | None = None,
) -> dict[str, Any]:
    """Run CMA-ES and the paper's arm, or what is missing of them; return optimum.json's document.

    The experiment has level ground and the undisturbed body; its seed is also that of CMA-ES. Runs
    are of each arm, None: the configuration's; a later call may ask for more. `report` is called
    with a line on the progress, and a cluster works in place of the processes of this machine.

    Raises:
        InputError: another ground or body, a folder of something else, and see `check_arms`,
            `compare` and `evolve`.
        KeyboardInterrupt: finished work is kept.
    """
    _require_easiest(experiment)
    count = experiment.runs if runs is None else runs
    checks.whole(1)("runs", count)
    arms = check_arms(experiment, (PAPER_ARM,), experiment.trials)
    began_s = time.monotonic()
    request = Request(out, workers=workers, cluster=cluster)
    with (
        opened_pool(experiment, arms, request) as pool,
        OptimumFolder.claim(out, _document(experiment)) as folder,
    ):
        pool.agree(out)
        folder.evaluations()  # refused, if at all, before the work
        request = Request(out / PAPER_ARM, arms=(PAPER_ARM,), runs=count, artifacts=False)
        paper = compare(
            experiment,
            request,
            lambda done: report(f"{PAPER_ARM}: {done.trials} of {done.total} trials"),
            pool=pool,
        )
        tried, stops = run_cmaes(experiment, count, folder, pool, report)
        best = {
            CMAES: _best_of_runs(tried, stops),
            PAPER_ARM: _best_of_runs(paper.trials, [TRIALS_DONE] * count),
        }
        rows = [row | {"method": method} for method, own in best.items() for row in own]
        write_table(out / RUNS_NAME, pa.Table.from_pylist(rows, RUNS), folder.document)
        least = min(rows, key=lambda row: row["cost"])
        found = {
            "cost": experiment.cost,
            "best_cost": least["cost"],
            "method": least["method"],
            "run": least["run"],
            "gains": {name: least[name] for name in GAIN_NAMES},
            "outcome": {name: least[name] for name in ("walked", *OUTCOMES)},
            "methods": {method: _distribution(own) for method, own in best.items()},
            "config": _document(experiment)
            | {
                PAPER_ARM: {"trials": experiment.trials},
                "max_generations": experiment.cmaes.max_generations,
            },
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "wall_s": round(time.monotonic() - began_s, 1),  # of the session that ended it
            "machine": machine(),
        }
        commit_json(out / OPTIMUM_NAME, found)
        return found


def _require_easiest(experiment: Experiment) -> None:
    """Refuse all but the paper's easiest setting, of which runs are repetitions."""
    conditions = experiment.conditions
    for field, value, easiest, allowed in (
        ("terrain.kind", conditions.ground.kind, "flat", "flat"),
        ("body.disturbance", conditions.disturbance, 0.0, "0"),
        ("searched", list(experiment.searched), [], "none"),
    ):
        if value != easiest:
            raise InputError(field, value, f"{allowed}, for the optimum's estimate")


def _document(experiment: Experiment) -> dict[str, Any]:
    """What decides the result of CMA-ES; the number of runs and of generations may grow."""
    cmaes = asdict(experiment.cmaes)
    cmaes.pop("max_generations")
    return document(experiment, ()) | {"cmaes": cmaes}


def run_cmaes(
    experiment: Experiment,
    runs: int,
    folder: OptimumFolder,
    pool: Pool,
    report: Callable[[str], None],
) -> tuple[pa.Table, list[str]]:
    """Go on until every run has stopped; each finished stretch is reported, and kept.

    Returns the evaluations by run, generation, member; and why each run has ended.

    Raises:
        InputError: as `evolve`, or a disk that is full.
    """
    experiment = experiment.on_one_thread() if pool.shares_machine else experiment
    tried = folder.evaluations()
    committed = len(tried)
    stops: dict[int, str] = {}

    def stretch(part: tuple[int, ...]) -> Stretch:
        known = tried.filter(pc.is_in(tried["run"], pa.array(part, pa.int32())))
        return Stretch(experiment, part, known, str(folder.path))

    def take(done: Stretch, found: tuple[pa.Table, dict[int, str]]) -> Iterator[Stretch]:
        nonlocal tried
        tried = in_order([tried, found[0]], _KEYS)
        stops.update(found[1])
        if going := tuple(run for run in done.runs if run not in stops):
            yield stretch(going)
        generation, best = pc.max(tried["generation"]).as_py() + 1, pc.min(tried["cost"]).as_py()
        report(
            f"{CMAES}: generation {generation}, {runs - len(stops)} of {runs} runs go on, "
            f"{len(tried)} evaluations, best cost {best:.5g}"
        )

    def commit(_goes_on: bool) -> None:
        nonlocal committed
        if len(tried) > committed:
            folder.write_state(EVALUATIONS_NAME, tried)
            committed = len(tried)

    size = min(BLOCK_RUNS, -(-runs // pool.slots))
    parts = [tuple(range(first, min(first + size, runs))) for first in range(0, runs, size)]
    work_through(pool, evolve, map(stretch, parts), take, commit)
    return tried, [stops[run] for run in range(runs)]


def evolve(stretch: Stretch) -> tuple[pa.Table, dict[int, str]]:
    """Take the runs of a stretch on.

    Returns the points tried beyond those known, `EVALUATIONS`; and why runs have ended, by number.

    Raises:
        InputError: the known points are not those that these runs try, or what the simulator
            refuses.
    """
    experiment, most = stretch.experiment, stretch.experiment.cmaes.max_generations
    runs = {run: new_run(experiment.cmaes, experiment.seed, run) for run in stretch.runs}
    for run, search in runs.items():
        known = stretch.known.filter(pc.equal(stretch.known["run"], run))
        _replay(search, known, f"run {run} in {stretch.where}")
    last = {run: min(each.generation + STRETCH_GENERATIONS, most) for run, each in runs.items()}
    tables = [EVALUATIONS.empty_table()]
    while going := {run: each for run, each in runs.items() if not ended(each, last[run])}:
        tables.append(_generation(experiment, going))
    stops = {run: reason for run, each in runs.items() if (reason := ended(each, most))}
    return pa.concat_tables(tables), stops


def new_run(options: CmaesOptions, seed: int, run: int) -> CmaEs:
    """A run of CMA-ES from a random point; it depends on the arguments and on nothing else."""
    start = generator(seed, Purpose.CMAES_MEAN, run).random(len(GAINS))
    more = {"popsize": options.population} if options.population else {}
    draws = generator(seed, Purpose.CMAES, run)
    return CmaEs(start, options.sigma, draws, tolfun=options.tolerance, **more)


def ended(search: CmaEs, max_generations: int) -> str:
    """Why a run has ended: pycma's criteria, or the limit; "" while it goes on."""
    return search.stopped or (CUT if search.generation >= max_generations else "")


def asked_gains(search: CmaEs) -> NDArray[np.float64]:
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
    columns = {
        "run": run_of,
        "generation": np.repeat([search.generation for search in going.values()], sizes),
        "member": np.concatenate([np.arange(size) for size in sizes]),
        **dict(zip(GAIN_NAMES, gains.T, strict=True)),
        "cost": cost,
        "walked": walked(rows),
        **{name: rows[name] for name in OUTCOMES},
    }
    for search, told in zip(going.values(), np.split(cost, np.cumsum(sizes)[:-1]), strict=True):
        search.tell(told.tolist())
    return table_of(EVALUATIONS, columns)


def _replay(search: CmaEs, known: pa.Table, where: str) -> None:
    """Tell a run its known points again: a millisecond a generation."""
    gains = np.column_stack([known[name].to_numpy() for name in GAIN_NAMES])
    cost = known["cost"].to_numpy()
    for first in range(0, len(cost), search.population):
        points = slice(first, first + search.population)
        if not np.array_equal(asked_gains(search), gains[points]):
            allowed = "evaluations of these settings and this version of pycma"
            raise InputError("out", where, allowed)
        search.tell(cost[points].tolist())


def _best_of_runs(tried: pa.Table, stops: list[str]) -> list[dict[str, Any]]:
    """The cheapest point of each run, the first of equals, with columns of `RUNS`."""
    best = []
    for run, stop in enumerate(stops):
        own = tried.filter(pc.equal(tried["run"], run))
        best.append(cheapest(own) | {"evaluations": len(own), "stop": stop})
    return best


def _distribution(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """How the runs of an arm are distributed."""
    cost, stops = [row["cost"] for row in runs], [row["stop"] for row in runs]
    return {
        "runs": len(runs),
        "runs_that_walk": sum(row["walked"] for row in runs),
        "evaluations": sum(row["evaluations"] for row in runs),
        "best": min(cost),
        "quartiles": np.quantile(cost, [0.25, 0.5, 0.75]).tolist(),
        "worst": max(cost),
        "stops": {stop: stops.count(stop) for stop in sorted(set(stops))},
    }
