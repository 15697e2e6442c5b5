"""The estimate from its configuration to its document, as taichi-nmm optimum runs it."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from storage.cluster.asked import Cluster
from storage.cluster.opening import open_pool
from study.comparison.compare import Progress, Request, compare
from study.experiment.arms import PAPER_ARM, check_arms
from study.experiment.experiment import Experiment
from study.experiment.identity import deciding_packages, document, machine
from study.experiment.stores import store_path
from study.optimum.generations import CmaesProgress, run_cmaes
from study.optimum.optimum_folder import DOG_NAME, RUNS, OptimumFolder
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES
from taichi_nmm.walker_simulator import Walker

METHODS = ("cmaes", "dog")
TRIALS_DONE = "all trials"


@dataclass(frozen=True)
class Reports:
    """Who is told of progress.

    Attributes:
        dog: of the sampler's trials.
        cmaes: of the generations.
    """

    dog: Callable[[Progress], None]
    cmaes: Callable[[CmaesProgress], None]


def estimate(
    experiment: Experiment,
    out: Path,
    runs: int | None,
    workers: int,
    reports: Reports,
    cluster: Cluster | None = None,
) -> dict[str, Any]:
    """Run both methods, or what is missing of them, and write the result.

    Args:
        experiment: level ground and the undisturbed body; its seed is also that of CMA-ES.
        out: folder of the estimate.
        runs: of each method; None is what the configuration says. A later call may ask for more.
        workers: processes of this machine.
        reports: who is told.
        cluster: that works in place of the processes.

    Returns:
        The document of optimum.json.

    Raises:
        InputError: another ground or body, and see `check_arms`, `OptimumFolder.claim`, `compare`
            and `run_cmaes`.
        KeyboardInterrupt: what is finished is kept.
    """
    _require_easiest(experiment)
    count = experiment.runs if runs is None else runs
    for name, value in (("runs", count), ("workers", workers)):
        if value < 1:
            raise InputError(name, value, "1 or more")
    (arm,) = check_arms(experiment, (PAPER_ARM,), experiment.trials)
    began_s = time.monotonic()
    opened = open_pool(
        workers,
        cluster,
        out,
        Walker(experiment.on_one_thread().conditions.settings),
        deciding_packages(experiment),
        [store_path(experiment, arm.store)],
    )
    with opened as pool, OptimumFolder.claim(out, _document(experiment)) as folder:
        pool.agree(out)
        folder.read_evaluations()  # refused, if at all, before the work
        request = Request(out / DOG_NAME, arms=(PAPER_ARM,), runs=count, artifacts=False)
        dog = compare(experiment, request, reports.dog, pool=pool).trials
        tried, stops = run_cmaes(experiment, count, folder, pool, reports.cmaes)
        parts = [
            _best_of_runs("cmaes", tried, stops),
            _best_of_runs("dog", dog, [TRIALS_DONE] * count),
        ]
        table = pa.concat_tables(parts)
        folder.write_runs(table)
        found = result(experiment, table) | {
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "wall_s": round(time.monotonic() - began_s, 1),  # of the session that ended it
            "machine": machine(),
        }
        folder.write_optimum(found)
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


def _document(experiment: Experiment) -> dict[str, Any]:
    """What decides the result of CMA-ES; the number of runs and of generations may grow."""
    cmaes = asdict(experiment.cmaes)
    cmaes.pop("max_generations")
    return document(experiment, ()) | {"cmaes": cmaes}


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
