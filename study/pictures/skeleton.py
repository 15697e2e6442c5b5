"""Where the joints and the muscles of a walker are drawn, from its coordinates.

All angles clockwise positive, as in the simulator: a thigh or shank points along
D(th) = (-sin th, -cos th), a foot along F(th) = (cos th, -sin th), the trunk along -D(th).
Muscle paths are for the eye: plausible origins and insertions, not the moment arms of the model.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.body import BALL_OFFSET_M, HEEL_OFFSET_M, SHANK_LENGTH_M, THIGH_LENGTH_M
from taichi_nmm.result import MUSCLES

Array = NDArray[np.float64]

SHOULDER_M = 0.50  # above the hip, along the trunk
HEAD_M = 0.69  # centre of the head; the trunk link is 0.80 m long
HEAD_RADIUS_M = 0.105

HAT, THIGH, SHANK, FOOT = range(4)
LEG_COLUMNS = ((2, 3, 4, 5), (2, 6, 7, 8))  # th of HAT, thigh, shank, foot in q; left, right

# A path is a list of points (segment, metres along it, metres in front of it).
MUSCLE_PATHS: dict[str, tuple[tuple[int, float, float], ...]] = {
    "SOL": ((SHANK, 0.12, -0.022), (SHANK, 0.27, -0.045), (FOOT, -0.040, 0.005)),
    "TA": ((SHANK, 0.10, 0.028), (SHANK, 0.33, 0.042), (FOOT, 0.070, 0.010)),
    "GAS": ((THIGH, 0.45, -0.038), (SHANK, 0.13, -0.078), (FOOT, -0.042, 0.008)),
    "VAS": ((THIGH, 0.14, 0.038), (THIGH, 0.42, 0.075), (SHANK, 0.07, 0.033)),
    "HAM": ((HAT, -0.02, -0.065), (THIGH, 0.28, -0.075), (SHANK, 0.06, -0.033)),
    "GLU": ((HAT, 0.13, -0.085), (HAT, -0.01, -0.135), (THIGH, 0.15, -0.033)),
    "HFL": ((HAT, 0.16, 0.045), (HAT, 0.01, 0.110), (THIGH, 0.13, 0.030)),
}
BELLY_M: dict[str, float] = {  # half the thickness drawn, about with the cube root of F_max
    "SOL": 0.021, "TA": 0.014, "GAS": 0.018, "VAS": 0.024, "HAM": 0.021, "GLU": 0.022, "HFL": 0.019,
}  # fmt: skip
PATH_POINTS = 15


@dataclass(frozen=True, eq=False)
class Leg:
    """Joint positions of one leg, each [..., 2] in metres."""

    hip: Array
    knee: Array
    ankle: Array
    heel: Array
    ball: Array

    def chain(self) -> Array:
        """Hip, knee, ankle, heel, ball, [..., 5, 2]; the ankle lies on the foot's line."""
        return np.stack([self.hip, self.knee, self.ankle, self.heel, self.ball], axis=-2)


def down(angle: Array) -> Array:
    """D(th): direction of a thigh or shank, [..., 2]."""
    return np.stack([-np.sin(angle), -np.cos(angle)], axis=-1)


def forward(angle: Array) -> Array:
    """F(th): direction of a foot, and of the front of every other link, [..., 2]."""
    return np.stack([np.cos(angle), -np.sin(angle)], axis=-1)


def leg(q: Array, side: int) -> Leg:
    """The left (0) or right (1) leg of coordinates q [..., 9]."""
    _, thigh, shank, foot = (q[..., column] for column in LEG_COLUMNS[side])
    hip = q[..., :2]
    knee = hip + THIGH_LENGTH_M * down(thigh)
    ankle = knee + SHANK_LENGTH_M * down(shank)
    heel = ankle + HEEL_OFFSET_M * forward(foot)
    return Leg(hip, knee, ankle, heel, ankle + BALL_OFFSET_M * forward(foot))


def trunk(q: Array) -> tuple[Array, Array]:
    """Shoulder and centre of the head of poses q [..., 9], each [..., 2]."""
    hip, axis = q[..., :2], -down(q[..., 2])
    return hip + SHOULDER_M * axis, hip + HEAD_M * axis


def muscle_outlines(q: Array, side: int) -> list[Array]:
    """Closed outlines of the seven muscles of a leg in poses q [..., 9], order of `MUSCLES`."""
    frames = _frames(q, side)
    return [_belly(_path(frames, name), BELLY_M[name]) for name in MUSCLES]


def _frames(q: Array, side: int) -> list[tuple[Array, Array, Array]]:
    """Origin, axis and front of HAT, thigh, shank and foot, each [..., 2]."""
    angles = [q[..., column] for column in LEG_COLUMNS[side]]
    joints = leg(q, side)
    axes = [-down(angles[HAT]), down(angles[THIGH]), down(angles[SHANK]), forward(angles[FOOT])]
    fronts = [forward(angle) for angle in angles[:FOOT]] + [-down(angles[FOOT])]
    return list(zip((joints.hip, joints.hip, joints.knee, joints.ankle), axes, fronts, strict=True))


def _path(frames: list[tuple[Array, Array, Array]], name: str) -> Array:
    """A smooth line from origin to insertion that bends towards the middle point, [..., k, 2]."""
    points = []
    for segment, along, ahead in MUSCLE_PATHS[name]:
        origin, axis, front = frames[segment]
        points.append((origin + along * axis + ahead * front)[..., None, :])
    start, middle, end = points
    s = np.linspace(0.0, 1.0, PATH_POINTS)[:, None]
    control = 2.0 * middle - 0.5 * (start + end)  # the curve passes through the middle point
    control = 0.5 * (control + middle)  # bend less than that: a belly, not a bow
    return np.asarray((1 - s) ** 2 * start + 2 * s * (1 - s) * control + s**2 * end)


def _belly(path: Array, half_thickness: float) -> Array:
    """Outline of a spindle round a path [..., k, 2]."""
    tangent = np.gradient(path, axis=-2)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    normal = np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)
    s = np.linspace(0.0, 1.0, path.shape[-2])
    thickness = half_thickness * (0.12 + 0.88 * np.sin(np.pi * s) ** 1.3)[:, None]
    there, back = path + thickness * normal, (path - thickness * normal)[..., ::-1, :]
    return np.concatenate([there, back], axis=-2)
