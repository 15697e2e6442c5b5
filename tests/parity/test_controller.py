"""`Controller` driven with recorded states of the simulator makes the simulator's torques.

Torques are what the muscles' forces make at the joints by their table of moments,
weighted, and the ideal parts: the simulator keeps both. The stop of the hip is no part
of them.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_nmm import Controller, Observation, Settings, simulator
from taichi_nmm.body import SHANK_LENGTH_M, THIGH_LENGTH_M, Bodies
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.joints import HIP_EXTENSION_LIMIT_RAD
from taichi_nmm.kernel.layout import (
    LEGS,
    MUSCLES_PER_LEG,
    Const,
    Muscle,
    State,
    WalkerRows,
    Work,
)
from taichi_nmm.kernel.muscle_table import TORQUES_NM
from taichi_nmm.parameters import (
    PUBLISHED_GAINS,
    load_gains,
    lower_bounds,
    upper_bounds,
)
from taichi_nmm.walkers import check_batch, constant_rows
from tests.parity import numpy_dynamics
from tests.parity.interpreter import interpreted

pytestmark = pytest.mark.slow

Array = NDArray[Any]

WALKERS = 12
TICKS = 20_000  # 20 s
NEAR = 0.07  # of each gain of the published gains


@dataclass(frozen=True)
class Walks:
    """n walkers through t ticks of 1 ms; a fallen walker stays where it fell."""

    q: Array  # at the beginning of a tick, [t, n, 9]
    qdot: Array  # likewise
    contact: Array  # whether a foot is in the ground there, [t, n, 2]
    load_n: Array  # vertical force of the last tick, [t, n, 2]
    torque_nm: Array  # of the tick, [t, n, 6]
    up: Array  # whether a walker walks on after the tick, [t, n]
    constants: Array  # `layout.Const`, [n, rows]


def record(gains, settings):
    """Walk on level ground at a physics step of 1 ms, and keep each tick."""
    batch = check_batch(gains)
    backend.start(settings)
    packs = simulator.start_packs(batch, settings)
    launch = simulator.launcher(batch, settings)
    kept = WalkerRows.delay  # the rows before: state and fibres
    rows = np.empty((TICKS + 1, len(batch), kept), dtype=backend.real_dtype())
    rows[0] = packs.unfold(packs.rows)[:, :kept]
    for tick in range(TICKS):
        launch(packs, tick, 1)
        rows[tick + 1] = packs.unfold(packs.rows)[:, :kept]
    up = rows[1:, :, State.active] > 0.5
    # Where a walker is at its last tick upright, it stays.
    last = np.where(up, np.arange(TICKS)[:, None], 0).max(axis=0)
    held = np.minimum(np.arange(TICKS)[:, None], last)
    rows_0, rows_1 = (
        part[held, np.arange(len(batch))] for part in (rows[:-1], rows[1:])
    )
    before, after = named(State, rows_0), named(State, rows_1)
    force = named(Muscle, rows_1[..., WalkerRows.fibres :]).force
    return Walks(
        q=last_axis(before.q),
        qdot=last_axis(before.qdot),
        contact=last_axis(np.maximum(after.touching[::2], after.touching[1::2])),
        load_n=last_axis(before.ground_force[1::2]),
        torque_nm=_torques(last_axis(before.q), after, last_axis(force)),
        up=up,
        constants=constant_rows(batch, settings),
    )


def named(layout, rows):
    """Blocks [row, t, n] of an array [t, n, row]."""
    return layout.of(np.moveaxis(rows, -1, 0))


def last_axis(block):
    """[row, t, n] to [t, n, row]."""
    return np.ascontiguousarray(np.moveaxis(block, 0, -1))


def _torques(q, after, force):
    """[t, n, 6] of the muscles' forces and the ideal parts after a tick."""
    shape = (*q.shape[:2], LEGS)
    force = force.astype(np.float64).reshape(*shape, MUSCLES_PER_LEG)
    joint = joint_angles(q.astype(np.float64)).reshape(*shape, 3)
    hip = force @ TORQUES_NM[:, 0]
    knee, ankle = (
        (force @ TORQUES_NM[:, 2 * n - 1]) * np.cos(joint[..., n])
        + (force @ TORQUES_NM[:, 2 * n]) * np.sin(joint[..., n])
        for n in (1, 2)
    )
    weight, ideal_hip, ideal_knee = (
        last_axis(block).astype(np.float64)
        for block in (after.stance_weight, after.hip_torque, after.knee_torque)
    )
    torque = np.stack(
        [weight * hip + ideal_hip, weight * knee + ideal_knee, ankle], axis=-1
    )
    return torque.reshape(*torque.shape[:2], 3 * LEGS)


def joint_angles(q):
    """Hip, knee, ankle, left, then right, [..., 6], of coordinates or of their rates."""
    return q[..., 3:] - q[..., [2, 3, 4, 2, 6, 7]]


