"""The compiled kernels against the same source interpreted by NumPy, float64."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_nmm import (
    Bodies,
    Prosthesis,
    Push,
    Settings,
    Slip,
    WorldRanges,
    Worlds,
    simulator,
    terrain,
)
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.actuation import actuate
from taichi_nmm.kernel.carried import drive, follow
from taichi_nmm.kernel.layout import (
    LEGS,
    Const,
    Drive,
    Motion,
    Sense,
    State,
    WalkerRows,
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
from taichi_nmm.walkers import blends, check_batch, constant_rows
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
TICKS = 40  # beyond the longest delay
TOLERANCE = 1e-9  # of each row, or of 1: rounding, which muscles forget and sums keep
LARGEST_LOAD_N = 2000.0


def walking_batch(count):
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
    healthy = WorldRanges(
        contact_stiffness=(0.5, 3.0),
        relaxation_speed=(0.5, 3.0),
        friction=(0.5, 1.0),
        strength=(0.8, 1.1),
        nerve_lag_s=(0.0, 0.01),
        sensing_noise=(0.0, 0.01),
        catch_ns=(0.0, 5.0),
        push=Push(time_s=0.02, duration_s=0.1, force_n=200.0),
        slip=Slip(time_s=0.03, duration_s=0.3, friction=0.05),
    )
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

    def __init__(self, step_s):
        batch = walking_batch(WALKERS)
        self.index = batch.terrain_index
        settings = Settings(precision="float64", arch="cpu", physics_step_s=step_s)
        backend.start(settings)
        self.packs = simulator.start_packs(batch, settings)
        self.walk = simulator.launcher(batch, settings)
        self.substeps = settings.substeps
        self.blends = blends(step_s)
        self.table = muscle_table(step_s)
        self.heights = np.array([ground.height_m for ground in batch.terrains])
        self.numpys = np.ascontiguousarray(self.rows().T)
        walkers = WalkerRows.of(self.numpys)
        self.state, self.fibres, self.delay = (
            walkers.state,
            walkers.fibres,
            walkers.delay,
        )
        self.events, self.sums = walkers.events, walkers.sums
        self.blocks = self.state, self.fibres, self.delay, self.events, self.sums
        self.const = Const.of(constant_rows(batch, settings).T)
        self.scratch = np.zeros((Work.count, WALKERS))
        self.work = Work.of(self.scratch)
        self.lanes = AllLanes(WALKERS)

    def launch(self, kernel, *arguments):
        packs = self.packs
        backend.launch(kernel, packs.lanes, packs.rows, packs.constants, *arguments)

    def rows(self):
        """Rows of every walker as the compiled kernel has left them, [n, row]."""
        return np.array(self.packs.unfold(self.packs.rows))

    def output(self, rows):
        """An empty array of so many rows for the compiled kernel."""
        return np.zeros((len(self.packs.rows), rows, self.packs.lanes))

    def steps(self):
        """Tick and substep of each physics step."""
        for step in range(TICKS * self.substeps):
            yield divmod(step, self.substeps)

    def assert_same(self):
        assert_close(self.rows(), self.numpys.T)


def assert_close(ours, numpys):
    assert np.isfinite(numpys).all()
    assert np.max(np.abs(ours - numpys) / np.maximum(np.abs(numpys), 1.0)) < TOLERANCE


@STEPS_S
def test_a_walk(step_s):
    both = Both(step_s)
    walker = interpreted_walker()
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
    ours, numpys = both.rows(), both.numpys.T
    assert (
        np.nanmax(np.abs(ours - numpys) / np.maximum(np.abs(numpys), 1.0))
        < WALK_TOLERANCE
    )
    assert np.array_equal(np.isnan(ours), np.isnan(numpys))
    # Something happened: most walk on, the feet changed, the muscles pulled.
    assert ours[:, State.active].sum() > WALKERS / 2
    strikes = WalkerRows.of(ours.T).events.tick_strike
    assert np.array_equal(strikes, both.events.tick_strike) and strikes.max() > 0


def random_senses(rng):
    """Rows of `layout.Sense`, [n, rows]."""
    rows = np.zeros((WALKERS, Sense.count))
    sense = Sense.of(rows.T)
    lean = rng.uniform(-0.2, 0.2, WALKERS)
    bent = np.cumsum(rng.uniform(-0.3, 0.6, (LEGS, 3, WALKERS)), axis=1)
    sense.angle[0] = lean
    sense.angle[1:] = lean + bent.reshape(3 * LEGS, WALKERS)
    for values, low, high in (
        (sense.rate, -3.0, 3.0),
        (sense.load, 0.0, LARGEST_LOAD_N),
        (sense.leg_length, 0.7, 1.0),
        (sense.leg_angle, 1.0, 2.2),
        (sense.com_ahead, -0.4, 0.4),
        (sense.com_speed, 0.0, 2.0),
    ):
        values[:] = rng.uniform(low, high, values.shape)
    sense.contact[:] = rng.integers(0, 2, sense.contact.shape)
    return rows


@STEPS_S
def test_actuation(step_s):
    (actuation,) = interpreted("actuation")
    both = Both(step_s)
    rng = np.random.default_rng(9)
    torques = both.output(3 * LEGS)
    largest = 0.0
    for tick, within in both.steps():
        senses = random_senses(rng)
        commands = int(within == 0)
        folded = both.packs.fold(senses)
        both.launch(actuate, both.table, folded, torques, tick, commands, *both.blends)
        actuation.step(
            tick,
            commands,
            *both.blends,
            both.lanes,
            both.table,
            Sense.of(senses.T),
            both.state,
            both.fibres,
            both.delay,
            both.const,
            both.work,
        )
        expected = both.work.joint_torque.T
        assert_close(both.packs.unfold(torques), expected)
        both.assert_same()
        largest = max(largest, float(np.abs(expected).max()))
    assert largest > 10.0  # something happened: N m
    assert both.fibres.stimulation.max() > 0.5


def random_motion(rng, start):
    """Rows of `layout.Motion`, [n, rows]: about the start, so that most stay upright."""
    rows = np.zeros((WALKERS, Motion.count))
    motion = Motion.of(rows.T)
    motion.q[:] = start + rng.uniform(-0.1, 0.1, start.shape)
    motion.qdot[:] = rng.uniform(-2.0, 2.0, start.shape)
    motion.q[1, rng.random(WALKERS) < 0.005] = 0.3  # a fall
    motion.touching[:] = rng.integers(0, 2, motion.touching.shape)
    shares = rng.uniform(-0.1, 1.0, motion.ground_force.shape)
    motion.ground_force[:] = shares * LARGEST_LOAD_N
    return rows


@STEPS_S
def test_bodies_that_another_engine_moves(step_s):
    """Both kernels, before and after the other engine's step; some walkers fall."""
    (carried,) = interpreted("carried")
    both = Both(step_s)
    rng = np.random.default_rng(10)
    start = both.state.q.copy()
    drives = both.output(Drive.count)
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
        power = both.work.metabolic_power.sum(axis=0)
        torque, catch = both.work.joint_torque, both.work.momentum
        expected = np.vstack([torque, power, both.work.ground_hip, catch])
        assert_close(both.packs.unfold(drives), expected.T)
        both.assert_same()
        both.scratch[:] = 0.0  # a kernel begins with an empty work array
        motion = random_motion(rng, start)
        both.launch(follow, drives, both.packs.fold(motion), tick, ends, step_s, load)
        carried.after(
            tick,
            ends,
            step_s,
            load,
            both.lanes,
            Drive.of(expected),
            Motion.of(motion.T),
            both.state,
            both.sums,
            both.const,
            both.work,
        )
        both.assert_same()
        both.scratch[:] = 0.0
    assert 0 < both.state.active.sum() < WALKERS
