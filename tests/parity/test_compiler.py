"""The compiled kernels against the same source interpreted by NumPy, float64."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_nmm import (
    Bodies,
    Prosthesis,
    Settings,
    WorldRanges,
    Worlds,
    simulator,
    terrain,
)
from taichi_nmm.kernel import backend, layout
from taichi_nmm.kernel.actuation import actuate
from taichi_nmm.kernel.carried import drive, follow
from taichi_nmm.kernel.layout import (
    COORDINATES,
    LEGS,
    Drive,
    Motion,
    Muscle,
    Sense,
    State,
    Work,
)
from taichi_nmm.kernel.muscle_table import muscle_table
from taichi_nmm.parameters import (
    FIXED,
    LOW_LEVEL_GAINS,
    PUBLISHED_GAINS,
    lower_bounds,
    upper_bounds,
)
from taichi_nmm.walkers import Batch, blends, check_batch, constant_rows
from taichi_nmm.world import MUSCLE_LIMITS
from tests.parity.interpreter import AllLanes, interpreted, interpreted_walker

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
STEPS_S = pytest.mark.parametrize(
    "step_s", [1e-3, pytest.param(0.5e-3, marks=pytest.mark.campaign)]
)
WALKERS = 21  # the last pack is not full
WALK_TICKS, WALK_TOLERANCE = 500, 1e-6  # 0.5 s; contacts enlarge what rounding changes
# The kernels of one physics step get random inputs: a body of another simulator may
# sense or do anything.
TICKS = 60  # beyond the longest delay
TOLERANCE = 1e-9  # of each row, or of 1: rounding, which muscles forget and sums keep
LARGEST_LOAD_N = 2000.0
SEGMENT_COUNT = layout.SEGMENT_COUNT


def walking_batch(count: int) -> Batch:
    """Walkers of random gains, the first of the published ones: each body and each
    world another, every second with a device and legs that differ, every third with a
    prosthesis and muscles of its own, on five grounds in turn.
    """
    rng = np.random.default_rng(4)
    gains = rng.uniform(lower_bounds(), upper_bounds(), (count, 16))
    gains[0] = PUBLISHED_GAINS
    grounds = [
        terrain.flat(),
        terrain.rough(3, flat_start_m=0.0),
        terrain.blocks(4, flat_start_m=0.0, spacing_m=0.4),
        terrain.ramp(increment=0.1, segment_m=0.5, direction="down"),
        terrain.stairs(rise_m=0.03, run_m=0.3, flat_start_m=0.2),
    ]
    ranges = (0.5, 3.0), (0.5, 3.0), (0.5, 1.0), (0.8, 1.1), (0.0, 0.01), (0.0, 0.01)
    healthy = WorldRanges(*ranges, catch_ns=(0.0, 5.0))
    own = {name: tuple(rng.uniform(0.9, 1.1, 14)) for name in MUSCLE_LIMITS}
    amputees = replace(healthy, prosthesis=Prosthesis("right", 400.0, 1.0, 0.05), **own)
    each_world = Worlds.stacked(
        ranges.draw(range(count)) for ranges in (healthy, amputees)
    )
    worlds = each_world.take(np.arange(count) + count * (np.arange(count) % 3 == 2))
    bodies = Bodies.disturbed(range(count))
    low_level = np.tile([each.default for each in LOW_LEVEL_GAINS], (count, 1))
    first = len(FIXED)
    ends = np.array([(each.low, each.high) for each in LOW_LEVEL_GAINS[first:]]).T
    # The others have no device, and equal legs.
    low_level[::2, first:] = rng.uniform(*ends, low_level[::2, first:].shape)
    index = np.arange(count) % len(grounds)
    return check_batch(gains, bodies, grounds, index, low_level, worlds)


class Both:
    """The same walkers in packs, for a compiled kernel, and as NumPy's blocks of rows."""

    def __init__(self, step_s: float) -> None:
        batch = walking_batch(WALKERS)
        self.index = batch.terrain_index
        settings = Settings(precision="float64", arch="cpu", physics_step_s=step_s)
        backend.start(settings)
        self.packs = simulator.start_packs(batch, settings)
        self.walk = simulator.launcher(batch, settings)
        self.substeps, self.blends = settings.substeps, blends(step_s)
        self.table = muscle_table(step_s)
        self.heights = np.array([ground.height_m for ground in batch.terrains])
        firsts = [
            layout.FIRST_FIBRE,
            layout.FIRST_DELAY,
            layout.FIRST_EVENT,
            layout.FIRST_SUM,
        ]
        self.blocks = np.split(np.ascontiguousarray(self.rows().T), firsts)
        self.state, self.fibres, self.delay, self.events, self.sums = self.blocks
        self.const = constant_rows(batch, settings).T
        self.work = np.zeros((Work.count, WALKERS))
        self.lanes = AllLanes(WALKERS)

    def launch(self, kernel: Any, *arguments: Any) -> None:
        packs = self.packs
        backend.launch(kernel, packs.lanes, packs.rows, packs.constants, *arguments)

    def rows(self) -> Array:
        """Rows of every walker as the compiled kernel has left them, [n, WALKER_ROWS]."""
        return np.array(self.packs.unfold(self.packs.rows))

    def output(self, rows: int) -> Array:
        """An empty array of so many rows for the compiled kernel."""
        return np.zeros((len(self.packs.rows), rows, self.packs.lanes))

    def steps(self) -> Iterator[tuple[int, int]]:
        """Tick and substep of each physics step."""
        for step in range(TICKS * self.substeps):
            yield divmod(step, self.substeps)

    def assert_same(self) -> None:
        assert_close(self.rows(), np.vstack(self.blocks).T)


