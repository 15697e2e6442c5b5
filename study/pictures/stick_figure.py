"""A walker as a stick figure with muscles, its ground, and the part of a walk that is shown.

All angles clockwise positive, as in the simulator: a thigh or shank points along D(th)
= (-sin th, -cos th), a foot along F(th) = (cos th, -sin th), the trunk along -D(th).
Muscle paths are for the eye: plausible origins and insertions, not the moment arms of
the model.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from numpy.typing import NDArray

from storage.inputs.errors import InputError
from study.pictures import style
from taichi_nmm.body import (
    BALL_OFFSET_M,
    HAT,
    HEEL_OFFSET_M,
    SHANK_LENGTH_M,
    THIGH_LENGTH_M,
)
from taichi_nmm.result import MUSCLES, Trajectory
from taichi_nmm.world import ACROSS_ANKLE

Array = NDArray[np.float64]
Bone = tuple[Array, Array, float]  # its ends, each [2], and its width in metres

LEFT, RIGHT = 0, 1
COLOURS = matplotlib.colormaps[style.ACTIVATION_MAP]  # of activations, 0 to 1
TRUNK_WIDTH_M = 0.15
WIDTHS_M = (0.09, 0.06, 0.04)  # of thigh, shank and foot


class Surface(Protocol):
    """On which a walker is drawn, in metres; what comes later covers what is there."""

    def bones(self, parts: Sequence[Bone], colour: str) -> None:
        """Thick lines with round ends."""

    def muscles(self, outlines: Sequence[Array], activation: Array, edge: str) -> None:
        """Filled outlines [k, 2], coloured by activation, with a hair line round each."""

    def disc(self, centre_m: Array, radius_m: float, colour: str) -> None:
        """A filled circle."""

    def joints(self, points_m: Array) -> None:
        """Small dots [k, 2]."""


class Walker:
    """A walker in n poses, with its muscles; the left leg is in front."""

    def __init__(
        self,
        q: Array,
        activation: Array,
        device: "Device | None" = None,
        prosthesis: Sequence[bool] = (False, False),
    ) -> None:
        """Prepare what is drawn of all poses.

        Args:
            q: generalised coordinates, [n, 9].
            activation: of the muscles, left leg first, 0 to 1, [n, 14].
            device: an exoskeleton in the same poses; None: it wears none.
            prosthesis: whether the left leg, and the right, has one.
        """
        self._q = q
        self._activation = activation
        self._device = device
        self._prosthesis = prosthesis
        self._gone = gone_muscles(prosthesis)
        self._outlines = [muscle_outlines(q, side) for side in (LEFT, RIGHT)]

    def draw(self, surface: Surface, number: int) -> None:
        """Draw a pose, by its number."""
        q = self._q[number]
        near, far = leg(q, LEFT), leg(q, RIGHT)
        shoulder, head = trunk(q)
        self._draw_bones(surface, far, RIGHT, style.FAR_LIMB)
        self._draw_muscles(surface, number, RIGHT, style.FAINT)
        self._draw_device(surface, number, RIGHT)
        surface.bones([(near.hip, shoulder, TRUNK_WIDTH_M)], style.NEAR_LIMB)
        surface.disc(head, HEAD_RADIUS_M, style.NEAR_LIMB)
        self._draw_bones(surface, near, LEFT, style.NEAR_LIMB)
        self._draw_muscles(surface, number, LEFT, style.INK)
        surface.joints(near.chain()[:3])
        self._draw_device(surface, number, LEFT)

    def _draw_bones(
        self, surface: Surface, joints: "Leg", side: int, colour: str
    ) -> None:
        bones = joints.bones()
        if self._prosthesis[side]:
            thigh, (knee, ankle, width_m), foot = bones
            stump = 0.5 * (knee + ankle)
            surface.bones([thigh, (knee, stump, width_m)], colour)
            bones, colour = [(stump, ankle, PYLON_WIDTH_M), foot], style.DEVICE
        surface.bones(bones, colour)

    def _draw_device(self, surface: Surface, number: int, side: int) -> None:
        if self._device is None:
            return
        for lines, width_m, colour in (
            (self._device.struts, STRUT_WIDTH_M, style.DEVICE),
            (self._device.arrows, ARC_WIDTH_M, style.TORQUE),
        ):
            own = np.split(lines[number], 2)[side]
            bones = [
                (start, end, width_m)
                for line in own[np.isfinite(own).all(axis=(1, 2))]
                for start, end in pairwise(line)
            ]
            if bones:
                surface.bones(bones, colour)

    def _draw_muscles(
        self, surface: Surface, number: int, side: int, edge: str
    ) -> None:
        (there,) = np.nonzero(~of_side(self._gone, side))
        outlines = [self._outlines[side][place][number] for place in there]
        activation = of_side(self._activation[number], side)[there]
        surface.muscles(outlines, activation, edge)


def gone_muscles(prosthesis: Sequence[bool]) -> NDArray[np.bool_]:
    """Which muscles legs with a prosthesis lack, left leg first, bool [14]."""
    return np.array(
        [one and name in ACROSS_ANKLE for one in prosthesis for name in MUSCLES]
    )


def activation_bar(axes: Axes) -> None:
    """The colour bar of the activations, in axes of its own."""
    colours = ScalarMappable(Normalize(0.0, 1.0), COLOURS)
    bar = axes.figure.colorbar(colours, cax=axes, ticks=[0, 0.5, 1])
    bar.set_label("muscle activation (1)", **style.SMALL)
    bar.ax.tick_params(labelsize=style.SMALL_PT, colors=style.INK, length=2)
    bar.outline.set_visible(False)


PYLON_WIDTH_M = 0.03  # of a prosthesis, below the middle of the shank
STRUT_WIDTH_M = 0.016
CUFF_M = 0.035  # half of its length, across the link
ARC_RADIUS_M = 0.13
ARC_WIDTH_M = 0.024
ARC_RAD_PNM = 3.0 / 80.0  # the largest torque of a curve, 80 N m, is half a turn
LEAST_ARC_RAD = 0.1
ARC_POINTS = 12
TIP_M = 0.06  # of the arrow at the end of an arc
TIP_RAD = 0.5  # between its sides and the arc
# Of hip, knee and ankle, along the link above and along that below.
STRUTS_M = ((0.30, 0.28, 0.28), (0.28, 0.25, 0.13))


@dataclass(frozen=True, eq=False)
class Device:
    """An exoskeleton in n poses, as lines; NaN where nothing is drawn.

    Attributes:
        struts: from a joint along a link, and a cuff across it: two of each joint, in
            the order of `Trajectory.joint_rad`, [n, 12, 4, 2].
        arrows: round these joints, [n, 6, `ARC_POINTS` + 3, 2].
    """

    struts: Array
    arrows: Array


def device_at(trajectory: Trajectory, times_s: Array) -> Device | None:
    """The exoskeleton of a walk at some times; None where it never turns a joint."""
    torque_nm = np.nan_to_num(trajectory.device_torque_nm)
    worn = (torque_nm != 0.0).any(axis=0)
    if not worn.any():
        return None
    q = at_times(trajectory, trajectory.q, times_s)
    places, above, below = [], [], []
    for side in (LEFT, RIGHT):
        thigh, shank, foot = leg_angles(q, side)
        hip, knee, ankle, *_ = leg(q, side)
        places += [hip, knee, ankle]
        above += [-down(q[:, HAT_COLUMN]), -down(thigh), -down(shank)]
        below += [down(thigh), down(shank), forward(foot)]
    centre, *links = (np.stack(each, axis=1) for each in (places, above, below))
    struts = []
    for along, reach_m in zip(links, STRUTS_M, strict=True):
        end = centre + np.tile(reach_m, 2)[:, None] * along
        across = CUFF_M * _turned(along, 0.5 * np.pi)
        struts.append(np.stack([centre, end, end - across, end + across], axis=2))
    drawn = np.where(worn[:, None, None, None], np.stack(struts, axis=2), np.nan)
    turning_nm = at_times(trajectory, torque_nm, times_s)
    return Device(
        struts=drawn.reshape(len(q), -1, *drawn.shape[-2:]),
        arrows=torque_arrows(centre, links[0] - links[1], turning_nm),
    )


def torque_arrows(centre: Array, middle: Array, torque_nm: Array) -> Array:
    """Arrows round joints, as long as the torques are large; NaN for almost none.

    A line has the points of an arc, then of the tip: [..., `ARC_POINTS` + 3, 2].

    Args:
        centre: of each joint, [..., 2].
        middle: direction from there to the arrow's middle, of any length but 0, likewise.
        torque_nm: clockwise, as all joints' positive torques turn the link below, [...].
    """
    angle = torque_nm[..., None] * ARC_RAD_PNM
    reach = ARC_RADIUS_M / np.linalg.norm(middle, axis=-1, keepdims=True) * middle
    turns = angle * np.linspace(-0.5, 0.5, ARC_POINTS)
    arc = centre[..., None, :] + _turned(reach[..., None, :], turns)
    end = arc[..., -1:, :]
    back = arc[..., -2:-1, :] - end
    # Of no torque, of which nothing is drawn, all points are one.
    back *= TIP_M / np.maximum(np.linalg.norm(back, axis=-1, keepdims=True), 1e-9)
    sides = [end + _turned(back, way) for way in (-TIP_RAD, TIP_RAD)]
    line = np.concatenate([arc, sides[0], end, sides[1]], axis=-2)
    return np.where(np.abs(angle[..., None]) < LEAST_ARC_RAD, np.nan, line)


def _turned(vector: Array, angle: Array | float) -> Array:
    """Vectors [..., 2], turned clockwise by angles [...]."""
    x, z = np.moveaxis(vector, -1, 0)
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([x * cosine + z * sine, z * cosine - x * sine], axis=-1)


FORCE_M_PER_N = 0.6 / 785.0  # one body weight of 80 kg is 0.6 m long
LEAST_PUSH_N = 1.0  # that is seen


def push_arrows(q: Array, push_n: Array) -> Array:
    """Of pushes forwards [n] in poses [n, 9] tail and tip, [n, 2, 2]; NaN where there is none.

    The tip is the trunk's centre of mass.
    """
    mass = q[:, :2] - HAT.com_m * down(q[:, HAT_COLUMN])
    there = np.where(np.abs(push_n) < LEAST_PUSH_N, np.nan, push_n)
    behind = mass - FORCE_M_PER_N * np.stack([there, np.zeros_like(there)], axis=1)
    return np.stack([behind, mass], axis=1)


SHOULDER_M = 0.50  # above the hip, along the trunk
HEAD_M = 0.69  # centre of the head; the trunk link is 0.80 m long
HEAD_RADIUS_M = 0.105

HAT_COLUMN = 2  # of q: the trunk's angle
FIRST_LEG_COLUMN = 3  # of q: thigh, shank and foot of the left leg, then of the right

DRAWN = tomllib.loads(
    Path(__file__).with_name("muscle_paths.toml").read_text(encoding="utf-8")
)
PATH_POINTS = 15


class Leg(NamedTuple):
    """Joint positions of one leg, each x and z in metres, [..., 2].

    Attributes:
        hip: where the trunk begins, too.
        knee: between thigh and shank.
        ankle: on the line of the foot.
        heel: its hindmost point.
        ball: its foremost point.
    """

    hip: Array
    knee: Array
    ankle: Array
    heel: Array
    ball: Array

    def chain(self) -> Array:
        """Hip, knee, ankle, heel, ball, [..., 5, 2]; the ankle lies on the foot's line."""
        return np.stack(self, axis=-2)

    def bones(self) -> list[Bone]:
        """Thigh, shank and foot of one pose."""
        thigh_m, shank_m, foot_m = WIDTHS_M
        return [
            (self.hip, self.knee, thigh_m),
            (self.knee, self.ankle, shank_m),
            (self.heel, self.ball, foot_m),
        ]


