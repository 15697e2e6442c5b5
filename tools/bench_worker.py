"""One measurement of the simulator in one fresh process, printed as one JSON object.

`tools/bench.py` starts it: start-up and compilation can only be timed in a process that has
not imported anything, and the peak of memory belongs to a process.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SEED = 2016
TICK_S = 1e-3
STEADY, SOBOL = "steady", "Sobol"  # what `--turns` measures
STEADY_WALKERS, STEADY_S, STEADY_SPREAD = 512, 3.0, 0.02
FEW_WALKERS, FEW_S, FEW_REPEATS = 400, 10.0, 5  # a round of a comparison
SOBOL_POINTS, SOBOL_S = 2048, 5.0
RUN_S = 5.0  # of the run of many samples


def main() -> None:
    options = parse()
    sys.path.insert(0, options.root)
    if options.turns:
        take_turns()
        return
    if options.threads:
        print(json.dumps({"threads": options.threads, "run_s": few_walkers_s(options.threads)}))
        return
    began = time.perf_counter()
    start_up(options)
    ready = time.perf_counter()
    measured = run(options) if options.samples else {}
    print(json.dumps({"start_s": ready - began, **measured, "peak_rss_mib": peak_rss_mib()}))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="One measurement, for tools/bench.py")
    parser.add_argument("--samples", type=int, default=0, help="0 only starts up")
    parser.add_argument("--arch", default="auto")
    parser.add_argument("--root", default=str(Path(__file__).resolve().parents[1]))
    parser.add_argument("--turns", action="store_true", help="measure at every line of the input")
    parser.add_argument("--threads", type=int, help="only time few walkers on so many")
    parser.add_argument("--lanes", type=int, help="walkers side by side; default: the simulator's")
    return parser.parse_args()


def start_up(options: argparse.Namespace) -> None:
    """Import, start the engine, compile: one tick of one walker."""
    from taichi_nmm import PUBLISHED_GAINS, Settings, simulate
    from taichi_nmm.kernel import backend

    if options.lanes is not None:
        backend.LANES_CPU = options.lanes
    simulate(PUBLISHED_GAINS, duration_s=TICK_S, settings=Settings(arch=options.arch))


def run(options: argparse.Namespace) -> dict[str, object]:
    """Sobol points over the bounds, on flat ground, from gains to results."""
    from taichi_nmm import Settings, simulate
    from taichi_nmm.kernel import backend
    from taichi_nmm.result import COMPLETED

    settings = Settings(arch=options.arch)
    gains = sobol_gains(options.samples)
    began = time.perf_counter()
    result = simulate(gains, duration_s=RUN_S, settings=settings)
    run_s = time.perf_counter() - began
    return {
        "samples": options.samples,
        "duration_s": RUN_S,
        "run_s": run_s,
        "walkers_per_s": options.samples / run_s,
        "walker_steps_per_s": float(result["duration_s"].sum()) / settings.physics_step_s / run_s,
        "alive": int((result["end_reason"] == COMPLETED).sum()),
        "lanes": backend.lanes(),
        **result.metadata,
    }


def take_turns() -> None:
    """For each line of the input, `STEADY` or `SOBOL`, print CPU ns a walker-step, one thread."""
    from taichi_nmm import PUBLISHED_GAINS, Settings, simulate

    batches = {
        STEADY: (near_reference(STEADY_WALKERS), STEADY_S),
        SOBOL: (sobol_gains(SOBOL_POINTS), SOBOL_S),
    }
    settings = Settings(arch="cpu", threads=1)
    simulate(PUBLISHED_GAINS, duration_s=TICK_S, settings=settings)
    print(flush=True)
    for line in sys.stdin:
        gains, duration_s = batches[line.strip()]
        began_s = time.process_time()
        result = simulate(gains, duration_s=duration_s, settings=settings)
        spent_s = time.process_time() - began_s
        print(1e9 * spent_s * TICK_S / result["duration_s"].sum(), flush=True)


def sobol_gains(walkers: int) -> "NDArray[np.float64]":
    """The first points of a store with this seed, [walkers, 16], of any version of this project."""
    import numpy as np
    from scipy.stats import qmc

    from taichi_nmm.parameters import lower_bounds, upper_bounds

    stream = np.random.SeedSequence(SEED, spawn_key=(100, 0))
    unit = qmc.Sobol(d=len(lower_bounds()), rng=np.random.default_rng(stream)).random(walkers)
    gains: NDArray[np.float64] = lower_bounds() + unit * (upper_bounds() - lower_bounds())
    return gains


def near_reference(walkers: int) -> "NDArray[np.float64]":
    """Gains near the published gains, all of which walk, [walkers, 16]."""
    import numpy as np

    from taichi_nmm import PUBLISHED_GAINS

    spread = np.random.default_rng(SEED).uniform(-STEADY_SPREAD, STEADY_SPREAD, (walkers, 1))
    return PUBLISHED_GAINS * (1.0 + spread)


def few_walkers_s(threads: int) -> float:
    """Seconds of `FEW_WALKERS` walkers on the CPU, median of some runs."""
    from taichi_nmm import PUBLISHED_GAINS, Settings, simulate

    settings = Settings(arch="cpu", threads=threads)
    simulate(PUBLISHED_GAINS, duration_s=TICK_S, settings=settings)
    gains, spent_s = near_reference(FEW_WALKERS), []
    for _ in range(FEW_REPEATS):
        began_s = time.perf_counter()
        simulate(gains, duration_s=FEW_S, settings=settings)
        spent_s.append(time.perf_counter() - began_s)
    return median(spent_s)


def peak_rss_mib() -> float | None:
    """Most memory this process has held; None where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


if __name__ == "__main__":
    main()
