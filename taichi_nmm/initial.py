"""The state in which every walk starts: left leg in stance, right leg in swing, 1.3 m/s.

Source: the walker T; the stance leg additionally pivots about its foot instead of
skidding.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.body import BALL_OFFSET_M, HEEL_OFFSET_M, SHANK_LENGTH_M, THIGH_LENGTH_M
from taichi_nmm.kernel.layout import LEGS, MUSCLES_PER_LEG, RINGS, TA, WalkerRows
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
# Thigh and shank turn so: the leg, 1 m long, pivots about its foot.
STANCE_LEG_RATE_RADPS = 1.3
PENETRATION_M = 0.005  # depth of the stance foot's lowest point in the ground
# Hip, knee and ankle of the left leg, then of the right.
JOINTS_RAD = np.deg2rad([[-5.0, 5.0, -5.0], [-30.0, 5.0, 0.0]])


def initial_rows(terrain: Terrain) -> NDArray[np.float64]:
    """Rows of a walker on this terrain, as `WalkerRows` names them, [row]."""
    rows = np.zeros((WalkerRows.count, 1))
    walker = WalkerRows.of(rows)
    _set_pose(walker.state, terrain)
    relax(walker, JOINTS_RAD, walker.state.stance_before[:, 0])
    walker.events.in_stance[0] = 1.0
    walker.events.last_strike_tick[:] = -1.0
    return rows[:, 0]


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


def _set_pose(state: Any, terrain: Terrain) -> None:
    """Rows of `State`, [row, 1]: the stance foot just in the ground, both feet as they touch."""
    legs = np.cumsum(JOINTS_RAD, axis=1).ravel()
    angles = np.concatenate([[0.0], legs])  # of the HAT, then of both legs
    ankle, points = _feet(angles)
    # With the hip at height zero.
    depth = terrain.height(points[0, :, 0]) - points[0, :, 1]
    height = depth.max() - PENETRATION_M
    state.q[:, 0] = [0.0, height, *angles]
    state.qdot[0] = SPEED_MPS
    state.qdot[3:5] = STANCE_LEG_RATE_RADPS
    state.leg_angle_filter[:, 0] = np.pi - np.arctan2(-ankle[:, 1], -ankle[:, 0])
    touching = terrain.height(points[:, :, 0]) > points[:, :, 1] + height
    state.stance_before[:, 0] = touching.any(axis=1)
    state.swing_phase[:] = HOLD
    state.active[:] = 1.0
    state.end_z[:] = height


def relax(
    walker: Any,
    joints_rad: NDArray[np.float64],
    stance: NDArray[np.float64],
    knee_rates_radps: NDArray[np.float64] | float = 0.0,
    trunk: tuple[float, float] = (0.0, 0.0),
) -> None:
    """Relax the muscles, and let the nerves feel this moment alone.

    Args:
        walker: its rows by the names of `WalkerRows`, [row, 1].
        joints_rad: hip, knee and ankle of both legs, [2, 3].
        stance: 1 for a leg on the ground, else 0, [2].
        knee_rates_radps: [2].
        trunk: lean in rad, and its rate.
    """
    walker.fibres.activation[:] = ACTIVATION_FLOOR
    walker.fibres.stimulation[:] = ACTIVATION_FLOOR
    felt = walker.state.felt
    for leg, angles_rad in enumerate(joints_rad):
        # The fibre of a relaxed muscle takes the unit's length less the tendon's slack.
        lengths = (unit_lengths(*angles_rad) - SLACK_LENGTH_M) / OPTIMAL_LENGTH_M
        first = MUSCLES_PER_LEG * leg
        walker.fibres.length[first : first + MUSCLES_PER_LEG, 0] = lengths
        felt.length_ta[leg] = max(lengths[TA] - TA_LENGTH_OFFSET, 0.0)
    felt.knee[:, 0] = joints_rad[:, 1]
    felt.knee_rate[:, 0] = knee_rates_radps
    felt.stance[:, 0] = stance
    felt.trunk[:], felt.trunk_rate[:] = trunk
    for first, signals, ticks, row in RINGS:
        slots = np.repeat(felt[first : first + signals], ticks, axis=0)
        walker.delay[row : row + len(slots)] = slots
