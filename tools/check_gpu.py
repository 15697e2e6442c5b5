"""What a GPU does: its speed, beside this machine's processor, and whether its results hold.

    python tools/check_gpu.py --out out/gpu.txt
    python tools/check_gpu.py --parts speed bits

Each part runs in a process of its own with a limit of time: a part that fails loses no
other one. All parts take five minutes on an NVIDIA H200. The exit code is 1 where a part
fails, or a result does not hold, and 2 without a GPU.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from checkout import guarded_imports, run_command

with guarded_imports():
    from storage.inputs.errors import InputError
    from study.options import Options
    from taichi_nmm.kernel_cache import CACHE_VARIABLE
    from tools.time_walks_worker import anywhere, near_published

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from taichi_nmm import Result, Settings

ROOT = Path(__file__).resolve().parents[1]
SEARCH_S, STEADY_S = 5.0, 3.0
TICKS_PER_S = 1000
REPEATS = 3
BATCHES = (64, 256, 1024, 4096, 16384)
COMPARED = 20_000  # walkers on both
COMPANY = 3000


def main() -> None:
    parser = Options(__file__)
    parser.path("--out", "file that gets the lines as they come", "FILE")
    parser.add_argument("--parts", nargs="*", choices=PARTS, default=list(PARTS))
    parser.add_argument("--part", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part:
        PARTS[options.part][0]()
        return
    require_gpu()
    holds = True
    with tempfile.TemporaryDirectory() as folder:
        for name in options.parts:
            for line in lines_of(name, Path(folder)):
                holds &= not line.startswith("FAILED") and not line.endswith(": False")
                print(f"{name:9} {line}", flush=True)
                if options.out:
                    with options.out.open("a", encoding="utf-8") as file:
                        file.write(f"{name:9} {line}\n")
    sys.exit(not holds)


def require_gpu() -> None:
    """Refuse a machine without a GPU.

    Raises:
        InputError: it has none.
    """
    code = (
        "from taichi_nmm.walker_simulator import *; started_arch(Settings(arch='cuda'))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True)
    if done.returncode:
        raise InputError("check_gpu", "no GPU", "a machine with a GPU of CUDA")


def lines_of(name: str, folder: Path) -> list[str]:
    """What a part prints, and how it ended if not well; kernels are kept in the folder."""
    limit_s = PARTS[name][1]
    began_s = time.perf_counter()
    environment = {**os.environ, CACHE_VARIABLE: str(folder / "kernels")}
    command = [sys.executable, __file__, "--part", name]
    with (folder / name).open("w+", encoding="utf-8") as out:
        try:
            done = subprocess.run(
                command,
                cwd=folder,
                env=environment,
                stdout=out,
                stderr=subprocess.STDOUT,
                timeout=limit_s,
            )
            code = done.returncode
        except subprocess.TimeoutExpired:
            code = -1
        out.seek(0)
        lines = [line for line in out.read().splitlines() if line.startswith("= ")]
        out.seek(0)
        last = (out.read().splitlines() or ["nothing"])[-1]
    found = [line[2:] for line in lines]
    if code:
        reason = f"over {limit_s} s" if code < 0 else last[-200:]
        found.append(f"FAILED: {reason}")
    return [*found, f"({time.perf_counter() - began_s:.0f} s in all)"]


def say(line: str) -> None:
    """A line of the report; others may print as well."""
    print(f"= {line}", flush=True)


def settings(arch: str = "cuda", **words: Any) -> "Settings":
    """Of a simulation on one of both."""
    from taichi_nmm import Settings

    return Settings(arch=arch, **words)


def walked(
    gains: "NDArray[np.float64]", duration_s: float, **words: Any
) -> tuple["Result", float]:
    """A simulation and its seconds, end to end."""
    from taichi_nmm import simulate

    began_s = time.perf_counter()
    result = simulate(gains, duration_s=duration_s, **words)
    return result, time.perf_counter() - began_s


def speed_line(what: str, result: "Result", seconds: float) -> str:
    """Seconds, and million walker-steps a second of walkers that are up."""
    steps = float(result["duration_s"].sum()) * TICKS_PER_S
    return (
        f"{what}: {seconds:.3f} s, {steps / seconds / 1e6:.1f} million walker-steps/s"
    )


def start() -> None:
    """A first walk without kernels, and with them."""
    code = (
        "import time; began = time.perf_counter()\n"
        "from taichi_nmm import Settings, load_gains, simulate\n"
        "simulate(load_gains('published'), duration_s=0.001, settings=Settings(arch='cuda'))\n"
        "print(time.perf_counter() - began)"
    )
    for what in ("cold", "warm"):
        done = subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            capture_output=True,
            text=True,
            check=True,
        )
        say(f"{what} start, until a first walk: {float(done.stdout.split()[-1]):.1f} s")


def speed() -> None:
    """The three loads of docs/speed.md, end to end."""
    loads = {
        "search space, 400,000 x 5 s": (anywhere(400_000), SEARCH_S),
        "steady, 131,072 x 3 s": (near_published(131_072), STEADY_S),
        "100,000 x 5 s": (anywhere(100_000), SEARCH_S),
    }
    walked(anywhere(64), 0.001, settings=settings())
    for what, (gains, duration_s) in loads.items():
        for _ in range(REPEATS):
            found = walked(gains, duration_s, settings=settings())
            say(speed_line(what, *found))


def batches() -> None:
    """From which batch on a GPU is faster than all cores."""
    for arch in ("cuda", "cpu"):
        walked(anywhere(64), 0.001, settings=settings(arch))
        for walkers in BATCHES:
            took = [
                walked(anywhere(walkers), SEARCH_S, settings=settings(arch))[1]
                for _ in range(REPEATS)
            ]
            say(f"{walkers} walkers x 5 s, {arch}: {sorted(took)[1]:.3f} s")


def bits() -> None:
    """Order, size, company, interruption and recording change no bit."""
    import numpy as np

    from taichi_nmm import Bodies, Worlds, queue

    gains = anywhere(COMPANY)
    whole, _ = walked(gains, SEARCH_S, settings=settings())
    order = np.random.default_rng(1).permutation(COMPANY)
    permuted, _ = walked(gains[order], SEARCH_S, settings=settings())
    say(f"order: {permuted.rows.tobytes() == whole.rows[order].tobytes()}")
    many, _ = walked(np.tile(gains, (30, 1)), SEARCH_S, settings=settings())
    same = many.rows.tobytes() == np.tile(whole.rows, 30).tobytes()
    say(f"batch 30 times as large: {same}")
    alone, _ = walked(gains[7], SEARCH_S, settings=settings())
    say(f"batch of one: {alone.rows.tobytes() == whole.rows[[7]].tobytes()}")
    half = COMPANY // 2
    limp = np.ones((half, 14))
    limp[:, 3] = 0.9
    nominal = Worlds.nominal(half)
    other = Worlds(**{**vars(nominal), "optimal_length": limp, "strength": limp})
    mixed, _ = walked(
        gains,
        SEARCH_S,
        bodies=Bodies.stacked([Bodies.nominal(half), Bodies.disturbed(range(half))]),
        worlds=Worlds.stacked([nominal, other]),
        settings=settings(),
    )
    say(f"company: {mixed.rows[:half].tobytes() == whole.rows[:half].tobytes()}")
    recorded, _ = walked(gains, SEARCH_S, record=[3], settings=settings())
    say(f"recording: {recorded.rows.tobytes() == whole.rows.tobytes()}")
    queue.LAUNCH_TICKS = 130
    cut, _ = walked(gains, SEARCH_S, settings=settings())
    say(f"launches of 130 ticks: {cut.rows.tobytes() == whole.rows.tobytes()}")


def verdicts() -> None:
    """How many walks end alike on both, in float32; and over 500 steps in float64."""
    import numpy as np

    gains = anywhere(COMPARED)
    gpu, gpu_s = walked(gains, SEARCH_S, settings=settings())
    cpu, cpu_s = walked(gains, SEARCH_S, settings=settings("cpu"))
    alike = np.mean(gpu["end_reason"] == cpu["end_reason"])
    say(f"end alike, of {COMPARED} x 5 s: {100 * alike:.2f} %")
    say(
        f"alive: GPU {np.mean(gpu['end_reason'] == 0):.4f}, CPU "
        f"{np.mean(cpu['end_reason'] == 0):.4f}; {gpu_s:.2f} and {cpu_s:.2f} s, first runs"
    )
    test = str(ROOT / "tests/parity/test_gpu.py")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", test],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    summary = done.stdout.strip().splitlines()[-1]
    say(f"tests/parity/test_gpu.py: {summary}")
    say(f"float64 over 500 steps: {not done.returncode and 'skipped' not in summary}")


def million() -> None:
    """One million walkers: time, and the host's memory."""
    walked(anywhere(64), 0.001, settings=settings())
    say(
        speed_line(
            "1,000,000 x 5 s",
            *walked(anywhere(1_000_000), SEARCH_S, settings=settings()),
        )
    )
    import resource  # of POSIX

    peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    say(f"the host's memory at the peak: {peak_gb:.2f} GiB")