def assert_close(ours: Array, numpys: Array) -> None:
    assert np.isfinite(numpys).all()
    assert np.max(np.abs(ours - numpys) / np.maximum(np.abs(numpys), 1.0)) < TOLERANCE


@STEPS_S
def test_a_walk(step_s: float) -> None:
    both, walker = Both(step_s), interpreted_walker()
    both.walk(both.packs, 0, WALK_TICKS)
    with np.errstate(all="ignore"):
        for tick in range(WALK_TICKS):
            walker.step(
                tick,
                both.substeps,
                step_s,
                *both.blends,
                1,
                both.lanes,
                both.index,
                both.heights,
                both.table,
                *both.blocks,
                both.const,
                both.work,
            )
    ours, numpys = both.rows(), np.vstack(both.blocks).T
    assert (
        np.nanmax(np.abs(ours - numpys) / np.maximum(np.abs(numpys), 1.0))
        < WALK_TOLERANCE
    )
    assert np.array_equal(np.isnan(ours), np.isnan(numpys))
    # Something happened: most walk on, the feet changed, the muscles pulled.
    assert ours[:, State.active].sum() > WALKERS / 2
    first = layout.FIRST_EVENT + layout.Gait.tick_strike
    ours, numpys = (rows[:, first : first + 2] for rows in (ours, numpys))
    assert np.array_equal(ours, numpys) and ours.max() > 0


def random_senses(rng: np.random.Generator) -> Array:
    """Rows of `layout.Sense`, [n, rows]."""
    rows = np.zeros((WALKERS, Sense.count))
    bent = np.cumsum(rng.uniform(-0.3, 0.6, (WALKERS, LEGS, 3)), axis=2).reshape(
        WALKERS, -1
    )
    lean = rng.uniform(-0.2, 0.2, (WALKERS, 1))
    rows[:, Sense.angle : Sense.angle + SEGMENT_COUNT] = np.hstack([lean, lean + bent])
    rows[:, Sense.rate : Sense.rate + SEGMENT_COUNT] = rng.uniform(
        -3, 3, (WALKERS, SEGMENT_COUNT)
    )
    for first, low, high in (
        (Sense.load, 0.0, LARGEST_LOAD_N),
        (Sense.leg_length, 0.7, 1.0),
        (Sense.leg_angle, 1.0, 2.2),
        (Sense.com_ahead, -0.4, 0.4),
    ):
        rows[:, first : first + LEGS] = rng.uniform(low, high, (WALKERS, LEGS))
    rows[:, Sense.contact : Sense.contact + LEGS] = rng.integers(0, 2, (WALKERS, LEGS))
    rows[:, Sense.com_speed] = rng.uniform(0.0, 2.0, WALKERS)
    return rows


