"""Compare samplers: every arm tries the same robots on the same grounds."""

import json
import sys
from argparse import Namespace
from contextlib import closing
from pathlib import Path
from typing import Any

import optuna

from storage.databases.studies import public_url
from storage.pool import Cluster, cores
from study.cli import ProgressBar
from study.experiment.arms import with_store
from study.experiment.compare import Outcome, Progress, Request, compare
from study.experiment.experiment import Experiment
from study.experiment.robots import able_arms, read_any, unable_arms
from study.report.markdown import arms_documents, arms_text, dashboard_summary
from study.report.numbers import numbers
from study.report.runs import read_facts, read_results


def main(args: Namespace) -> None:
    """Compare, or go on."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    experiment = read_any(args.config, args.arch, args.seed, store=args.store)
    out = folder_of(args, experiment.name)
    read_facts(out)  # refused before the work, since the report at the end reads them
    arms = tuple(args.arms.split(",")) if args.arms is not None else None
    if arms is None and experiment.arms == able_arms():
        for line in unable_arms():
            print(line, file=sys.stderr)
    if args.store is not None:
        experiment = with_store(experiment, arms or experiment.arms, args.store)
    robot = experiment.robot
    robot.require_machine()
    request = Request(
        out=out,
        storage=args.storage,
        arms=arms,
        runs=args.runs,
        trials=args.trials,
        workers=args.workers or robot.processes(cores()),
        cluster=Cluster.asked(args.cluster, args.mixed, args.workers),
    )
    with closing(ProgressBar()) as bar:

        def show(progress: Progress) -> None:
            walkers = f"{progress.walkers} of {progress.studies} studies with a walker"
            bar.move("trial", progress.trials, progress.total, walkers)

        outcome = compare(experiment, request, show, dashboard_summary)
    if args.json:
        print(json.dumps(report(experiment, outcome, out)))
    else:
        print(text(outcome, out))


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
