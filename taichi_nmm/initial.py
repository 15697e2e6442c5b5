"""The state in which every walk starts: left leg in stance, right leg in swing, 1.3 m/s.

Source: the walker T; the stance leg additionally pivots about its foot instead of
skidding.
"""

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.body import BALL_OFFSET_M, HEEL_OFFSET_M, SHANK_LENGTH_M, THIGH_LENGTH_M
from taichi_nmm.kernel.layout import (
    LEGS,
    MUSCLE_COUNT,
    MUSCLES_PER_LEG,
    RINGS,
    TA,
    Gait,
    Muscle,
    Signal,
    State,
)
from taichi_nmm.kernel.muscle import ACTIVATION_FLOOR
from taichi_nmm.kernel.muscle_table import (
    OPTIMAL_LENGTH_M,
    SLACK_LENGTH_M,
    unit_lengths,
)
from taichi_nmm.kernel.nerves import TA_LENGTH_OFFSET
from taichi_nmm.kernel.swing import HOLD
from taichi_nmm.terrain import Terrain

SPEED_MPS = 1.3  # of the hip
STANCE_LEG_RATE_RADPS = (
    1.3  # of thigh and shank: the leg, 1 m long, pivots about its foot
)
PENETRATION_M = 0.005  # depth of the stance foot's lowest point in the ground
JOINTS_RAD = np.deg2rad(
    [[-5.0, 5.0, -5.0], [-30.0, 5.0, 0.0]]
)  # hip, knee, ankle; left, right


def initial_rows(terrain: Terrain) -> NDArray[np.float64]:
    """State, muscles, delays, gait memory and (empty) sums of a walker on this terrain, [rows]."""
    state = _state(terrain)
    stance = state[State.stance_before : State.stance_before + LEGS]
    fibres, felt, delay = muscles_and_nerves(JOINTS_RAD, stance)
    state[State.felt : State.felt + Signal.count] = felt
    events = np.zeros(Gait.count)
    events[Gait.in_stance] = 1.0
    events[Gait.last_strike_tick] = -1.0
    return np.concatenate([state, fibres, delay, events])


def _feet(
    angles: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ankles, [leg, xz], and heel and ball of both feet, [leg, point, xz], relative to the hip."""
    legs = angles[1:].reshape(LEGS, 3)
    lengths = np.array([THIGH_LENGTH_M, SHANK_LENGTH_M])
    ankle = -np.stack(
        [
            (lengths * np.sin(legs[:, :2])).sum(axis=1),
            (lengths * np.cos(legs[:, :2])).sum(axis=1),
        ],
        axis=1,
    )
    forward = np.stack([np.cos(legs[:, 2]), -np.sin(legs[:, 2])], axis=1)
    offsets = np.array([HEEL_OFFSET_M, BALL_OFFSET_M])
    return ankle, ankle[:, None, :] + offsets[None, :, None] * forward[:, None, :]


def _state(terrain: Terrain) -> NDArray[np.float64]:
    """Rows of `State`: the stance foot just in the ground, both feet's flags as they touch."""
    angles = np.concatenate(
        [[0.0], np.cumsum(JOINTS_RAD, axis=1).ravel()]
    )  # HAT, then both legs
    ankle, points = _feet(angles)
    depth = (
        terrain.height(points[0, :, 0]) - points[0, :, 1]
    )  # with the hip at height zero
    state = np.zeros(State.count)
    state[State.q + 1] = depth.max() - PENETRATION_M
    state[State.q + 2 : State.q + 9] = angles
    state[State.qdot] = SPEED_MPS
    state[State.qdot + 3 : State.qdot + 5] = STANCE_LEG_RATE_RADPS
    state[State.leg_angle_filter : State.leg_angle_filter + LEGS] = np.pi - np.arctan2(
        -ankle[:, 1], -ankle[:, 0]
    )
    touching = terrain.height(points[:, :, 0]) > points[:, :, 1] + state[State.q + 1]
    state[State.stance_before : State.stance_before + LEGS] = touching.any(axis=1)
    state[State.swing_phase : State.swing_phase + LEGS] = HOLD
    state[State.active] = 1.0
    state[State.end_z] = state[State.q + 1]
    return state


def muscles_and_nerves(
    joints_rad: NDArray[np.float64],
    stance: NDArray[np.float64],
    knee_rates_radps: NDArray[np.float64] | float = 0.0,
    trunk: tuple[float, float] = (0.0, 0.0),
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Rows of `Muscle` of relaxed muscles, and of `Signal` and `Delay` that feel this moment alone.

    Args:
        joints_rad: hip, knee and ankle of both legs, [2, 3].
        stance: 1 for a leg on the ground, else 0, [2].
        knee_rates_radps: [2].
        trunk: lean in rad, and its rate.
    """
    fibres = np.zeros(Muscle.count)
    fibres[Muscle.activation : Muscle.activation + MUSCLE_COUNT] = ACTIVATION_FLOOR
    fibres[Muscle.stimulation : Muscle.stimulation + MUSCLE_COUNT] = ACTIVATION_FLOOR
    signals = np.zeros(Signal.count)
    for leg, angles_rad in enumerate(joints_rad):
        # The fibre of a relaxed muscle takes the unit's length less the tendon's slack.
        lengths = (unit_lengths(*angles_rad) - SLACK_LENGTH_M) / OPTIMAL_LENGTH_M
        first = Muscle.length + MUSCLES_PER_LEG * leg
        fibres[first : first + MUSCLES_PER_LEG] = lengths
        signals[Signal.length_ta + leg] = max(lengths[TA] - TA_LENGTH_OFFSET, 0.0)
    signals[Signal.knee : Signal.knee + LEGS] = joints_rad[:, 1]
    signals[Signal.knee_rate : Signal.knee_rate + LEGS] = knee_rates_radps
    signals[Signal.stance : Signal.stance + LEGS] = stance
    signals[[Signal.trunk, Signal.trunk_rate]] = trunk
    rings = [
        np.repeat(signals[first : first + n], ticks) for first, n, ticks, _row in RINGS
    ]
    return fibres, signals, np.concatenate(rings)
