"""How fast the simulator is: start-up and run time apart.

    python tools/time_walks.py
    taskset -c 0 python tools/time_walks.py --against ../before   # another checkout, by turns

Each figure comes from a fresh process. "Cold" starts with an empty cache of compiled
kernels, "warm" with a full one; both import, start the engine and compile. Run the
command on an idle machine: other work makes its figures meaningless.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

from checkout import guarded_imports, run_command

with guarded_imports():
    from storage.inputs.errors import InputError
    from study.options import Options
    from taichi_nmm.kernel_cache import CACHE_VARIABLE
    from taichi_nmm.settings import ARCHITECTURES

ROOT = Path(__file__).resolve().parents[1]
WORKER = ROOT / "tools" / "time_walks_worker.py"

Measured = dict[str, Any]

MOST_SAMPLES = 10_000_000
# Of --against: near the published gains, where all stay up; and the search space.
LOADS: dict[str, Measured] = {
    "steady": {"walkers": 512, "steady": True, "duration_s": 3.0, "repeats": 3},
    "search space": {"walkers": 2048, "duration_s": 5.0, "repeats": 3},
}
TURNS = 7


def main() -> None:
    options = parse()
    with tempfile.TemporaryDirectory() as cache:
        measured = by_turns if options.against else measure
        for line in measured(options, Path(cache)):
            print(line, flush=True)


def parse() -> argparse.Namespace:
    parser = Options(__file__)
    parser.whole("--samples", 1, MOST_SAMPLES, default=100_000, help="%(default)s")
    parser.path("--against", "only compare ns a walker-step by turns", "CHECKOUT")
    parser.add_argument("--arch", choices=ARCHITECTURES, default="auto")
    options = parser.parse_args()
    if options.against and not (options.against / "taichi_nmm").is_dir():
        raise InputError(
            "against", options.against, "the folder of a checkout of this project"
        )
    return options


def measure(options: argparse.Namespace, cache: Path) -> Iterator[str]:
    """Lines on a cold start, then on a warm start and a run."""
    samples, arch = options.samples, options.arch
    cold = worker("cold start", cache / "main", arch=arch)
    run = worker("run", cache / "main", arch=arch, walkers=samples, duration_s=5.0)
    seconds, steps_per_s = run["run_s"], run["steps"] / run["run_s"]
    yield (
        f"machine        {os.cpu_count()} cores, {platform.system()} {platform.machine()};"
        f" {run['arch']}, {run['precision']}, {run['lanes']} lanes"
    )
    yield f"cold start     {cold['start_s']:.1f} s (compiles)"
    yield f"warm start     {run['start_s']:.1f} s"
    yield (
        f"run            {samples:,} points x 5 s in {seconds:.1f} s,"
        f" {100 * run['alive'] / samples:.1f} % alive at the end"
    )
    yield f"speed          {samples / seconds:,.0f} walkers/s, {steps_per_s:,.0f} walker-steps/s"
    yield f"peak memory    {run['peak_rss_mib']:,.0f} MiB"


def by_turns(options: argparse.Namespace, cache: Path) -> Iterator[str]:
    """CPU ns a walker-step of both checkouts, one measured after the other."""
    roots = {"this": ROOT, "other": options.against.resolve()}
    turns: Measured = {load: {name: [] for name in roots} for load in LOADS}
    for turn, (load, words), (name, root) in product(
        range(TURNS), LOADS.items(), roots.items()
    ):
        what = f"turn {turn + 1} of {TURNS}, {load}, {name}"
        run = worker(what, cache / name, **words, threads=1, root=str(root))
        turns[load][name].append(1e9 * run["cpu_s"] / run["steps"])
    yield f"CPU ns a walker-step, one thread, median of {TURNS} turns: this, the other, ratio"
    for load, taken in turns.items():
        yield turns_line(load, **taken)


def turns_line(load: str, this: list[float], other: list[float]) -> str:
    """Medians of both checkouts, and of the ratio of their turns."""
    ratio = median(a / b for a, b in zip(this, other, strict=True))
    return f"{load:12} {median(this):7.1f}  {median(other):7.1f}  {ratio:.3f}"


def worker(what: str, cache: Path, **words: Any) -> Measured:
    """A measurement by `time_walks_worker.py` in a fresh process with this cache of kernels."""
    print(f"measuring: {what}", file=sys.stderr, flush=True)
    done = subprocess.run(
        [sys.executable, str(WORKER), json.dumps(words)],
        cwd=ROOT,
        env={**os.environ, CACHE_VARIABLE: str(cache)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise InputError("time_walks", what, f"a measurement that runs ({reason})")
    measured: Measured = json.loads(done.stdout.splitlines()[-1])
    return measured


if __name__ == "__main__":
    run_command(main)
