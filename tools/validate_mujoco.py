"""Measure MuJoCo as the engine of a walk against the figures it must show, as a Markdown table.

Standing load, the two known gaits, agreement with our own engine over the search space and of
MuJoCo with itself at half the step. Needs the package mujoco. About ten minutes for 1,000 points.
Exit codes: 0, 2 bad input, 130 interrupted.
"""

from collections.abc import Iterator

from checkout import guarded_imports, run_command

with guarded_imports():
    import numpy as np
    from numpy.typing import NDArray

    import taichi_nmm
    from storage.points import sobol_points
    from study.commands.validate import Figure, show
    from study.experiment.trials import walked
    from study.options import LARGEST_SEED, Options
    from taichi_nmm import GAINS, PUBLISHED_GAINS, Settings, load_gains
    from taichi_nmm.walker_simulator import require_engine

LONG_S = 100.0
MOST_SAMPLES = 100_000
ALIVE_S = 5.0
OURS = Settings()
MUJOCO = Settings(engine="mujoco")
HALF_STEP = Settings(engine="mujoco", physics_step_s=0.5e-3)
BATCH = 250  # Sobol points at once


def main() -> None:
    parser = Options(__file__)
    parser.whole("--samples", 1, MOST_SAMPLES, default=1000, help="(%(default)s)")
    parser.whole("--seed", 0, LARGEST_SEED, default=2016, help="of the Sobol points (%(default)s)")
    parser.declare({"like": "json", "help": "print one list of objects"})
    options = parser.parse_args()
    require_engine(MUJOCO)
    how = f"{options.samples} Sobol points, MuJoCo's default contact, 1 ms"
    show(measure(options.samples, options.seed), how, options.json)


def measure(samples: int, seed: int) -> Iterator[Figure]:
    yield from known_gaits()
    gains = sobol_points(seed, 0, samples, GAINS)
    ours, mujoco, half = (verdicts(gains, settings) for settings in (OURS, MUJOCO, HALF_STEP))
    yield Figure("alive at 5 s", share(mujoco[0]), unit="%")
    yield Figure("walk 100 s", share(mujoco[1]), unit="%")
    yield Figure(
        "same verdict 'walks 100 s' as our engine", share(mujoco[1] == ours[1]), 93, 100, "%"
    )
    for name, one, other in zip(("alive at 5 s", "walks 100 s"), mujoco, half, strict=True):
        yield Figure(f"same verdict '{name}' at 1 and 0.5 ms", share(one == other), unit="%")


def known_gaits() -> Iterator[Figure]:
    gaits = np.array([PUBLISHED_GAINS, load_gains("reference")])
    rows = taichi_nmm.simulate(gaits, duration_s=LONG_S, settings=MUJOCO).rows
    for row, name, (low, high) in zip(
        rows, ("published", "reference"), ((1.37, 1.43), (1.23, 1.31)), strict=True
    ):
        yield Figure(f"{name}, level ground: walked", row["duration_s"], LONG_S, LONG_S, "s")
        yield Figure(f"{name}: mean speed", row["mean_speed_mps"], low, high, "m/s")
        load = row["grf_vertical_mean_bw"]
        yield Figure(f"{name}: mean vertical ground force", load, 0.998, 1.002, "BW")


def verdicts(
    gains: NDArray[np.float64], settings: Settings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether each point is alive at 5 s, and whether it walks 100 s."""
    parts = [
        taichi_nmm.simulate(gains[first : first + BATCH], duration_s=LONG_S, settings=settings).rows
        for first in range(0, len(gains), BATCH)
    ]
    rows = np.concatenate(parts)
    return rows["duration_s"] >= ALIVE_S, walked(rows)


def share(which: NDArray[np.bool_]) -> float:
    return 100.0 * float(np.mean(which))


if __name__ == "__main__":
    run_command(main)
