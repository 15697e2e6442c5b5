"""Search for the reference gait: 100 s on level ground at human speed, economical, human-looking.

    python tools/find_reference.py --seed 1 --out taichi_nmm/gains/reference.json

CMA-ES on the batch simulator, a population at a time, from K_T and from the best of a Sobol sweep.
The candidates then walk 100 s with finer steps and in float64; the cheapest that passes everywhere
is written. The same seed finds the same gait on the same machine. Exit codes: 0, 1 none found,
2 bad input, 130 interrupted.
"""

import argparse
import sys
import tempfile
from pathlib import Path

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import guarded_imports, run_command

with guarded_imports():
    import numpy as np
    from numpy.typing import NDArray

    import taichi_nmm
    from storage.commit import commit_json, writable
    from storage.sobol import sobol_gains
    from study.experiment.experiment import MOST_GENERATIONS
    from study.experiment.pycma import new_strategy
    from study.options import LARGEST_SEED, Options
    from study.pictures import human_ranges
    from study.pictures.strides import PERCENT, left_strides
    from taichi_nmm.body import GRAVITY_MPS2, SEGMENTS, Bodies
    from taichi_nmm.parameters import GAIN_NAMES, K_T, lower_bounds, upper_bounds
    from taichi_nmm.result import COMPLETED, HUMAN_SPEED_MPS
    from taichi_nmm.settings import ARCHITECTURES, Settings
    from taichi_nmm.terrain import flat, rough

Array = NDArray[np.float64]

SWEEP_POINTS = 4096  # a power of two, as Sobol points like it
SWEEP_S = 10.0
TRIAL_S = 12.0
RECORD_RATE_HZ = 50.0
WALK_S = 100.0
SPEED_TOLERANCE_MPS = 0.05
POPULATION = 32
START_SPREAD = 0.12  # of the range of each gain
GROUND_AMPLITUDE_M = 0.03
BODY_DISTURBANCE = 0.06

BODY_WEIGHT_N = GRAVITY_MPS2 * sum(segment.mass_kg for segment in SEGMENTS)
LOW, RANGE = lower_bounds(), upper_bounds() - lower_bounds()

# What a walker pays for looking unlike people: per standard deviation of the three joint angles
# over the stride, per degree of trunk lean and per metre of step outside what is usual.
JOINT_PRICE = 3.0
TRUNK_DEG, TRUNK_PRICE = (0.0, 8.0), 0.3
STEP_M, STEP_PRICE = (0.66, 0.76), 30.0
JOINTS = {
    "hip_flexion_deg": human_ranges.HIP_FLEXION_DEG,
    "knee_flexion_deg": human_ranges.KNEE_FLEXION_DEG,
    "dorsiflexion_deg": human_ranges.DORSIFLEXION_DEG,
}
NO_STRIDES_SD = 5.0  # paid by walkers of which no mean stride can be had

# Level ground and the nominal body, and mild disturbances of either: a gait with margins.
TERRAINS = (flat(), rough(101, GROUND_AMPLITUDE_M), rough(102, GROUND_AMPLITUDE_M))
TRIAL_TERRAINS = (0, 1, 2, 0, 0)
TRIAL_BODIES = (None, None, None, 201, 202)

CHECKS = (
    Settings(),
    Settings(physics_step_s=0.5e-3),
    Settings(physics_step_s=0.25e-3),
    Settings(precision="float64"),
)


def costs(gains: Array, arch: str) -> Array:
    """Cost of each row of gains, [n]: mean over the trials, and how strange the first one looks."""
    count, trials = len(gains), len(TRIAL_TERRAINS)
    result = taichi_nmm.simulate(
        np.repeat(gains, trials, axis=0),
        duration_s=TRIAL_S,
        bodies=trial_bodies().take(np.tile(np.arange(trials), count)),
        terrains=TERRAINS,
        terrain_index=np.tile(TRIAL_TERRAINS, count),
        settings=Settings(arch=arch),
        record=range(0, count * trials, trials),
        record_rate_hz=RECORD_RATE_HZ,
    )
    walking = taichi_nmm.walking_cost(result.rows).reshape(count, trials).mean(axis=1)
    looks = [unlikeness(trajectory) for trajectory in result.trajectories]
    return np.asarray(walking + habits(result.rows[::trials]) + JOINT_PRICE * np.array(looks))


