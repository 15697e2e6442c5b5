"""Walks of the project's own simulator, tick by tick: what a body would sense, and the torques.

Torques are what the muscles' forces make at the joints by their table of moments, weighted, and the
ideal parts: the simulator keeps both. The stop of the hip is no part of them.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.body import SHANK_LENGTH_M, THIGH_LENGTH_M, Bodies
from taichi_nmm.kernel.layout import (
    COORDINATES,
    FIRST_FIBRE,
    LEGS,
    MUSCLES_PER_LEG,
    Muscle,
    State,
    Work,
)
from taichi_nmm.kernel.muscle_table import TORQUES_NM
from taichi_nmm.observation import Observation
from taichi_nmm.settings import Settings
from tests.parity.interpreter import interpreted

Array = NDArray[Any]
THIGHS, SHANKS, FEET = [1, 4], [2, 5], [3, 6]


@dataclass(frozen=True)
class Walks:
    """n walkers through t ticks of 1 ms.

    Attributes:
        q: at the beginning of a tick, [t, n, 9]; a fallen walker stays where it fell.
        qdot: likewise.
        contact: whether a foot is in the ground there, [t, n, 2].
        load_n: vertical force of the last tick, [t, n, 2].
        torque_nm: of the tick, [t, n, 6].
        up: whether a walker walks on after the tick, [t, n].
        constants: `layout.Const`, [n, rows].
    """

    q: Array
    qdot: Array
    contact: Array
    load_n: Array
    torque_nm: Array
    up: Array
    constants: Array


def record(gains: Array, ticks: int, settings: Settings) -> Walks:
    """Walk on level ground at a physics step of 1 ms, and keep each tick."""
    from taichi_nmm import simulator
    from taichi_nmm.kernel import backend
    from taichi_nmm.walkers import check_batch, constant_rows

    batch = check_batch(gains)
    backend.start(settings)
    packs, launch = simulator.start_packs(batch, settings), simulator.launcher(batch, settings)
    kept = FIRST_FIBRE + Muscle.count
    rows = np.empty((ticks + 1, len(batch), kept), dtype=backend.real_dtype())
    rows[0] = packs.unfold(packs.rows)[:, :kept]
    for tick in range(ticks):
        launch(packs, tick, 1)
        rows[tick + 1] = packs.unfold(packs.rows)[:, :kept]
    up = rows[1:, :, State.active] > 0.5
    # Where a walker is at its last tick upright, it stays.
    last = np.where(up, np.arange(ticks)[:, None], 0).max(axis=0)
    held = np.minimum(np.arange(ticks)[:, None], last)
    rows_0, rows_1 = (part[held, np.arange(len(batch))] for part in (rows[:-1], rows[1:]))
    touching = rows_1[..., State.touching : State.touching + 2 * LEGS]
    return Walks(
        q=rows_0[..., State.q : State.q + COORDINATES],
        qdot=rows_0[..., State.qdot : State.qdot + COORDINATES],
        contact=touching.reshape(ticks, -1, LEGS, 2).max(axis=3),
        load_n=rows_0[..., [State.ground_force + 1, State.ground_force + 3]],
        torque_nm=_torques(rows_0, rows_1),
        up=up,
        constants=constant_rows(batch, settings),
    )


def _torques(before: Array, after: Array) -> Array:
    """[t, n, 6] of the muscles' forces and the ideal parts after a tick."""
    first = FIRST_FIBRE + Muscle.force
    force = after[..., first : first + LEGS * MUSCLES_PER_LEG].astype(np.float64)
    force = force.reshape(*force.shape[:2], LEGS, MUSCLES_PER_LEG)
    joint = joint_angles(before[..., State.q : State.q + COORDINATES].astype(np.float64))
    joint = joint.reshape(*force.shape[:3], 3)
    hip = force @ TORQUES_NM[:, 0]
    knee, ankle = (
        (force @ TORQUES_NM[:, 2 * n - 1]) * np.cos(joint[..., n])
        + (force @ TORQUES_NM[:, 2 * n]) * np.sin(joint[..., n])
        for n in (1, 2)
    )
    weight, ideal_hip, ideal_knee = (
        after[..., row : row + LEGS].astype(np.float64)
        for row in (State.stance_weight, State.hip_torque, State.knee_torque)
    )
    torque = np.stack([weight * hip + ideal_hip, weight * knee + ideal_knee, ankle], axis=-1)
    return torque.reshape(*torque.shape[:2], 3 * LEGS)