def of_side(values: NDArray[Any], side: int) -> NDArray[Any]:
    """What belongs to a leg, [..., k], of columns [..., 2 k]: those of the left, then of the right.

    Args:
        values: of both legs, such as `Trajectory.joint_rad`.
        side: `LEFT` (0) or `RIGHT` (1).
    """
    return np.split(values, 2, axis=-1)[side]


def leg_angles(q: Array, side: int) -> Array:
    """Thigh, shank and foot of a leg in coordinates or rates [..., 9], each [...], [3, ...]."""
    return np.moveaxis(of_side(q[..., FIRST_LEG_COLUMN:], side), -1, 0)


def down(angle: Array) -> Array:
    """D(th): direction of a thigh or shank, [..., 2]."""
    return np.stack([-np.sin(angle), -np.cos(angle)], axis=-1)


def forward(angle: Array) -> Array:
    """F(th): direction of a foot, and of the front of every other link, [..., 2]."""
    return np.stack([np.cos(angle), -np.sin(angle)], axis=-1)


def leg(q: Array, side: int) -> Leg:
    """The left (0) or right (1) leg of coordinates q [..., 9]."""
    thigh, shank, foot = leg_angles(q, side)
    hip = q[..., :2]
    knee = hip + THIGH_LENGTH_M * down(thigh)
    ankle = knee + SHANK_LENGTH_M * down(shank)
    along = forward(foot)
    return Leg(
        hip=hip,
        knee=knee,
        ankle=ankle,
        heel=ankle + HEEL_OFFSET_M * along,
        ball=ankle + BALL_OFFSET_M * along,
    )


