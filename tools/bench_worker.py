"""One measurement of the simulator in one fresh process, printed as one JSON object.

`tools/bench.py` starts it: start-up and compilation can only be timed in a process that has
not imported anything, and the peak of memory belongs to a process.
"""

import argparse
import json
import resource
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Simulate = Callable[..., Any]  # taichi_nmm.simulate with its settings

SEED = 2016
TICK_S = 1e-3  # a step, by default
STEADY, SOBOL = "steady", "Sobol"  # what `--turns` measures
STEADY_WALKERS, STEADY_S, STEADY_SPREAD = 512, 3.0, 0.02
FEW_WALKERS, FEW_S, FEW_REPEATS = 400, 10.0, 5  # a round of a comparison
SOBOL_POINTS, SOBOL_S = 2048, 5.0
RUN_S = 5.0  # of the run of many samples
PUBLISHED = "K_T"  # the gait `published` by its name of 0.2.0, which --against may run


def main() -> None:
    options = parse()
    sys.path.insert(0, options.root)
    began_s = time.perf_counter()
    from taichi_nmm import Settings, load_gains, simulate

    if options.lanes is not None:
        from taichi_nmm.kernel import backend, registers

        backend.LANES_CPU = options.lanes
        registers.WIDTHS = dict.fromkeys(registers.WIDTHS, options.lanes)
    threads = 1 if options.turns else options.threads
    arch = "cpu" if threads else options.arch
    run = partial(simulate, settings=Settings(arch=arch, threads=threads))
    run(load_gains(PUBLISHED), duration_s=TICK_S)  # compiles
    start_s = time.perf_counter() - began_s
    if options.turns:
        take_turns(run)
    elif threads:
        print(json.dumps({"threads": threads, "run_s": few_walkers_s(run)}))
    else:
        measured = many_walkers(run, options.samples) if options.samples else {}
        print(json.dumps({"start_s": start_s, **measured, "peak_rss_mib": peak_rss_mib()}))


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="One measurement, for tools/bench.py")
    parser.add_argument("--samples", type=int, default=0, help="0 only starts up")
    parser.add_argument("--arch", default="auto")
    parser.add_argument("--root", default=str(Path(__file__).resolve().parents[1]))
    parser.add_argument("--turns", action="store_true", help="measure at every line of the input")
    parser.add_argument("--threads", type=int, help="only time few walkers on so many")
    parser.add_argument("--lanes", type=int, help="walkers side by side; default: the simulator's")
    return parser.parse_args()


def many_walkers(run: Simulate, samples: int) -> dict[str, object]:
    """Sobol points over the bounds, on flat ground, from gains to results."""
    from taichi_nmm.kernel import backend
    from taichi_nmm.result import COMPLETED

    gains = sobol_gains(samples)
    began_s = time.perf_counter()
    result = run(gains, duration_s=RUN_S)
    run_s = time.perf_counter() - began_s
    return {
        "duration_s": RUN_S,
        "run_s": run_s,
        "walker_steps_per_s": float(result["duration_s"].sum()) / TICK_S / run_s,
        "alive": int((result["end_reason"] == COMPLETED).sum()),
        "lanes": backend.lanes(),
        **result.metadata,
    }


def take_turns(run: Simulate) -> None:
    """For each line of the input, `STEADY` or `SOBOL`, print CPU ns a walker-step."""
    batches = {
        STEADY: (near_reference(STEADY_WALKERS), STEADY_S),
        SOBOL: (sobol_gains(SOBOL_POINTS), SOBOL_S),
    }
    print(flush=True)
    for line in sys.stdin:
        gains, duration_s = batches[line.strip()]
        began_s = time.process_time()
        result = run(gains, duration_s=duration_s)
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

    from taichi_nmm import load_gains

    spread = np.random.default_rng(SEED).uniform(-STEADY_SPREAD, STEADY_SPREAD, (walkers, 1))
    return load_gains(PUBLISHED) * (1.0 + spread)


def few_walkers_s(run: Simulate) -> float:
    """Seconds of `FEW_WALKERS` walkers, median of some runs."""
    gains, spent_s = near_reference(FEW_WALKERS), []
    for _ in range(FEW_REPEATS):
        began_s = time.perf_counter()
        run(gains, duration_s=FEW_S)
        spent_s.append(time.perf_counter() - began_s)
    return median(spent_s)


def peak_rss_mib() -> float:
    """Most memory this process has held."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


if __name__ == "__main__":
    main()