@STEPS_S
def test_actuation(step_s: float) -> None:
    (actuation,) = interpreted("actuation")
    both, rng = Both(step_s), np.random.default_rng(9)
    torques, largest = both.output(3 * LEGS), 0.0
    for tick, within in both.steps():
        senses, commands = random_senses(rng), int(within == 0)
        folded = both.packs.fold(senses)
        both.launch(actuate, both.table, folded, torques, tick, commands, *both.blends)
        actuation.step(
            tick,
            commands,
            *both.blends,
            both.lanes,
            both.table,
            np.ascontiguousarray(senses.T),
            both.state,
            both.fibres,
            both.delay,
            both.const,
            both.work,
        )
        expected = both.work[Work.joint_torque : Work.joint_torque + 3 * LEGS].T
        assert_close(both.packs.unfold(torques), expected)
        both.assert_same()
        largest = max(largest, float(np.abs(expected).max()))
    assert largest > 10.0  # something happened: N m
    assert both.fibres[Muscle.stimulation :].max() > 0.5


def random_motion(rng: np.random.Generator, start: Array) -> Array:
    """Rows of `layout.Motion`, [n, rows]: about the start, so that most stay upright."""
    rows = np.zeros((WALKERS, Motion.count))
    shape = (WALKERS, COORDINATES)
    q, qdot = (
        rows[:, first : first + COORDINATES] for first in (Motion.q, Motion.qdot)
    )
    q[:] = start + rng.uniform(-0.1, 0.1, shape)
    qdot[:] = rng.uniform(-2.0, 2.0, shape)
    q[rng.random(WALKERS) < 0.005, 1] = 0.3  # a fall
    rows[:, Motion.touching : Motion.touching + LEGS] = rng.integers(
        0, 2, (WALKERS, LEGS)
    )
    forces = rng.uniform(-0.1, 1.0, (WALKERS, 2 * LEGS)) * LARGEST_LOAD_N
    rows[:, Motion.ground_force : Motion.ground_force + 2 * LEGS] = forces
    return rows


@STEPS_S
def test_bodies_that_another_engine_moves(step_s: float) -> None:
    """Both kernels, before and after the other engine's step; some walkers fall."""
    (carried,) = interpreted("carried")
    both, rng = Both(step_s), np.random.default_rng(10)
    start, drives = (
        both.rows()[:, State.q : State.q + COORDINATES],
        both.output(Drive.count),
    )
    activation, load = both.blends
    for tick, within in both.steps():
        commands, ends = int(within == 0), int(within == both.substeps - 1)
        both.launch(
            drive,
            both.packs.terrains,
            both.heights,
            both.table,
            drives,
            tick,
            commands,
            activation,
        )
        carried.before(
            tick,
            commands,
            activation,
            both.lanes,
            both.index,
            both.heights,
            both.table,
            *both.blocks,
            both.const,
            both.work,
        )
        power = both.work[Work.metabolic_power : Work.metabolic_power + 2 * 7].sum(
            axis=0
        )
        torque = both.work[Work.joint_torque : Work.joint_torque + 3 * LEGS]
        catch = both.work[Work.momentum : Work.momentum + COORDINATES]
        expected = np.vstack([torque, power, both.work[Work.ground_hip], catch])
        assert_close(both.packs.unfold(drives), expected.T)
        both.assert_same()
        both.work[:] = 0.0  # a kernel begins with an empty work array
        motion = random_motion(rng, start)
        both.launch(follow, drives, both.packs.fold(motion), tick, ends, step_s, load)
        carried.after(
            tick,
            ends,
            step_s,
            load,
            both.lanes,
            expected,
            np.ascontiguousarray(motion.T),
            both.state,
            both.sums,
            both.const,
            both.work,
        )
        both.assert_same()
        both.work[:] = 0.0
    assert 0 < both.state[State.active].sum() < WALKERS