def sensed(walks, bodies):
    """What the bodies sense at each tick, by plain geometry in float64."""
    q, qdot = (
        rows.astype(np.float64).reshape(TICKS * WALKERS, -1)
        for rows in (walks.q, walks.qdot)
    )
    way = numpy_dynamics.unit_vectors(q)  # of each segment, from the hip on
    speed = numpy_dynamics.clockwise_quarter_turn(way) * qdot[:, 2:, None]
    ankle = THIGH_LENGTH_M * way[:, [1, 4]] + SHANK_LENGTH_M * way[:, [2, 5]]
    lever = np.einsum("ni,nik->nk", bodies.mass_kg, numpy_dynamics.arms_m(bodies))
    lever = np.tile(lever / bodies.mass_kg.sum(axis=1, keepdims=True), (TICKS, 1))
    com, com_speed = ((lever * part[..., 0]).sum(axis=1) for part in (way, speed))
    length = np.hypot(ankle[..., 0], ankle[..., 1])
    leg_angle = np.pi - np.arctan2(-ankle[..., 1], -ankle[..., 0])
    ahead = com[:, None] - ankle[..., 0]
    return observations(walks, length, leg_angle, ahead, qdot[:, 0] + com_speed)


def sensed_in_float32(walks):
    """The same by the simulator's own kinematics, on NumPy in float32: rounding is its own."""
    (kinematics,) = interpreted("kinematics", double=False)
    count = TICKS * WALKERS
    state = State.of(np.zeros((State.count, count), dtype=np.float32))
    state.q[:] = walks.q.reshape(count, -1).T
    state.qdot[:] = walks.qdot.reshape(count, -1).T
    const = Const.of(np.tile(walks.constants.T.astype(np.float32), TICKS))
    work = Work.of(np.zeros((Work.count, count), dtype=np.float32))
    lanes = np.arange(count)
    kinematics.directions(lanes, state, work)
    kinematics.contact_points(lanes, state, work)
    kinematics.centre_of_mass(lanes, state, const, work)
    ahead = work.com_x - work.ankle_x
    return observations(
        walks, work.leg_length.T, work.leg_angle.T, ahead.T, work.com_speed
    )


def observations(walks, length, angle, ahead, speed):
    """An `Observation` of each tick from lengths, angles and speeds of all ticks, [t n, ...]."""
    shape = walks.up.shape
    q, qdot = walks.q.astype(np.float64), walks.qdot.astype(np.float64)
    columns = (
        joint_angles(q),
        joint_angles(qdot),
        q[..., 2],
        qdot[..., 2],
        walks.contact,
        walks.load_n,
        *(part.reshape(*shape, LEGS) for part in (length, angle, ahead)),
        speed.reshape(shape),
    )
    return [Observation(*rows) for rows in zip(*columns, strict=True)]


def twelve_gains():
    """The published gains, the reference gait, and ten near the published gains."""
    rng = np.random.default_rng(3)
    gains = np.tile(PUBLISHED_GAINS, (WALKERS, 1))
    gains[1] = load_gains("reference")
    gains[2:] *= rng.uniform(1.0 - NEAR, 1.0 + NEAR, gains[2:].shape)
    return np.asarray(np.clip(gains, lower_bounds(), upper_bounds()))


@pytest.mark.parametrize(
    ("precision", "bound"), [("float64", 1e-12), ("float32", 1e-6)]
)
def test_recorded_states_give_the_torques_of_the_walk(precision, bound):
    settings = Settings(precision=precision, arch="cpu")
    walks = record(twelve_gains(), settings)
    # The published gains and the reference walk to the end
    assert walks.up[-1, :2].all()
    double = precision == "float64"
    states = (
        sensed(walks, Bodies.nominal(WALKERS)) if double else sensed_in_float32(walks)
    )
    controller = Controller(twelve_gains(), settings=settings)
    torque = np.array([controller.step(state) for state in states])
    largest = np.abs(walks.torque_nm[walks.up]).max()
    assert np.abs(torque - walks.torque_nm)[walks.up].max() <= bound * largest


def test_the_stop_of_the_hip_is_the_bodys_own():
    """In swing only the leg's angle and length count: a hip far beyond its limit
    changes nothing, where the stop would turn it by some N m."""
    inside = Observation(
        joint_rad=[[0.3, 0.4, 0.0] * 2],
        joint_rate_radps=[[0.0] * 6],
        trunk_rad=[0.0],
        trunk_rate_radps=[0.0],
        contact=[[False, False]],
        load_n=[[0.0, 0.0]],
        leg_length_m=[[0.95, 0.95]],
        leg_angle_rad=[[1.5, 1.5]],
        com_ahead_m=[[0.0, 0.0]],
        com_speed_mps=[1.3],
    )
    bent = np.array([[HIP_EXTENSION_LIMIT_RAD + 0.3, 0.4, 0.0] * 2])
    torques = [
        Controller(PUBLISHED_GAINS, settings=Settings(precision="float64")).step(state)
        for state in (inside, replace(inside, joint_rad=bent))
    ]
    np.testing.assert_array_equal(torques[0][:, [0, 3]], torques[1][:, [0, 3]])
    assert np.abs(torques[0][:, [0, 3]]).min() > 0.0
