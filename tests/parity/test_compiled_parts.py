"""The kernels for bodies of others, compiled, against their interpretation by NumPy, float64.

Inputs are random: what a body may sense or do has nothing to do with what a walker does here.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_nmm import terrain
from taichi_nmm.body import Bodies
from taichi_nmm.kernel.layout import (
    COORDINATES,
    FIRST_DELAY,
    FIRST_EVENT,
    FIRST_FIBRE,
    FIRST_SUM,
    LEGS,
    SEGMENT_COUNT,
    Drive,
    Motion,
    Muscle,
    Sense,
    State,
    Work,
)
from taichi_nmm.kernel.muscle_table import muscle_table
from taichi_nmm.parameters import PUBLISHED_GAINS, lower_bounds, upper_bounds
from taichi_nmm.settings import Settings
from taichi_nmm.walkers import blends, constant_rows
from taichi_nmm.world import WorldRanges
from tests.parity.interpreter import AllLanes, interpreted

pytestmark = pytest.mark.slow

WALKERS = 21  # the last pack is not full
TICKS = 60  # beyond the longest delay
TOLERANCE = 1e-9  # of each row, or of 1: rounding, which muscles forget and sums keep
LARGEST_LOAD_N = 2000.0


class Both:
    """The same walkers in packs, for a compiled kernel, and as NumPy's blocks of rows."""

    def __init__(self, step_s: float) -> None:
        from taichi_nmm import simulator
        from taichi_nmm.kernel import backend
        from taichi_nmm.walkers import check_batch

        rng = np.random.default_rng(4)
        gains = rng.uniform(lower_bounds(), upper_bounds(), (WALKERS, 16))
        gains[0] = PUBLISHED_GAINS
        grounds = (terrain.flat(), terrain.rough(3, flat_start_m=0.0), terrain.stairs())
        index = np.arange(WALKERS) % len(grounds)
        batch = check_batch(
            gains, Bodies.disturbed(range(WALKERS)), grounds, index,
            worlds=WorldRanges(
                strength=(0.8, 1.1), nerve_lag_s=(0.0, 0.01), sensing_noise=(0.0, 0.01)
            ).draw(range(WALKERS)),
        )  # fmt: skip
        settings = Settings(precision="float64", arch="cpu", physics_step_s=step_s)
        backend.start(settings)
        self.packs = simulator.start_packs(batch, settings)
        self.substeps, self.blends = settings.substeps, blends(step_s)
        self.table = muscle_table(step_s)
        self.index, self.heights = index, np.array([ground.height_m for ground in grounds])
        firsts = [FIRST_FIBRE, FIRST_DELAY, FIRST_EVENT, FIRST_SUM]
        rows = np.ascontiguousarray(self.rows().T)
        self.state, self.fibres, self.delay, self.events, self.sums = np.split(rows, firsts)
        self.const = constant_rows(batch, settings).T
        self.work = np.zeros((Work.count, WALKERS))
        self.lanes = AllLanes(WALKERS)

    def launch(self, kernel: Any, *arguments: Any) -> None:
        from taichi_nmm.kernel import backend

        packs = self.packs
        backend.launch(kernel, packs.lanes, packs.rows, packs.constants, *arguments)

    def rows(self) -> NDArray[np.float64]:
        """Rows of every walker as the compiled kernel has left them, [n, WALKER_ROWS]."""
        return np.array(self.packs.unfold(self.packs.rows))

    def assert_same(self) -> None:
        blocks = (self.state, self.fibres, self.delay, self.events, self.sums)
        assert_close(self.rows(), np.vstack(blocks).T)


def assert_close(ours: NDArray[np.float64], numpys: NDArray[np.float64]) -> None:
    assert np.isfinite(numpys).all()
    assert np.max(np.abs(ours - numpys) / np.maximum(np.abs(numpys), 1.0)) < TOLERANCE


def random_senses(rng: np.random.Generator) -> NDArray[np.float64]:
    """Rows of `layout.Sense`, [n, rows]."""
    rows = np.zeros((WALKERS, Sense.count))
    bent = np.cumsum(rng.uniform(-0.3, 0.6, (WALKERS, LEGS, 3)), axis=2).reshape(WALKERS, -1)
    lean = rng.uniform(-0.2, 0.2, (WALKERS, 1))
    rows[:, Sense.angle : Sense.angle + SEGMENT_COUNT] = np.hstack([lean, lean + bent])
    rows[:, Sense.rate : Sense.rate + SEGMENT_COUNT] = rng.uniform(-3, 3, (WALKERS, SEGMENT_COUNT))
    for first, low, high in (
        (Sense.load, 0.0, LARGEST_LOAD_N), (Sense.leg_length, 0.7, 1.0),
        (Sense.leg_angle, 1.0, 2.2), (Sense.com_ahead, -0.4, 0.4),
    ):  # fmt: skip
        rows[:, first : first + LEGS] = rng.uniform(low, high, (WALKERS, LEGS))
    rows[:, Sense.contact : Sense.contact + LEGS] = rng.integers(0, 2, (WALKERS, LEGS))
    rows[:, Sense.com_speed] = rng.uniform(0.0, 2.0, WALKERS)
    return rows


