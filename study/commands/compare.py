"""Compare samplers on the walker: the same bodies and grounds for each, going on side by side.

    taichi-nmm compare --config rough8-smooth --arms dog,random --runs 10

writes trials.parquet and proposal_times.parquet to the folder --out. Stop it when you like; the
same command goes on where it stopped, and more arms, runs or trials can be asked for later. Exit
codes: 0, 2 bad input, 130 interrupted.
"""

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

import optuna
from tqdm import tqdm

from storage.databases.studies import public_url
from study.cli import default_workers, require_engine
from study.comparison.compare import Outcome, Request, compare
from study.comparison.finished import Progress
from study.experiment.check import with_store
from study.experiment.experiment import Experiment, read_experiment
from study.options import asked_cluster
from study.report.documents import read_facts
from study.report.lines import arms_documents, arms_text
from study.report.notes import dashboard_summary
from study.report.numbers import numbers
from study.report.runs import read_results


class ProgressBar:
    """Trials a second, the time left, and the studies with a walker, on standard error."""

    def __init__(self) -> None:
        """Not shown yet."""
        self._bar: tqdm[None] | None = None

    def show(self, progress: Progress) -> None:
        """Move on; the first call tells what was there."""
        walkers = f"{progress.walkers} of {progress.studies} studies with a walker"
        self._move("trial", progress.trials, progress.total, walkers)

    def draw(self, done: int, total: int) -> None:
        """The same of pictures, on a line of its own."""
        self._move("picture", done, total)

    def close(self) -> None:
        """Leave the line."""
        if self._bar is not None:
            self._bar.close()
        self._bar = None

    def _move(self, unit: str, done: int, total: int, note: str = "") -> None:
        if self._bar is not None and self._bar.unit != unit:
            self.close()
        if self._bar is None:
            self._bar = tqdm(total=total, initial=done, unit=unit, smoothing=0.05)
        self._bar.set_postfix_str(note, refresh=False)
        self._bar.update(done - self._bar.n)


def main(args: Namespace) -> None:
    """Compare, or go on."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    experiment = read_experiment(args.config, args.arch, args.seed)
    name = experiment.name if args.seed is None else f"{experiment.name}-seed-{args.seed}"
    out = args.out or Path("out") / "compare" / name
    read_facts(out)  # what the report at the end will want to know
    arms = tuple(args.arms.split(",")) if args.arms is not None else None
    if args.store is not None:
        experiment = with_store(experiment, arms or experiment.arms, args.store)
    settings = experiment.conditions.settings
    require_engine(settings)
    workers = default_workers(settings) if args.workers is None else args.workers
    request = Request(
        out,
        args.storage,
        arms,
        args.runs,
        args.trials,
        workers,
        not args.no_artifacts,
        args.films,
        asked_cluster(args),
    )
    bar = ProgressBar()
    try:
        outcome = compare(experiment, request, bar.show, bar.draw, dashboard_summary)
    finally:
        bar.close()
    print(json.dumps(report(experiment, outcome, out)) if args.json else text(outcome, out))


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
