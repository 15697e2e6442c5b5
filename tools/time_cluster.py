"""Time what a Dask cluster of this machine costs: a task, a shard on the wire, and its speed.

    python tools/time_cluster.py            # a table; two minutes
    python tools/time_cluster.py --json

Speeds are those of `precompute`, by turns, on an idle machine; with the extra cluster.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import guarded_imports, run_command

with guarded_imports():
    from storage.pool import cores
    from storage.specification import read_specification
    from study.benchmarks.cluster_timing import SHARDS, ClusterTiming, measure
    from study.options import Options, config_path
    from taichi_nmm.config import read_toml

MOST_ROUNDS = 100


def main() -> None:
    options = parse()
    table = read_toml(config_path("store"))
    shipped = read_specification(table, options.shard_rows * SHARDS, "cpu")
    timing = measure(
        replace(shipped, shard_rows=options.shard_rows), options.workers, options.rounds
    )
    print(json.dumps(timing.as_dict()) if options.json else text(timing))


def parse() -> argparse.Namespace:
    parser = Options(__file__)
    parser.whole("--workers", 1, 256, default=cores(), help="of the cluster; %(default)s")
    parser.whole("--shard-rows", 1, 65536, default=4096, help="points a task; %(default)s")
    parser.whole("--rounds", 1, MOST_ROUNDS, default=3, help="%(default)s")
    parser.add_argument("--json", action="store_true", help="print one object")
    return parser.parse_args()


def text(timing: ClusterTiming) -> str:
    lines = [
        ("points a task", f"{timing.shard_rows}"),
        ("a task's work, one thread", f"{timing.shard_s:.2f} s"),
        ("a task's result, pickled", f"{timing.shard_bytes / 2**20:.2f} MiB"),
        ("submit, run nothing, return it", f"{timing.task_ms:.1f} ms"),
        ("of the work", f"{100 * timing.overhead:.2f} %"),
        ("start of the cluster", f"{timing.start_s:.1f} s"),
        (f"one process, {timing.workers} threads", rates(timing.here)),
        (f"local:{timing.workers}, one thread each", rates(timing.there)),
        ("ratio, median", f"{timing.ratio:.2f}"),
    ]
    return "\n".join(f"{name:<32} {value}" for name, value in lines)


def rates(speeds: tuple[float, ...]) -> str:
    return ", ".join(f"{speed:.0f}" for speed in speeds) + " walkers/s"


if __name__ == "__main__":
    run_command(main)