def joint_angles(q: Array) -> Array:
    """Hip, knee, ankle, left, then right, [..., 6], of coordinates or of their rates."""
    return q[..., 3:] - q[..., [2, 3, 4, 2, 6, 7]]


def sensed(walks: Walks, bodies: Bodies) -> list[Observation]:
    """What the bodies sense at each tick, by plain geometry in float64."""
    ticks, count = walks.up.shape
    q, qdot = (rows.astype(np.float64).reshape(ticks * count, -1) for rows in (walks.q, walks.qdot))
    everyone = bodies.take(np.arange(ticks * count) % count)
    angle, rate = q[:, 2:], qdot[:, 2:]
    # From the hip: each segment's way down (the feet's: forward), and how fast that changes.
    way = np.stack([-np.sin(angle), -np.cos(angle)], axis=-1)
    way[:, FEET] = np.stack([np.cos(angle), -np.sin(angle)], axis=-1)[:, FEET]
    way[:, 0] *= -1.0
    speed = np.stack([way[..., 1], -way[..., 0]], axis=-1) * rate[..., None]
    ankle = THIGH_LENGTH_M * way[:, THIGHS] + SHANK_LENGTH_M * way[:, SHANKS]
    com, com_speed = (
        np.einsum("ns,ns->n", everyone.mass_kg, _centres(everyone, parts)[..., 0])
        / everyone.mass_kg.sum(axis=1)
        for parts in (way, speed)
    )
    length = np.hypot(ankle[..., 0], ankle[..., 1])
    leg_angle = np.pi - np.arctan2(-ankle[..., 1], -ankle[..., 0])
    ahead = com[:, None] - ankle[..., 0]
    return _sensed(walks, length, leg_angle, ahead, qdot[:, 0] + com_speed)


def _centres(bodies: Bodies, way: Array) -> Array:
    """Centres of mass from the hip, [n, 7, 2]; or their velocities, given those of the ways."""
    centres = bodies.com_m[..., None] * way
    for thigh, shank, foot in zip(THIGHS, SHANKS, FEET, strict=True):
        centres[:, shank] += THIGH_LENGTH_M * way[:, thigh]
        centres[:, foot] += THIGH_LENGTH_M * way[:, thigh] + SHANK_LENGTH_M * way[:, shank]
    return centres


def sensed_in_float32(walks: Walks) -> list[Observation]:
    """The same by the simulator's own kinematics, on NumPy in float32: rounding is its own."""
    (kinematics,) = interpreted("kinematics", double=False)
    ticks, count = walks.up.shape
    state = np.zeros((State.count, ticks * count), dtype=np.float32)
    state[State.q : State.q + COORDINATES] = walks.q.reshape(ticks * count, -1).T
    state[State.qdot : State.qdot + COORDINATES] = walks.qdot.reshape(ticks * count, -1).T
    const = np.tile(walks.constants.T.astype(np.float32), ticks)
    work = np.zeros((Work.count, ticks * count), dtype=np.float32)
    lanes = np.arange(ticks * count)
    kinematics.directions(lanes, state, work)
    kinematics.contact_points(lanes, state, work)
    kinematics.centre_of_mass(lanes, state, const, work)
    length, angle, ankle_x = (
        work[row : row + LEGS].T for row in (Work.leg_length, Work.leg_angle, Work.ankle_x)
    )
    ahead = work[Work.com_x][:, None] - ankle_x
    return _sensed(walks, length, angle, ahead, work[Work.com_speed])


def _sensed(
    walks: Walks, length: Array, angle: Array, ahead: Array, speed: Array
) -> list[Observation]:
    """An `Observation` of each tick from lengths, angles and speeds of all ticks, [t n, ...]."""
    shape, q, qdot = walks.up.shape, walks.q.astype(np.float64), walks.qdot.astype(np.float64)
    columns = (
        joint_angles(q), joint_angles(qdot), q[..., 2], qdot[..., 2], walks.contact, walks.load_n,
        *(part.reshape(*shape, LEGS) for part in (length, angle, ahead)), speed.reshape(shape),
    )  # fmt: skip
    return [Observation(*rows) for rows in zip(*columns, strict=True)]