def trunk(q: Array) -> tuple[Array, Array]:
    """Shoulder and centre of the head of poses q [..., 9], each [..., 2]."""
    hip = q[..., :2]
    axis = -down(q[..., HAT_COLUMN])
    return hip + SHOULDER_M * axis, hip + HEAD_M * axis


def muscle_outlines(q: Array, side: int) -> list[Array]:
    """Closed outlines of the seven muscles of a leg in poses q [..., 9], order of `MUSCLES`."""
    paths = zip(MUSCLES, muscle_paths(q, side), strict=True)
    return [_belly(path, DRAWN[name]["belly_m"]) for name, path in paths]


def muscle_paths(q: Array, side: int) -> list[Array]:
    """The lines along which these muscles run, each [..., `PATH_POINTS`, 2]."""
    thigh, shank, foot = leg_angles(q, side)
    hat = q[..., HAT_COLUMN]
    joints = leg(q, side)
    frames = {  # origin, axis and front of each segment
        "hat": (joints.hip, -down(hat), forward(hat)),
        "thigh": (joints.hip, down(thigh), forward(thigh)),
        "shank": (joints.knee, down(shank), forward(shank)),
        "foot": (joints.ankle, forward(foot), -down(foot)),
    }
    lines = []
    for name in MUSCLES:
        points = []
        for segment, along, ahead in DRAWN[name]["path"]:
            origin, axis, front = frames[segment]
            points.append((origin + along * axis + ahead * front)[..., None, :])
        lines.append(_smooth(*points))
    return lines


