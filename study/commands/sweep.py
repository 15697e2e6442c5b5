"""Tune a controller anew at each value of one key of a configuration."""

import json
from argparse import Namespace
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna

from storage.inputs.errors import InputError
from storage.pool import Cluster, cores
from study.cli import ProgressBar
from study.experiment.arms import OUR_ARM, find_arm, with_store
from study.experiment.compare import Progress, Request
from study.experiment.experiment import Experiment
from study.experiment.gains import named_gains, recorded_walk
from study.experiment.robots import read_any
from study.experiment.sweep import Swept, Tuned, points_of, read_swept, sweep
from study.experiment.walker import WalkerExperiment, row_text
from study.pictures import strip
from study.report.figures import REPORT_NAME
from study.report.markdown import dashboard_summary
from study.report.sweep import Walks, costs_of, write_sweep

COLUMN = 12  # characters
SHOWN_S = 15.0  # of a walk, of which the last metres are drawn
RATE_HZ = 100.0


def main(args: Namespace) -> None:
    """Sweep, or go on."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    swept = read_swept(args.over)
    plain = read_any(args.config, args.arch, args.seed, store=args.store)
    arm = args.arm or arm_of(plain)

    def read(over: Mapping[str, Any]) -> Experiment:
        experiment = read_any(args.config, args.arch, args.seed, over, args.store)
        if args.store is None:
            return experiment
        return with_store(experiment, [arm], args.store)

    out = folder_of(args, plain.name, swept)
    points = points_of(swept, read, out)
    robot = plain.robot
    robot.require_machine()
    request = Request(
        out=out,
        runs=args.runs,
        trials=args.trials,
        workers=args.workers or robot.processes(cores()),
        cluster=Cluster.asked(args.cluster, args.mixed, args.workers),
    )
    with closing(ProgressBar()) as bar:

        def show(progress: Progress) -> None:
            walkers = f"{progress.walkers} of {progress.studies} robots walk"
            bar.move("trial", progress.trials, progress.total, walkers)

        tuned = list(sweep(points, arm, request, show, dashboard_summary))
    trials = args.trials or plain.trials
    found = write_sweep(out / REPORT_NAME, swept, arm, trials, tuned, walks_of(tuned))
    if args.json:
        print(json.dumps({"out": str(out), **found}))
        return
    print(text(found))
    print(f"{out / REPORT_NAME / 'report.md'}")


def arm_of(experiment: Experiment) -> str:
    """The arm that tunes where nobody names one: ours, or the configuration's first.

    Raises:
        InputError: the configuration has none.
    """
    arms = experiment.arms
    if not arms:
        raise InputError("arm", None, "an arm: the configuration names none")
    return OUR_ARM if OUR_ARM in arms else find_arm(arms[0]).name


def folder_of(args: Namespace, name: str, swept: Swept) -> Path:
    """The folder of a sweep."""
    seeded = name if args.seed is None else f"{name}-seed-{args.seed}"
    return Path(args.out or Path("out") / "sweep" / f"{seeded}-{swept.key}")


def walks_of(tuned: Sequence[Tuned]) -> Walks:
    """The best trial of the first robot at each value, walked once more; of walkers alone.

    A walk to the end is shown at its begin. One that diverged at once cannot be drawn.
    """
    walks = []
    for each in tuned:
        experiment, (best, *_) = each.point.experiment, each.best.to_pylist()
        if not isinstance(experiment, WalkerExperiment):
            return []
        run, value = best["run"], str(each.point.value)
        conditions = experiment.conditions
        if best["walked"]:
            shown_s = min(conditions.duration_s, SHOWN_S)
            conditions = replace(conditions, duration_s=shown_s)
        walked = recorded_walk(
            named_gains(value, best),
            replace(experiment, conditions=conditions),
            run,
            RATE_HZ,
        )
        trajectory = walked.trajectories[0]
        if np.isfinite(trajectory.q).all(axis=1).any():
            title = f"{value}: {row_text(each.rows[0])}"
            shown = strip.Shown(value, title, trajectory)
            walks.append((shown, experiment.terrain(run)))
    return walks


def text(found: Mapping[str, Any]) -> str:
    """For people: a line a value."""
    walk = f"walk, of {found['robots']}"
    heads = [found["key"], walk, "after trials", "lower", "best cost", "upper"]
    wide = max(len(found["key"]), COLUMN)
    return "\n".join(
        value.ljust(wide) + "".join(cell.rjust(COLUMN + 2) for cell in cells)
        for value, *cells in (heads, *costs_of(found))
    )