def unlikeness(trajectory: taichi_nmm.Trajectory) -> float:
    """Root mean square of (model - human) / human sd over joints and stride."""
    strides = left_strides(trajectory, BODY_WEIGHT_N)
    if not strides.enough:
        return NO_STRIDES_SD
    deviations = []
    for name, human in JOINTS.items():
        mean, sd = human.at(PERCENT)
        deviations.append((getattr(strides, name).mean(axis=0) - mean) / sd)
    return float(np.sqrt(np.mean(np.square(deviations))))


def habits(rows: NDArray[np.void]) -> Array:
    """The price of trunk lean and step length, [n]."""
    lean = outside(np.rad2deg(rows["trunk_mean_rad"]), *TRUNK_DEG)
    return TRUNK_PRICE * lean + STEP_PRICE * outside(rows["step_length_mean_m"], *STEP_M)


def outside(value: Array, low: float, high: float) -> Array:
    """How far beyond the range, [n]."""
    return np.asarray(np.maximum(low - value, 0.0) + np.maximum(value - high, 0.0))


def trial_bodies() -> Bodies:
    """The body of each trial."""
    each = [
        Bodies.nominal() if seed is None else Bodies.disturbed([seed], BODY_DISTURBANCE)
        for seed in TRIAL_BODIES
    ]
    return Bodies(
        np.vstack([body.mass_kg for body in each]),
        np.vstack([body.inertia_kgm2 for body in each]),
        np.vstack([body.com_m for body in each]),
    )


def starts(seed: int, count: int, arch: str) -> Array:
    """K_T and the best of a Sobol sweep on level ground, in units of the ranges, [count, 16]."""
    points = sobol_gains(seed, 0, SWEEP_POINTS)
    rows = taichi_nmm.simulate(points, duration_s=SWEEP_S, settings=Settings(arch=arch)).rows
    best = np.argsort(taichi_nmm.walking_cost(rows) + habits(rows), kind="stable")
    return (np.vstack([K_T, points[best[: count - 1]]]) - LOW) / RANGE


def search(start: Array, seed: int, restart: int, generations: int, arch: str) -> Array:
    """The mean and the best of one run of CMA-ES as gains, [2, 16]."""
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(restart,)))
    strategy = new_strategy(start, START_SPREAD, generator, popsize=POPULATION, maxiter=generations)
    while not strategy.stop():
        asked = strategy.ask()
        strategy.tell(asked, costs(LOW + RANGE * np.array(asked), arch).tolist())
        say(f"search {restart}  generation {strategy.countiter:3d}  cost {strategy.best.f:.3f}")
    return LOW + RANGE * np.array([strategy.result.xfavorite, strategy.result.xbest])


def passes(gains: Array, arch: str) -> NDArray[np.bool_]:
    """Which rows walk 100 s at human speed with every step and precision, [n]."""
    good = np.ones(len(gains), dtype=bool)
    for check in CHECKS:
        settings = Settings(check.physics_step_s, precision=check.precision, arch=arch)
        rows = taichi_nmm.simulate(gains, duration_s=WALK_S, settings=settings).rows
        error = np.abs(rows["mean_speed_mps"] - HUMAN_SPEED_MPS)
        good &= (rows["end_reason"] == COMPLETED) & (error <= SPEED_TOLERANCE_MPS)
        say(
            f"step {1e3 * settings.physics_step_s:g} ms, {settings.precision}: "
            f"{np.round(rows['mean_speed_mps'], 3)} m/s for {np.round(rows['duration_s'])} s"
        )
    return good


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def parse() -> argparse.Namespace:
    parser = Options(__file__)
    parser.whole("--seed", 0, LARGEST_SEED, default=1, help="%(default)s")
    parser.whole("--restarts", 1, SWEEP_POINTS, default=4, help="searches (%(default)s)")
    parser.whole("--generations", 1, MOST_GENERATIONS, default=150, help="of each (%(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="JSON file of the gains")
    parser.add_argument("--arch", choices=ARCHITECTURES, default="auto")
    return parser.parse_args()


def main() -> None:
    args = parse()
    with writable(args.out):  # found out before the search, not after
        tempfile.TemporaryFile(dir=args.out.parent).close()
    found = np.vstack([
        search(start, args.seed, restart, args.generations, args.arch)
        for restart, start in enumerate(starts(args.seed, args.restarts, args.arch))
    ])  # fmt: skip
    found = found[np.argsort(costs(found, args.arch), kind="stable")]
    good = found[passes(found, args.arch)]
    if not len(good):
        say("no gait passed every check: try another seed or more generations")
        sys.exit(1)
    commit_json(args.out, dict(zip(GAIN_NAMES, good[0].tolist(), strict=True)))
    print(f"{args.out}: cost {costs(good[:1], args.arch)[0]:.3f}")


if __name__ == "__main__":
    run_command(main)
