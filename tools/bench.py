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
# 512 walkers near the published gains, 3 s; 2,048 Sobol points, 5 s, packs compacted.
LOADS = ("steady", "Sobol")
TURNS = 7

# Seconds for 100,000 points x 5 s, as measured on another 2-core machine (AVX-512).
REFERENCE_POINTS = 100_000
REFERENCES_S = {"scalar C, float64": 234.0, "hand-written AVX-512, float32": 14.9}

Measured = dict[str, Any]


def main() -> None:
    options = parse()
    with tempfile.TemporaryDirectory() as cache:
        if options.against:
            measured = by_turns(options.against, Path(cache))
        else:
            measured = measure(options, Path(cache))
    said = turns_text if options.against else text
    print(json.dumps(measured) if options.json else said(measured))


def parse() -> argparse.Namespace:
    parser = Options(__file__)
    parser.whole("--samples", 1, MOST_SAMPLES, default=100_000, help="%(default)s")
    parser.add_argument("--lanes", default="", metavar="1,4,8,16", help="compare widths on the CPU")
    parser.add_argument("--threads", action="store_true", help="few walkers on one thread, on all")
    parser.add_argument("--mujoco", action="store_true", help="time MuJoCo's mj_step beside it")
    parser.path("--against", "only compare ns a walker-step by turns", "CHECKOUT")
    parser.add_argument("--arch", choices=ARCHITECTURES, default="auto")
    parser.add_argument("--json", action="store_true", help="print one object")
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


def measure(options: argparse.Namespace, cache: Path) -> Measured:
    """All measurements that the options name, one after the other."""
    arch = ["--arch", options.arch]
    cold = worker("cold start", cache / "main", "--samples", "0", *arch)
    run = worker("run", cache / "main", "--samples", str(options.samples), *arch)
    report: Measured = {
        "machine": {"cores": os.cpu_count(), "system": f"{platform.system()} {platform.machine()}"},
        "cold_start_s": cold["start_s"],
        "warm_start_s": run.pop("start_s"),
        "run": run,
        "times_reference_speed": {
            name: run["walkers_per_s"] * seconds / REFERENCE_POINTS
            for name, seconds in REFERENCES_S.items()
        },
    }
    if options.lanes:
        samples = ("--samples", str(min(options.samples, LANE_SAMPLES)))
        report["lanes"] = [  # each from a cache of its own
            worker(f"{width} lanes", cache / f"lanes-{width}", *samples,
                   "--arch", "cpu", "--lanes", str(width))
            for width in options.lanes
        ]  # fmt: skip
    if options.threads:
        counts = sorted({1, os.cpu_count() or 1})
        report["threads"] = [
            worker(f"{count} threads", cache / "main", "--threads", str(count)) for count in counts
        ]
    if options.mujoco:
        rollouts = str(min(options.samples, MUJOCO_ROLLOUTS))
        row = run_json("MuJoCo", ["-m", MUJOCO_MODULE, "--rollouts", rollouts], {})
        ratios = {
            f"ratio_to_{name}": run["walker_steps_per_s"] / row[f"steps_per_s_{name}"]
            for name in ("single", "all")
        }
        report["mujoco"] = row | ratios
    return report


def worker(what: str, cache: Path, *arguments: str) -> Measured:
    """A measurement by `bench_worker.py` with this cache of kernels."""
    return run_json(what, [str(WORKER), *arguments], {CACHE_VARIABLE: str(cache)})


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


def by_turns(other: Path, cache: Path) -> Measured:
    """CPU ns a walker-step of both checkouts, [turn]: each waits while the other is measured."""
    roots = {"this": ROOT, "other": other.resolve()}
    print("compiling both", file=sys.stderr, flush=True)
    workers = {name: turn_taker(root, cache / name) for name, root in roots.items()}
    turns: Measured = {load: {name: [] for name in roots} for load in LOADS}
    for turn in range(TURNS):
        print(f"turn {turn + 1} of {TURNS}", file=sys.stderr, flush=True)
        for load in LOADS:
            for name, process in workers.items():
                turns[load][name].append(float(answer(process, load)))
    for process in workers.values():
        process.communicate()
    return turns


