"""How fast the simulator is: start-up and run time apart, lane widths, MuJoCo beside it.

    python tools/bench.py --lanes 1,4,8,16 --threads --mujoco
    taskset -c 0 python tools/bench.py --against ../before   # another checkout, by turns

Each figure comes from a fresh process. "Cold" starts with an empty cache of compiled kernels,
"warm" with a full one; both import, start the engine and compile. Run the command on an idle
machine: other work makes its figures meaningless.
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
    from study.options import Options
    from taichi_nmm.errors import InputError
    from taichi_nmm.kernel_cache import CACHE_VARIABLE
    from taichi_nmm.settings import ARCHITECTURES

ROOT = Path(__file__).resolve().parents[1]
WORKER = ROOT / "tools" / "bench_worker.py"
MUJOCO_MODULE = "tests.parity.mujoco_bench_model"

LARGEST_LANES = 64
MOST_SAMPLES = 10_000_000
LANE_SAMPLES = 8192  # points for a row of the table of lane widths, at most
MUJOCO_ROLLOUTS = 256  # of a second each
SOBOL = "--duration 5"  # options of the worker: points of the search space
FEW = "--walkers 400 --steady --duration 10 --repeats 5"  # a round of a comparison
LOADS = {  # of --against: near the published gains, where all stay up; and the search space
    "steady": "--walkers 512 --steady --duration 3 --repeats 3",
    "Sobol": "--walkers 2048 --duration 5 --repeats 3",
}
TURNS = 7

# Seconds for 100,000 points x 5 s, as measured on another 2-core machine (AVX-512).
REFERENCE_POINTS = 100_000
REFERENCES_S = {"scalar C, float64": 234.0, "hand-written AVX-512, float32": 14.9}

Measured = dict[str, Any]


def main() -> None:
    options = parse()
    with tempfile.TemporaryDirectory() as cache:
        measured = by_turns if options.against else measure
        for line in measured(options, Path(cache)):
            print(line, flush=True)


def parse() -> argparse.Namespace:
    parser = Options(__file__)
    parser.whole("--samples", 1, MOST_SAMPLES, default=100_000, help="%(default)s")
    parser.add_argument("--lanes", default="", metavar="1,4,8,16", help="compare widths on the CPU")
    parser.flag("--threads", "few walkers on one thread, on all")
    parser.flag("--mujoco", "time MuJoCo's mj_step beside it")
    parser.path("--against", "only compare ns a walker-step by turns", "CHECKOUT")
    parser.add_argument("--arch", choices=ARCHITECTURES, default="auto")
    options = parser.parse_args()
    options.lanes = lane_widths(options.lanes)
    if options.against and not (options.against / "taichi_nmm").is_dir():
        raise InputError("against", options.against, "the folder of a checkout of this project")
    return options


def lane_widths(listed: str) -> list[int]:
    """The comma-separated widths; none for an empty list."""
    try:
        widths = [int(width) for width in listed.split(",") if listed]
    except ValueError:
        widths = [0]
    if not all(1 <= width <= LARGEST_LANES for width in widths):
        raise InputError("lanes", listed, f"widths from 1 to {LARGEST_LANES}, such as 1,4,8,16")
    return widths


def measure(options: argparse.Namespace, cache: Path) -> Iterator[str]:
    """Lines on all that the options name, one measurement after the other."""
    samples, arch = options.samples, f"--arch {options.arch}"
    cold = worker("cold start", cache / "main", arch)
    run = worker("run", cache / "main", f"--walkers {samples} {SOBOL} {arch}")
    seconds, steps_per_s = run["run_s"], run["steps"] / run["run_s"]
    yield (f"machine        {os.cpu_count()} cores, {platform.system()} {platform.machine()};"
           f" {run['arch']}, {run['precision']}, {run['lanes']} lanes")  # fmt: skip
    yield f"cold start     {cold['start_s']:.1f} s (compiles)"
    yield f"warm start     {run['start_s']:.1f} s"
    yield (f"run            {samples:,} points x 5 s in {seconds:.1f} s,"
           f" {100 * run['alive'] / samples:.1f} % alive at the end")  # fmt: skip
    yield f"speed          {samples / seconds:,.0f} walkers/s, {steps_per_s:,.0f} walker-steps/s"
    yield f"peak memory    {run['peak_rss_mib']:,.0f} MiB"
    for name, reference_s in REFERENCES_S.items():
        ratio = samples / seconds * reference_s / REFERENCE_POINTS
        yield (f"{ratio:6.2f} x the speed of {name} ({reference_s:g} s for {REFERENCE_POINTS:,},"
               " on another 2-core machine)")  # fmt: skip
    few = min(samples, LANE_SAMPLES)
    if options.lanes:
        yield f"\n{few:,} points, CPU\nlanes  cold start s     run s  walkers/s   alive"
    for width in options.lanes:  # each from a cache of its own
        words = f"--walkers {few} {SOBOL} --arch cpu --lanes {width}"
        row = worker(f"{width} lanes", cache / f"lanes-{width}", words)
        yield (f"{width:5d}  {row['start_s']:12.1f}  {row['run_s']:8.2f}"
               f"  {few / row['run_s']:9,.0f}  {row['alive']:6d}")  # fmt: skip
    if options.threads:
        yield "\n400 walkers near the published gains x 10 s, CPU\nthreads     run s  faster"
        took = {}
        for count in sorted({1, os.cpu_count() or 1}):
            row = worker(f"{count} threads", cache / "main", f"{FEW} --threads {count}")
            took[count] = row["run_s"]
            yield f"{count:7d}  {took[count]:8.2f}  {took[1] / took[count]:6.2f} x"
    if options.mujoco:
        rollouts = str(min(samples, MUJOCO_ROLLOUTS))
        row = run_json("MuJoCo", ["-m", MUJOCO_MODULE, "--rollouts", rollouts], {})
        yield f"\nMuJoCo {row['version']}, mj_step of the same body, 14 muscles, contacts, 1 ms"
        for threads, name in (("1 thread", "single"), (f"{row['threads']} threads", "all")):
            theirs = row[f"steps_per_s_{name}"]
            yield f"{threads:14} {theirs:,.0f} steps/s; ours {steps_per_s / theirs:.1f} x"


def by_turns(options: argparse.Namespace, cache: Path) -> Iterator[str]:
    """CPU ns a walker-step of both checkouts, one measured after the other."""
    roots = {"this": ROOT, "other": options.against.resolve()}
    turns: Measured = {load: {name: [] for name in roots} for load in LOADS}
    for turn, (load, words), (name, root) in product(range(TURNS), LOADS.items(), roots.items()):
        what = f"turn {turn + 1} of {TURNS}, {load}, {name}"
        run = worker(what, cache / name, f"{words} --threads 1 --root", str(root))
        turns[load][name].append(1e9 * run["cpu_s"] / run["steps"])
    yield f"CPU ns a walker-step, one thread, median of {TURNS} turns: this, the other, ratio"
    for load, taken in turns.items():
        yield turns_line(load, **taken)


def turns_line(load: str, this: list[float], other: list[float]) -> str:
    """Medians of both checkouts, and of the ratio of their turns."""
    ratio = median(a / b for a, b in zip(this, other, strict=True))
    return f"{load:8} {median(this):7.1f}  {median(other):7.1f}  {ratio:.3f}"


def worker(what: str, cache: Path, words: str, *more: str) -> Measured:
    """A measurement by `bench_worker.py` with this cache of kernels."""
    command = [str(WORKER), *words.split(), *more]
    return run_json(what, command, {CACHE_VARIABLE: str(cache)})


def run_json(what: str, arguments: list[str], environment: dict[str, str]) -> Measured:
    """Run Python in a fresh process; its last line is the result."""
    print(f"measuring: {what}", file=sys.stderr, flush=True)
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise InputError("bench", what, f"a measurement that runs ({reason})")
    measured: Measured = json.loads(done.stdout.splitlines()[-1])
    return measured


if __name__ == "__main__":
    run_command(main)
