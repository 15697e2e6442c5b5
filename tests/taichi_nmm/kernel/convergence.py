"""How far the fibre's speed converges over states met in walking; float64, run by NumPy."""

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


def walking_states(ticks: int) -> Problem:
    """Arguments of `speed_range` met in `ticks` on flat ground, of all muscles that are up."""
    walker = interpreted_walker()
    muscle = walker.muscle
    muscle.ITERATIONS = CONVERGED
    find_range, met, recorded = muscle.speed_range, [], []

    def recording(*arguments: Any) -> Any:
        met.append(np.array(np.broadcast_arrays(*arguments)))
        return find_range(*arguments)

    muscle.speed_range = recording
    flat, step_s = terrain.flat(), 1e-3
    batch = check_batch(sobol_points(SEED, 0, GAINS, PARAMETERS))
    start = np.tile(initial_rows(flat)[:, None], GAINS)
    state, *others = np.split(start, [FIRST_FIBRE, FIRST_DELAY, FIRST_EVENT])
    const = constant_rows(batch, Settings()).T
    sums, work = np.zeros((Sums.count, GAINS)), np.zeros((Work.count, GAINS))
    for tick in range(ticks):
        with np.errstate(all="ignore"):
            walker.step(
                tick, 1, step_s, *blends(step_s), 0, AllLanes(GAINS), batch.terrain_index,
                flat.height_m[None, :], muscle_table(step_s), state, *others, sums, const, work,
            )  # fmt: skip
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


def errors(problem: Problem, iterations: int) -> Array:
    """Of the speed that so many iterations find, by the walker's own source."""
    with np.errstate(all="ignore"):
        found = fibre_speed(interpreted_walker().muscle, problem, iterations)
        return np.abs(found - exact_speed(problem))
