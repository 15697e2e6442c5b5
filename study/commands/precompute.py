"""Compute a store of scores: simulate points of a Sobol sequence, shard by shard."""

import json
import sys
import warnings
from argparse import Namespace
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

from storage.cluster import open_pool
from storage.inputs.config import read_toml, read_whole
from storage.inputs.errors import InputError
from storage.pool import Cluster, cores
from storage.precompute import Summary, precompute
from storage.simulator import WALKER
from storage.specification import read_specification
from study.cli import ProgressBar
from taichi_nmm.settings import may_have_gpu

if TYPE_CHECKING:
    from study.sampler.forecast import Forecast

Report = Callable[[int, int], object]
SEARCH_ON_GPU = "note: a search tries few points at a time: --arch cpu is faster"


def main(args: Namespace) -> None:
    """Compute, or go on."""
    specification = read_whole(
        read_toml(args.config),
        lambda table: read_specification(table, args.samples, args.arch),
    )
    simulator = specification.simulator
    # Points need it, and it takes as long as to load a GPU's kernels.
    if may_have_gpu():
        Thread(target=__import__, args=("scipy.stats.qmc",)).start()
    simulator.require_machine()
    if args.forecast and (simulator.name != WALKER or not specification.families):
        allowed = "a store of the walker with families; of others, `taichi-nmm bench forecast`"
        raise InputError("forecast", simulator.name, allowed)
    out = args.out or Path("out") / args.config.stem
    workers = simulator.processes(cores()) if args.workers is None else args.workers
    if specification.repertoire is not None and simulator.points_at_once:
        print(SEARCH_ON_GPU, file=sys.stderr)
    folder = None if args.fresh else out
    cluster = Cluster.asked(args.cluster, args.mixed, args.workers)
    opened = open_pool(workers, cluster, folder, simulator.on_one_thread())
    with opened as pool, closing(ProgressBar()) as bar:
        progress = partial(bar.move, "run", total=specification.work)
        summary = precompute(specification, out, args.fresh, progress, pool)
        said = text(summary)
        told = asdict(summary)
        if args.forecast:
            told["forecast"] = str(expected(out, partial(bar.move, "robot")))
            said += f"\n{told['forecast']}"
    for line in summary.cautions:
        print(f"warning: {line}", file=sys.stderr)
    print(json.dumps(told) if args.json else said)


def expected(store: Path, report: Report) -> "Forecast":
    """What walkers like the worlds of a store may need, by the smooth cost of a trial."""
    from study.experiment.features import world_table
    from study.experiment.objective import Objective
    from study.sampler.forecast import forecast
    from taichi_nmm.conditions import TRIAL_S

    objective = Objective()
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        candidates = world_table(store, objective.in_worlds)
    return forecast(candidates, success=objective.success(TRIAL_S), report=report)


def text(summary: Summary) -> str:
    """For people, a line each."""
    points = f"{summary.points} in {summary.shards} shards ({summary.points_computed} computed now)"
    lasted = f"{summary.alive_at_horizon} to the horizon ({100 * summary.alive_fraction:.2f} %)"
    lines = [
        ("points", points),
        ("lasted", lasted),
        *(
            [("searched", f"{summary.walks_searched} runs")]
            if summary.walks_searched
            else []
        ),
        *(
            (name, f"{count} points in its worlds")
            for name, count in summary.evaluated.items()
        ),
        ("speed", f"{summary.walkers_per_s:.0f} runs/s over {summary.wall_s:.1f} s"),
        ("store", summary.path),
    ]
    return "\n".join(f"{name:<11} {line}" for name, line in lines)