def store(config: str, arch: str, limit_s: float, *words: str) -> None:
    """A store of a configuration: seconds, or how far it came."""
    tool = ROOT / "tools" / "precompute.py"
    out = f"{config}-{arch}"
    command = [
        sys.executable,
        str(tool),
        "--config",
        config,
        "--out",
        out,
        "--arch",
        arch,
    ]
    began_s = time.perf_counter()
    with Path(f"{out}.txt").open("w+", encoding="utf-8") as said:
        with suppress(subprocess.TimeoutExpired):
            subprocess.run(
                [*command, *words], stdout=said, stderr=said, timeout=limit_s
            )
        seconds = time.perf_counter() - began_s
        said.seek(0)
        last = said.read().replace("\r", "\n").strip().splitlines()[-4:]
    say(
        f"{config} on {arch}: {seconds:.1f} s, limit {limit_s:g}; {' | '.join(last)[-300:]}"
    )


def stores() -> None:
    """`precompute --config store` on both."""
    for arch in ("cuda", "cpu"):
        store("store", arch, 60.0)


def worlds() -> None:
    """`precompute --config store-worlds` on both, as far as it comes."""
    for arch in ("cuda", "cpu"):
        store("store-worlds", arch, 25.0)


PARTS: dict[str, tuple[Callable[[], None], float]] = {
    "start": (start, 100.0),
    "speed": (speed, 60.0),
    "bits": (bits, 60.0),
    "verdicts": (verdicts, 200.0),
    "million": (million, 40.0),
    "batches": (batches, 40.0),
    "stores": (stores, 130.0),
    "worlds": (worlds, 60.0),
}


if __name__ == "__main__":
    run_command(main)