def turn_taker(root: Path, cache: Path) -> "subprocess.Popen[str]":
    """A process that measures the simulator under `root`, ready to."""
    process = subprocess.Popen(
        [sys.executable, str(WORKER), "--arch", "cpu", "--turns", "--root", str(root)],
        cwd=root,
        env={**os.environ, CACHE_VARIABLE: str(cache), "PYTHONPATH": str(root)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    answer(process, "")
    return process


def answer(process: "subprocess.Popen[str]", load: str) -> str:
    """Send `load` to a turn-taker, and return the next line that it prints."""
    assert process.stdin is not None and process.stdout is not None
    if load:
        process.stdin.write(f"{load}\n")
        process.stdin.flush()
    line = process.stdout.readline()
    if not line:
        raise InputError("against", process.args, "a checkout whose simulator runs")
    return line


def turns_text(turns: Measured) -> str:
    lines = [f"CPU ns a walker-step, one thread, median of {TURNS} turns: this, the other, ratio"]
    for load, taken in turns.items():
        ratio = median(a / b for a, b in zip(taken["this"], taken["other"], strict=True))
        this, other = median(taken["this"]), median(taken["other"])
        lines.append(f"{load:8} {this:7.1f}  {other:7.1f}  {ratio:.3f}")
    return "\n".join(lines)


def text(report: Measured) -> str:
    """The report as paragraphs for people."""
    run, machine = report["run"], report["machine"]
    lines = [
        f"machine        {machine['cores']} cores, {machine['system']}; {run['arch']},"
        f" {run['precision']}, {run['lanes']} lanes",
        f"cold start     {report['cold_start_s']:.1f} s (compiles)",
        f"warm start     {report['warm_start_s']:.1f} s",
        f"run            {run['samples']:,} points x {run['duration_s']:g} s in"
        f" {run['run_s']:.1f} s, {100 * run['alive'] / run['samples']:.1f} % alive at the end",
        f"speed          {run['walkers_per_s']:,.0f} walkers/s,"
        f" {run['walker_steps_per_s']:,.0f} walker-steps/s",
        f"peak memory    {run['peak_rss_mib']:,.0f} MiB",
    ]
    for name, ratio in report["times_reference_speed"].items():
        lines.append(
            f"{ratio:6.2f} x the speed of {name}"
            f" ({REFERENCES_S[name]:g} s for {REFERENCE_POINTS:,}, on another 2-core machine)"
        )
    if rows := report.get("lanes"):
        head = "lanes  cold start s     run s  walkers/s   alive"
        lines += ["", f"{rows[0]['samples']:,} points, CPU", head]
        for row in rows:
            lines.append(
                f"{row['lanes']:5d}  {row['start_s']:12.1f}  {row['run_s']:8.2f}"
                f"  {row['walkers_per_s']:9,.0f}  {row['alive']:6d}"
            )
    if rows := report.get("threads"):
        lines += [
            "",
            "400 walkers near the published gains x 10 s, CPU",
            "threads     run s  faster",
        ]
        for row in rows:
            faster = rows[0]["run_s"] / row["run_s"]
            lines.append(f"{row['threads']:7d}  {row['run_s']:8.2f}  {faster:6.2f} x")
    if row := report.get("mujoco"):
        lines += [
            "",
            f"MuJoCo {row['version']}, mj_step of the same body, 14 muscles, contacts, 1 ms",
            f"1 thread       {row['steps_per_s_single']:,.0f} steps/s;"
            f" ours {row['ratio_to_single']:.1f} x",
            f"{row['threads']} threads      {row['steps_per_s_all']:,.0f} steps/s;"
            f" ours {row['ratio_to_all']:.1f} x",
        ]
    return "\n".join(lines)


if __name__ == "__main__":
    run_command(main)