def _smooth(start: Array, middle: Array, end: Array) -> Array:
    """A line from origin to insertion that bends towards the middle point, [..., k, 2]."""
    s = np.linspace(0.0, 1.0, PATH_POINTS)[:, None]
    through = 2.0 * middle - 0.5 * (start + end)  # the curve passes through the middle
    control = 0.5 * (through + middle)  # bend less than that: a belly, not a bow
    return np.asarray((1 - s) ** 2 * start + 2 * s * (1 - s) * control + s**2 * end)


def _belly(path: Array, half_thickness: float) -> Array:
    """Outline of a spindle round a path [..., k, 2]."""
    tangent = np.gradient(path, axis=-2)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    normal = np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)
    s = np.linspace(0.0, 1.0, path.shape[-2])
    thickness = half_thickness * (0.12 + 0.88 * np.sin(np.pi * s) ** 1.3)[:, None]
    there = path + thickness * normal
    back = path - thickness * normal
    return np.concatenate([there, back[..., ::-1, :]], axis=-2)


NOT_SAMPLED = ("walker", "events", "prosthesis", "push", "slip")


def samples(trajectory: Trajectory, chosen: slice | NDArray[np.bool_]) -> Trajectory:
    """Some of the samples of a walk, with all of its events."""
    names = {field.name for field in fields(trajectory)}.difference(NOT_SAMPLED)
    return replace(
        trajectory, **{name: getattr(trajectory, name)[chosen] for name in names}
    )


def finite(trajectory: Trajectory) -> Trajectory:
    """The samples whose pose is finite: those before a walker diverged.

    Raises:
        InputError: there is none.
    """
    good = np.asarray(np.isfinite(trajectory.q).all(axis=1))
    if not good.any():
        raise InputError("trajectory", "no finite sample", "a walker that was recorded")
    return trajectory if good.all() else samples(trajectory, good)


def at_times(trajectory: Trajectory, values: Array, times_s: Array) -> Array:
    """Columns of `values` [t, k] at these times, linear between samples, [len(times_s), k]."""
    columns = [np.interp(times_s, trajectory.time_s, column) for column in values.T]
    return np.stack(columns, axis=1)
