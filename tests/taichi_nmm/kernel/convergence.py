"""How far the fibre's speed converges, over states met in walking; float64, interpreted by NumPy.

    python -m tests.taichi_nmm.kernel.convergence

prints a row for each number of iterations of the walker's own method and of others: errors of the
speed over the states of 256 Sobol gains, and how far the walkers are after a second from those of
the converged muscle. Some minutes.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.points import sobol_points
from taichi_nmm import terrain
from taichi_nmm.initial import initial_rows
from taichi_nmm.kernel.layout import FIRST_DELAY, FIRST_EVENT, FIRST_FIBRE, State, Sums, Work
from taichi_nmm.kernel.muscle_table import muscle_table
from taichi_nmm.parameters import GAINS as PARAMETERS
from taichi_nmm.settings import Settings
from taichi_nmm.walkers import blends, check_batch, constant_rows
from tests.parity.interpreter import AllLanes, interpreted_walker

GAINS = 256
SEED = 2016  # of the Sobol points
SAMPLED_TICKS = 20  # a state is recorded so often
CONVERGED = 8  # iterations
TOLERANCE = 1e-6  # of a speed over vmax
SLOWEST, FASTEST = -1.0, 3.0
N, K = 1.5, 5.0  # Geyer & Herr 2010

Array = NDArray[np.float64]
Problem = list[Array]  # arguments of `muscle.speed_range`

# Other steps from a speed: from excess tension e, half its fall h, half its curvature q, and that
# half with the tendon's tangent in the tendon's place.
METHODS: dict[str, Callable[[Array, Array, Array, Array], Array]] = {
    "Newton": lambda e, h, q, tangent: e / (2 * h),
    "Halley": lambda e, h, q, tangent: 2 * e * h / (4 * h * h - e * q),
    "tangent against hyperbola": lambda e, h, q, tangent: (
        e / (h + np.sqrt(np.maximum(h * h - tangent * e, 0.0)))
    ),
}


def walk(walker: Any, ticks: int) -> Iterator[Array]:
    """State rows of the interpreted walkers after each tick of 1 ms on flat ground."""
    flat, step_s = terrain.flat(), 1e-3
    batch = check_batch(sobol_points(SEED, 0, GAINS, PARAMETERS))
    start = np.tile(initial_rows(flat)[:, None], GAINS)
    blocks = np.split(start, [FIRST_FIBRE, FIRST_DELAY, FIRST_EVENT])
    const = constant_rows(batch, Settings()).T
    sums, work = np.zeros((Sums.count, GAINS)), np.zeros((Work.count, GAINS))
    for tick in range(ticks):
        with np.errstate(all="ignore"):
            walker.step(
                tick, 1, step_s, *blends(step_s), 0, AllLanes(GAINS), batch.terrain_index,
                flat.height_m[None, :], muscle_table(step_s), *blocks, sums, const, work,
            )  # fmt: skip
        yield blocks[0]


def walking_states(ticks: int) -> Problem:
    """Arguments of `speed_range` met in `ticks` of walking, of all muscles that are up."""
    walker = interpreted_walker()
    muscle = walker.muscle
    muscle.ITERATIONS = CONVERGED
    find_range, met, recorded = muscle.speed_range, [], []

    def recording(*arguments: Any) -> Any:
        met.append(np.array(np.broadcast_arrays(*arguments)))
        return find_range(*arguments)

    muscle.speed_range = recording
    for tick, state in enumerate(walk(walker, ticks)):
        if tick % SAMPLED_TICKS == SAMPLED_TICKS - 1:
            up = state[State.active] > 0.5
            recorded += [arguments[:, up] for arguments in met]
        met.clear()
    return list(np.concatenate(recorded, axis=1))


def exact_speed(problem: Problem) -> Array:
    """The balance by bisection of the equation as published."""
    _start, strain, strain_rate, squeeze, squeeze_rate, capacity = problem
    low, high = np.full_like(strain, SLOWEST), np.full_like(strain, FASTEST)
    for _ in range(60):
        v = 0.5 * (low + high)
        tendon = np.maximum(strain - strain_rate * v, 0.0)
        buffer = np.maximum(squeeze - squeeze_rate * v, 0.0)
        pulls = tendon**2 + buffer**2 > capacity * force_velocity(v)
        low, high = np.where(pulls, v, low), np.where(pulls, high, v)
    return 0.5 * (low + high)


def force_velocity(v: Array) -> Array:
    """Hill's curve as published, and the line beyond v = 1; lengthening positive."""
    with np.errstate(divide="ignore"):
        shortening = (1 + v) / (1 - K * v)
        lengthening = N + (N - 1) * (v - 1) / (1 + 7.56 * K * v)
    return np.where(v < 0, shortening, np.where(v < 1, lengthening, N + 100.0 * (v - 1)))


def fibre_speed(muscle: Any, problem: Problem, iterations: int) -> Array:
    """What the iterations of an interpreted module `muscle` find."""
    _start, *springs, _capacity = problem
    v, *fibre = muscle.speed_range(*problem)
    for _ in range(iterations):
        v = muscle.nearer(v, *fibre, *springs)
    return np.asarray(v)


def take_another(muscle: Any, method: str) -> None:
    """Let an interpreted module `muscle` iterate by one of `METHODS`."""

    def nearer(v: Array, low: Array, high: Array, pull: Array, slope: Array, c: Array,
               *springs: Array) -> Array:  # fmt: skip
        force, half_fall, bend = muscle.tension(v, *springs)
        excess = force * (1 + c * v) - (pull + slope * v)
        half_slope = half_fall * (1 + c * v) + (slope - c * force) / 2
        tangent = -2 * c * half_fall
        step = METHODS[method](excess, half_slope, bend * (1 + c * v) + tangent, tangent)
        return np.minimum(np.maximum(v + step, low), high)

    muscle.nearer = nearer


def errors(problem: Problem, iterations: int, method: str | None = None) -> Array:
    """Of the speed that so many iterations find, by the walker's own source or another method."""
    muscle = interpreted_walker().muscle
    if method is not None:
        take_another(muscle, method)
    with np.errstate(all="ignore"):
        return np.abs(fibre_speed(muscle, problem, iterations) - exact_speed(problem))


def place_after_1_s(iterations: int, method: str | None = None) -> Array:
    """Where the hips are after a second, m; NaN where a walker fell."""
    walker = interpreted_walker()
    walker.muscle.ITERATIONS = iterations
    if method is not None:
        take_another(walker.muscle, method)
    *_, state = walk(walker, 1000)
    return np.where(state[State.active] > 0.5, state[State.q], np.nan)


def main() -> None:
    problem, converged = walking_states(2000), place_after_1_s(CONVERGED)
    print(f"{len(problem[0]):,} states of {GAINS} Sobol gains, 2 s")
    print("| method | iterations | over 1e-6 | 99.9 % below | worst | after 1 s: worst, median m |")
    print("|---|---|---|---|---|---|")
    tried = [(None, n) for n in (1, 2, 3, 4)] + [(name, n) for name in METHODS for n in (3, 4, 6)]
    for method, iterations in tried:
        error = errors(problem, iterations, method)
        off = np.abs(place_after_1_s(iterations, method) - converged)
        print(
            f"| {method or 'ours'} | {iterations} | {100 * np.mean(error > TOLERANCE):.3f} % |"
            f" {np.quantile(error, 0.999):.1e} | {error.max():.1e} |"
            f" {np.nanmax(off):.1e}, {np.nanmedian(off):.1e} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