STEPS_S = [1e-3, pytest.param(0.5e-3, marks=pytest.mark.campaign)]


@pytest.mark.parametrize("step_s", STEPS_S)
def test_actuation(step_s: float) -> None:
    from taichi_nmm.kernel.actuation import actuate

    (actuation,) = interpreted("actuation")
    both, rng = Both(step_s), np.random.default_rng(9)
    torques = np.zeros((len(both.packs.rows), 3 * LEGS, both.packs.lanes))
    largest = 0.0
    for step in range(TICKS * both.substeps):
        senses = random_senses(rng)
        tick, within = divmod(step, both.substeps)
        both.launch(
            actuate, both.table, both.packs.fold(senses), torques, tick, int(within == 0),
            *both.blends,
        )  # fmt: skip
        actuation.step(
            tick, int(within == 0), *both.blends, both.lanes, both.table,
            np.ascontiguousarray(senses.T), both.state, both.fibres, both.delay, both.const,
            both.work,
        )  # fmt: skip
        expected = both.work[Work.joint_torque : Work.joint_torque + 3 * LEGS].T
        assert_close(both.packs.unfold(torques), expected)
        both.assert_same()
        largest = max(largest, float(np.abs(expected).max()))
    assert largest > 10.0  # something happened: N m
    assert both.fibres[Muscle.stimulation :].max() > 0.5


def random_motion(rng: np.random.Generator, start: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of `layout.Motion`, [n, rows]: about the start, so that most stay upright."""
    rows = np.zeros((WALKERS, Motion.count))
    shape = (WALKERS, COORDINATES)
    q, qdot = (rows[:, first : first + COORDINATES] for first in (Motion.q, Motion.qdot))
    q[:] = start + rng.uniform(-0.1, 0.1, shape)
    qdot[:] = rng.uniform(-2.0, 2.0, shape)
    q[rng.random(WALKERS) < 0.005, 1] = 0.3  # a fall
    rows[:, Motion.touching : Motion.touching + LEGS] = rng.integers(0, 2, (WALKERS, LEGS))
    forces = rng.uniform(-0.1, 1.0, (WALKERS, 2 * LEGS)) * LARGEST_LOAD_N
    rows[:, Motion.ground_force : Motion.ground_force + 2 * LEGS] = forces
    return rows


@pytest.mark.parametrize("step_s", STEPS_S)
def test_carried(step_s: float) -> None:
    """What drives another engine's bodies, and what is taken in of them; some fall."""
    from taichi_nmm.kernel.carried import drive, follow

    (carried,) = interpreted("carried")
    both, rng = Both(step_s), np.random.default_rng(10)
    start = both.rows()[:, State.q : State.q + COORDINATES]
    drives = np.zeros((len(both.packs.rows), Drive.count, both.packs.lanes))
    activation, load = both.blends
    for step in range(TICKS * both.substeps):
        tick, within = divmod(step, both.substeps)
        commands, ends = int(within == 0), int(within == both.substeps - 1)
        both.launch(
            drive, both.packs.terrains, both.heights, both.table, drives, tick, commands, activation
        )
        carried.before(
            tick, commands, activation, both.lanes, both.index, both.heights, both.table,
            both.state, both.fibres, both.delay, both.events, both.sums, both.const, both.work,
        )  # fmt: skip
        power = both.work[Work.metabolic_power : Work.metabolic_power + 2 * 7].sum(axis=0)
        torque = both.work[Work.joint_torque : Work.joint_torque + 3 * LEGS]
        expected = np.vstack([torque, power, both.work[Work.ground_hip]])
        assert_close(both.packs.unfold(drives), expected.T)
        both.assert_same()
        # A kernel begins with an empty work array.
        both.work[:] = 0.0
        motion = random_motion(rng, start)
        both.launch(follow, drives, both.packs.fold(motion), tick, ends, step_s, load)
        carried.after(
            tick, ends, step_s, load, both.lanes, expected, np.ascontiguousarray(motion.T),
            both.state, both.sums, both.const, both.work,
        )  # fmt: skip
        both.assert_same()
        both.work[:] = 0.0
    up = both.state[State.active]
    assert 0 < up.sum() < WALKERS
