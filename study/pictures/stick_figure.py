"""A walker as a stick figure with muscles, its ground, and the part of a walk that is shown.

All angles clockwise positive, as in the simulator: a thigh or shank points along D(th)
= (-sin th, -cos th), a foot along F(th) = (cos th, -sin th), the trunk along -D(th).
Muscle paths are for the eye: plausible origins and insertions, not the moment arms of
the model.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.patches import Circle
from numpy.typing import NDArray

from storage.inputs.errors import InputError
from study.pictures import style
from taichi_nmm.body import BALL_OFFSET_M, HEEL_OFFSET_M, SHANK_LENGTH_M, THIGH_LENGTH_M
from taichi_nmm.result import MUSCLES, Trajectory

Array = NDArray[np.float64]
Bone = tuple[Array, Array, float]  # its ends, each [2], and its width in metres

LEFT, RIGHT = 0, 1
FULL_ACTIVATION = Normalize(0.0, 1.0)
TRUNK_WIDTH_M = 0.15
WIDTHS_M = (0.09, 0.06, 0.04)  # of thigh, shank and foot


def draw_walker(axes: Axes, q: Array, activation: Array, layer: float) -> None:
    """Draw a pose q [9] on axes whose limits are set.

    The scale is alike in both directions. `activation` is of the muscles, left leg
    first, [14]; `layer` is that of the far leg, and all else is less than one above it.
    """
    near, far = leg(q, LEFT), leg(q, RIGHT)
    shoulder, head = trunk(q)
    pixels = axes.transData.transform([(0.0, 0.0), (1.0, 0.0)])
    points_per_m = float((pixels[1, 0] - pixels[0, 0]) * 72.0 / axes.figure.dpi)

    def bones(parts: Sequence[Bone], colour: str, above: float) -> None:
        lines = [np.array([start, end]) for start, end, _ in parts]
        widths = [points_per_m * width_m for *_, width_m in parts]
        drawn = LineCollection(
            lines,
            colors=colour,
            capstyle="round",
            linewidths=widths,
            zorder=layer + above,
        )
        axes.add_collection(drawn, autolim=False)

    def muscles(side: int, edge: str, above: float) -> None:
        drawn = PolyCollection(
            muscle_outlines(q, side),
            cmap=style.ACTIVATION_MAP,
            norm=FULL_ACTIVATION,
            edgecolors=edge,
            linewidths=0.4,
            zorder=layer + above,
        )
        drawn.set_array(activation[len(MUSCLES) * side :][: len(MUSCLES)])
        axes.add_collection(drawn, autolim=False)

    bones(far.bones(), style.FAR_LIMB, 0.0)
    muscles(RIGHT, style.FAINT, 0.1)
    bones([(q[:2], shoulder, TRUNK_WIDTH_M)], style.NEAR_LIMB, 0.2)
    axes.add_patch(
        Circle(
            (head[0], head[1]),
            HEAD_RADIUS_M,
            facecolor=style.NEAR_LIMB,
            zorder=layer + 0.2,
        )
    )
    bones(near.bones(), style.NEAR_LIMB, 0.3)
    muscles(LEFT, style.INK, 0.4)
    axes.plot(*near.chain()[:3].T, "o", color=style.INK, ms=2.0, zorder=layer + 0.5)


def activation_bar(axes: Axes) -> None:
    """The colour bar of the activations, in axes of its own."""
    colours = ScalarMappable(FULL_ACTIVATION, style.ACTIVATION_MAP)
    bar = axes.figure.colorbar(colours, cax=axes, ticks=[0, 0.5, 1])
    bar.set_label("muscle activation (1)", fontsize=style.SMALL_PT, color=style.INK)
    bar.ax.tick_params(labelsize=style.SMALL_PT, colors=style.INK, length=2)
    bar.outline.set_visible(False)


SHOULDER_M = 0.50  # above the hip, along the trunk
HEAD_M = 0.69  # centre of the head; the trunk link is 0.80 m long
HEAD_RADIUS_M = 0.105

LEG_COLUMNS = (
    (2, 3, 4, 5),
    (2, 6, 7, 8),
)  # th of HAT, thigh, shank, foot in q; left, right

DRAWN = tomllib.loads(
    Path(__file__).with_name("muscle_paths.toml").read_text(encoding="utf-8")
)
PATH_POINTS = 15


@dataclass(frozen=True, eq=False)
class Leg:
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
        return np.stack(
            [self.hip, self.knee, self.ankle, self.heel, self.ball], axis=-2
        )

    def bones(self) -> list[Bone]:
        """Thigh, shank and foot of one pose."""
        ends = (self.hip, self.knee), (self.knee, self.ankle), (self.heel, self.ball)
        return [(*pair, width) for pair, width in zip(ends, WIDTHS_M, strict=True)]


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
    paths = zip(MUSCLES, muscle_paths(q, side), strict=True)
    return [_belly(path, DRAWN[name]["belly_m"]) for name, path in paths]


def muscle_paths(q: Array, side: int) -> list[Array]:
    """The lines along which these muscles run, each [..., `PATH_POINTS`, 2]."""
    hat, thigh, shank, foot = (q[..., column] for column in LEG_COLUMNS[side])
    joints = leg(q, side)
    frames = {
        "hat": (joints.hip, -down(hat), forward(hat)),
        "thigh": (joints.hip, down(thigh), forward(thigh)),
        "shank": (joints.knee, down(shank), forward(shank)),
        "foot": (joints.ankle, forward(foot), -down(foot)),
    }
    return [_path(frames, name) for name in MUSCLES]


def _path(frames: dict[str, tuple[Array, Array, Array]], name: str) -> Array:
    """A smooth line from origin to insertion that bends towards the middle point, [..., k, 2].

    `frames` has origin, axis and front of each segment, each [..., 2].
    """
    points = []
    for segment, along, ahead in DRAWN[name]["path"]:
        origin, axis, front = frames[segment]
        points.append((origin + along * axis + ahead * front)[..., None, :])
    start, middle, end = points
    s = np.linspace(0.0, 1.0, PATH_POINTS)[:, None]
    control = 2.0 * middle - 0.5 * (
        start + end
    )  # the curve passes through the middle point
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


NOT_SAMPLED = ("walker", "events")


def finite(trajectory: Trajectory) -> Trajectory:
    """The samples whose pose is finite: those before a walker diverged.

    Raises:
        InputError: there is none.
    """
    good = np.isfinite(trajectory.q).all(axis=1)
    if not good.any():
        raise InputError("trajectory", "no finite sample", "a walker that was recorded")
    if good.all():
        return trajectory
    per_sample = [
        field.name for field in fields(trajectory) if field.name not in NOT_SAMPLED
    ]
    return replace(
        trajectory, **{name: getattr(trajectory, name)[good] for name in per_sample}
    )


def at_times(trajectory: Trajectory, values: Array, times_s: Array) -> Array:
    """Columns of `values` [t, k] at these times, linear between samples, [len(times_s), k]."""
    columns = [np.interp(times_s, trajectory.time_s, column) for column in values.T]
    return np.stack(columns, axis=1)
