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
from taichi_nmm.body import BALL_OFFSET_M, HEEL_OFFSET_M, SHANK_LENGTH_M, THIGH_LENGTH_M
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
        if self._device is not None:
            torque_nm = of_side(self._device.torque_nm[number], side)
            worn = of_side(self._device.worn, side)
            draw_device(surface, self._q[number], side, torque_nm, worn)

    def _draw_muscles(
        self, surface: Surface, number: int, side: int, edge: str
    ) -> None:
        gone = ACROSS_ANKLE if self._prosthesis[side] else ()
        there = [place for place, name in enumerate(MUSCLES) if name not in gone]
        outlines = [self._outlines[side][place][number] for place in there]
        activation = of_side(self._activation[number], side)[there]
        surface.muscles(outlines, activation, edge)


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
STRUTS_M = (
    (0.30, 0.28),
    (0.28, 0.25),
    (0.28, 0.13),
)  # up and down, of hip, knee, ankle


@dataclass(frozen=True, eq=False)
class Device:
    """An exoskeleton in n poses.

    Attributes:
        torque_nm: in the order and signs of `Trajectory.joint_rad`, [n, 6].
        worn: the joints that it turns at any time of the walk, bool [6].
    """

    torque_nm: Array
    worn: NDArray[np.bool_]


def device_at(trajectory: Trajectory, times_s: Array) -> Device | None:
    """The exoskeleton of a walk at some times; None where it never turns a joint."""
    torque_nm = np.nan_to_num(trajectory.device_torque_nm)
    worn = np.asarray((torque_nm != 0.0).any(axis=0))
    if not worn.any():
        return None
    return Device(at_times(trajectory, torque_nm, times_s), worn)


def draw_device(
    surface: Surface,
    q: Array,
    side: int,
    torque_nm: Array,
    worn: NDArray[np.bool_],
) -> None:
    """Struts and cuffs about the joints of a leg, and an arrow round each that is turned.

    Args:
        surface: to draw on.
        q: coordinates of the pose, [9].
        side: of the leg.
        torque_nm: on hip, knee and ankle, in the signs of the joints, [3].
        worn: whether there is a device, [3].
    """
    thigh, shank, foot = leg_angles(q, side)
    joints = leg(q, side)
    places = (  # of each joint, and where the links above and below lead from it
        (joints.hip, -down(q[HAT_COLUMN]), down(thigh)),
        (joints.knee, -down(thigh), down(shank)),
        (joints.ankle, -down(shank), forward(foot)),
    )
    for number in np.flatnonzero(worn):
        centre, *links = places[number]
        parts: list[Bone] = []
        for along, reach_m in zip(links, STRUTS_M[number], strict=True):
            end = centre + reach_m * along
            across = CUFF_M * _turned(along, 0.5 * np.pi)
            parts += [(centre, end, STRUT_WIDTH_M)]
            parts += [(end - across, end + across, STRUT_WIDTH_M)]
        surface.bones(parts, style.DEVICE)
        above, below = links
        arc = torque_arc(centre, above - below, float(torque_nm[number]))
        if arc:
            surface.bones(arc, style.TORQUE)


def torque_arc(centre: Array, middle: Array, torque_nm: float) -> list[Bone]:
    """An arrow round a joint, as long as the torque is large; empty for almost none.

    Args:
        centre: of the joint, [2].
        middle: direction from there to the arrow's middle, of any length but 0, [2].
        torque_nm: clockwise, as all joints' positive torques turn the link below.
    """
    angle = torque_nm * ARC_RAD_PNM
    if abs(angle) < LEAST_ARC_RAD:
        return []
    reach = ARC_RADIUS_M / np.linalg.norm(middle) * middle
    turns = np.linspace(-0.5 * angle, 0.5 * angle, ARC_POINTS)
    points = [centre + _turned(reach, float(turn)) for turn in turns]
    back = points[-2] - points[-1]
    back *= TIP_M / np.linalg.norm(back)
    tips = [points[-1] + _turned(back, way) for way in (-TIP_RAD, TIP_RAD)]
    ends = [*pairwise(points), *((points[-1], tip) for tip in tips)]
    return [(start, end, ARC_WIDTH_M) for start, end in ends]


def _turned(vector: Array, angle: float) -> Array:
    """A vector [2], turned clockwise."""
    x, z = vector
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([x * cosine + z * sine, z * cosine - x * sine])


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


NOT_SAMPLED = ("walker", "events", "prosthesis")


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
