"""Compare samplers on the walker: every arm tries the same robots on the same grounds."""

import json
import time
from argparse import Namespace
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import optuna

from storage.cluster import open_pool
from storage.commit import commit_text
from storage.databases.studies import public_url
from storage.inputs.errors import InputError
from storage.pool import Cluster, cores
from study.cli import ProgressBar
from study.experiment import robots
from study.experiment.arms import with_store
from study.experiment.compare import Outcome, Progress, Request, compare
from study.experiment.experiment import Experiment, read_experiment
from study.experiment.folder import PACKAGES
from study.report.markdown import (
    RobotResults,
    arms_documents,
    arms_text,
    dashboard_summary,
)
from study.report.numbers import numbers
from study.report.runs import read_facts, read_results
from taichi_nmm.walker_simulator import Walker, require_engine


def main(args: Namespace) -> None:
    """Compare, or go on."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    if robots.is_of_robots(args.config):
        on_robots(args)
        return
    experiment = read_experiment(args.config, args.arch, args.seed)
    out = folder_of(args, experiment.name)
    read_facts(out)  # refused before the work, since the report at the end reads them
    arms = tuple(args.arms.split(",")) if args.arms is not None else None
    if args.store is not None:
        experiment = with_store(experiment, arms or experiment.arms, args.store)
    settings = experiment.conditions.settings
    require_engine(settings)
    workers = (
        Walker(settings).processes(cores()) if args.workers is None else args.workers
    )
    cluster = Cluster.asked(args.cluster, args.mixed, args.workers)
    request = Request(out, args.storage, arms, args.runs, args.trials, workers, cluster)
    with closing(ProgressBar()) as bar:

        def show(progress: Progress) -> None:
            walkers = f"{progress.walkers} of {progress.studies} studies with a walker"
            bar.move("trial", progress.trials, progress.total, walkers)

        outcome = compare(experiment, request, show, dashboard_summary)
    print(
        json.dumps(report(experiment, outcome, out))
        if args.json
        else text(outcome, out)
    )


def on_robots(args: Namespace) -> None:
    """Compare on robots of the simulator that the configuration names, or go on."""
    robots.refuse_walkers_options(args)
    if args.storage is not None:
        raise InputError(
            "storage", args.storage, "none: study runs robots in a database"
        )
    experiment = robots.read_robots(
        args.config, args.seed, args.arms, args.runs, args.trials
    )
    simulator = experiment.simulator
    simulator.require_machine()
    out = folder_of(args, experiment.name)
    workers = simulator.processes(cores()) if args.workers is None else args.workers
    cluster = Cluster.asked(args.cluster, args.mixed, args.workers)
    opened = open_pool(workers, cluster, out, simulator, PACKAGES, [experiment.store])
    began_s = time.monotonic()
    with opened as pool, closing(ProgressBar()) as bar:
        trials = robots.compare_robots(
            experiment, out, pool, partial(bar.move, "study")
        )
    results = RobotResults.of(experiment, trials)
    commit_text(out / "report.md", results.markdown())
    if args.json:
        wall_s = round(time.monotonic() - began_s, 1)
        print(json.dumps({"out": str(out), "trials": len(trials), "wall_s": wall_s}))
        return
    print(f"{results.markdown()}\n{len(trials)} trials: {out / 'trials.parquet'}")


def folder_of(args: Namespace, name: str) -> Path:
    """The folder of a comparison."""
    seeded = name if args.seed is None else f"{name}-seed-{args.seed}"
    return Path(args.out or Path("out") / "compare" / seeded)


def report(experiment: Experiment, outcome: Outcome, out: Path) -> dict[str, Any]:
    """For programs: one object of plain values."""
    return {
        "out": str(out),
        "storage": public_url(outcome.storage),
        "trials": len(outcome.trials),
        "trials_computed": outcome.computed,
        "wall_s": outcome.wall_s,
        "arms": arms_documents(numbers(read_results(out)), experiment.stores),
    }


def text(outcome: Outcome, out: Path) -> str:
    """The same for people."""
    done = f"{len(outcome.trials)} trials ({outcome.computed} now, in {outcome.wall_s:.0f} s)"
    database = public_url(outcome.storage)
    arms = arms_text(numbers(read_results(out)))
    return f"{arms}\n{done}: {out / 'trials.parquet'}\ndatabase: {database}"
