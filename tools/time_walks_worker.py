"""One measurement of the simulator in one fresh process, printed as one JSON object.

`tools/time_walks.py` starts it: start-up and compilation can only be timed in a process
that has not imported anything, and the peak of memory belongs to a process. Its one
word has the arguments of `main` as JSON.
"""

import json
import resource
import sys
import time
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

ROOT = str(Path(__file__).resolve().parents[1])
SEED = 2016
TICK_S = 1e-3  # a step, by default
STEADY_SPREAD = 0.02
PUBLISHED = "published"


def main(
    walkers: int = 0,
    duration_s: float = TICK_S,
    steady: bool = False,
    repeats: int = 1,
    arch: str = "auto",
    root: str = ROOT,
    threads: int | None = None,
) -> None:
    """Start a checkout; let walkers near the published gains (`steady`) or of a store walk."""
    sys.path.insert(0, root)
    began_s = time.perf_counter()
    from taichi_nmm import Settings, load_gains, simulate

    arch = "cpu" if threads else arch
    run = partial(simulate, settings=Settings(arch=arch, threads=threads))
    run(load_gains(PUBLISHED), duration_s=TICK_S)  # compiles
    measured: dict[str, object] = {"start_s": time.perf_counter() - began_s}
    if walkers:
        from taichi_nmm.kernel import backend
        from taichi_nmm.result import COMPLETED

        gains, took = (near_published if steady else anywhere)(walkers), []
        for _ in range(repeats):
            began = time.perf_counter(), time.process_time()
            result = run(gains, duration_s=duration_s)
            took.append(
                (time.perf_counter() - began[0], time.process_time() - began[1])
            )
        measured |= result.metadata | {
            "run_s": median(wall_s for wall_s, _ in took),
            "cpu_s": median(cpu_s for _, cpu_s in took),
            "steps": float(result["duration_s"].sum()) / TICK_S,  # of all walkers
            "alive": int((result["end_reason"] == COMPLETED).sum()),
            "lanes": backend.lanes(),
        }
    print(json.dumps(measured | {"peak_rss_mib": peak_rss_mib()}))


def anywhere(walkers: int) -> "NDArray[np.float64]":
    """Gains over the search space, [walkers, 16]."""
    import numpy as np

    from taichi_nmm.parameters import lower_bounds, upper_bounds

    rng = np.random.default_rng(SEED)
    return rng.uniform(lower_bounds(), upper_bounds(), (walkers, len(lower_bounds())))


def near_published(walkers: int) -> "NDArray[np.float64]":
    """Gains near the published gains, all of which walk, [walkers, 16]."""
    import numpy as np

    from taichi_nmm import load_gains

    spread = np.random.default_rng(SEED).uniform(
        -STEADY_SPREAD, STEADY_SPREAD, (walkers, 1)
    )
    return load_gains(PUBLISHED) * (1.0 + spread)


def peak_rss_mib() -> float:
    """Most memory this process has held."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


if __name__ == "__main__":
    main(**json.loads(sys.argv[1]))
