"""Estimate the optimum as the paper does: nominal body, level ground, the best of many runs.

    taichi-nmm optimum --config optimum-smooth

runs CMA-ES until convergence and the determinants-of-gait sampler, and writes optimum.json and
runs.parquet to the folder --out. The command can be stopped at any time; the same command goes on
where it stopped. A later call may add runs or generations. Exit codes: 0, 2 bad input, 130
interrupted.
"""

import json
import sys
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

import optuna

from storage.pool import Cluster, cores
from study.experiment.experiment import read_experiment
from study.experiment.optimum import OPTIMUM_NAME, estimate
from taichi_nmm.walker_simulator import Walker, require_engine


def main(args: Namespace) -> None:
    """Estimate, or go on."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    experiment = read_experiment(args.config, args.arch)
    if args.max_generations is not None:
        cmaes = replace(experiment.cmaes, max_generations=args.max_generations)
        experiment = replace(experiment, cmaes=cmaes)
    out = args.out or Path("out") / "optimum" / experiment.name
    settings = experiment.conditions.settings
    require_engine(settings)
    workers = Walker(settings).processes(cores()) if args.workers is None else args.workers
    cluster = Cluster.asked(args.cluster, args.mixed)
    document = estimate(experiment, out, args.runs, workers, tell, cluster)
    print(json.dumps(document) if args.json else text(document, out))


def tell(line: str) -> None:
    """Print on standard error."""
    print(line, file=sys.stderr, flush=True)


def text(document: dict[str, Any], out: Path) -> str:
    """For people: the best of all, and a line a method."""
    lines = [
        f"{document['cost']} cost: {document['best_cost']:.5g} ({document['method']}, run "
        f"{document['run']}, {document['outcome']['mean_speed_mps']:.2f} m/s): {out / OPTIMUM_NAME}"
    ]
    for method, found in document["methods"].items():
        stops = ", ".join(f"{count} by {stop}" for stop, count in found["stops"].items())
        middle = found["quartiles"][1]
        lines.append(
            f"  {method}: best {found['best']:.5g}, median {middle:.5g} of {found['runs']} runs, "
            f"{found['runs_that_walk']} walk, {found['evaluations']} evaluations; ended: {stops}"
        )
    return "\n".join(lines)
