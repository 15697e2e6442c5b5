"""Strips of stick figures over the ground they walk on, to scale; one or several walks."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from study.pictures import stick_figure as stick
from study.pictures import style
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import Terrain

Array = NDArray[np.float64]

SHOWN_M = 6.6
POSE_SPACING_M = 0.66  # not a whole number of steps: the poses run through the stride
GHOST_INTERVAL_S = 0.04
MARGIN_M = 0.7
COMPARED_M = SHOWN_M + 2.0 * MARGIN_M  # width of the strips of several walks
NARROWEST_M = 4.0
ABOVE_HIP_M = 0.95
BELOW_GROUND_M = 0.16
SCALE_IN_PER_M = 1.12
LEFT_IN, RIGHT_IN, TITLE_IN, AXIS_IN, PROFILE_IN = 0.75, 1.0, 0.35, 0.45, 0.7
COLOURS = (style.VERMILION, style.BLUE)  # of two walks
KEY = f"Left leg in front. Thin: left leg every {1e3 * GHOST_INTERVAL_S:.0f} ms. Blue: hip."
GROUND_LAYER = 100.0  # over the soles: half the drawn width of a foot is below them
LEVEL_M = 0.01  # ground that varies by less is level


class AxesSurface:
    """Takes the shapes of a walker on axes whose limits are set, alike in both directions."""

    def __init__(self, axes: Axes, layer: float) -> None:
        """The first shape lies on this layer, and the later ones less than one above it."""
        self._axes, self._layer = axes, layer
        pixels = axes.transData.transform([(0.0, 0.0), (1.0, 0.0)])
        self._points_per_m = float(np.ptp(pixels[:, 0]) * 72.0 / axes.figure.dpi)

    def _next_layer(self) -> float:
        self._layer += 0.1
        return self._layer

    def bones(self, parts: Sequence[stick.Bone], colour: str) -> None:
        """Thick lines with round ends."""
        drawn = LineCollection(
            [np.array([start, end]) for start, end, _ in parts],
            colors=colour,
            capstyle="round",
            linewidths=[self._points_per_m * width_m for *_, width_m in parts],
            zorder=self._next_layer(),
        )
        self._axes.add_collection(drawn, autolim=False)

    def muscles(self, outlines: Sequence[Array], activation: Array, edge: str) -> None:
        """Filled outlines [k, 2], coloured by activation, with a hair line round each."""
        drawn = PolyCollection(
            outlines,
            facecolors=stick.COLOURS(activation),
            edgecolors=edge,
            linewidths=0.4,
            zorder=self._next_layer(),
        )
        self._axes.add_collection(drawn, autolim=False)

    def disc(self, centre_m: Array, radius_m: float, colour: str) -> None:
        """A filled circle."""
        x, z = centre_m
        layer = self._next_layer()
        circle = Circle((x, z), radius_m, facecolor=colour, zorder=layer)
        self._axes.add_patch(circle)

    def joints(self, points_m: Array) -> None:
        """Small dots [k, 2]."""
        self._axes.plot(
            *points_m.T, "o", color=style.INK, ms=2.0, zorder=self._next_layer()
        )


@dataclass(frozen=True, eq=False)
class Stretch:
    """The last metres of a walk, as they are drawn.

    Attributes:
        terrain: the ground below.
        trajectory: the whole walk, as far as its pose is finite.
        poses_s: times of the poses, [n].
        frame: limits of the picture in m: x from, to; z from, to.
    """

    terrain: Terrain
    trajectory: Trajectory
    poses_s: Array
    frame: tuple[float, float, float, float]

    def draw(self, axes: Axes, hip_colour: str) -> None:
        """Draw poses, ghosts and ground to the frame."""
        style.tidy(axes)
        axes.grid(False)
        low_x, high_x, low_z, high_z = self.frame
        # Before the bones, which are as wide as the scale has it.
        axes.set(xlim=(low_x, high_x), ylim=(low_z, high_z))
        walker = stick.Walker(
            stick.at_times(self.trajectory, self.trajectory.q, self.poses_s),
            stick.at_times(self.trajectory, self.trajectory.activation, self.poses_s),
        )
        for number in range(len(self.poses_s)):
            walker.draw(AxesSurface(axes, layer=3.0 + number), number)
        times_s = np.arange(self.poses_s[0], self.poses_s[-1], GHOST_INTERVAL_S)
        if len(times_s):  # the left leg and the hip's path, as in a chronophotograph
            between = stick.at_times(self.trajectory, self.trajectory.q, times_s)
            near = stick.leg(between, stick.LEFT)
            lines = list(near.chain()[:, [0, 1, 2, 4]])
            thin = LineCollection(
                lines, colors=style.FAINT, linewidths=0.4, alpha=0.55, zorder=1.5
            )
            axes.add_collection(thin, autolim=False)
            axes.plot(*near.hip.T, color=hip_colour, linewidth=0.8, zorder=1.6)
        x = np.linspace(low_x, high_x, 2000)
        _draw_ground(axes, x, self.terrain.height(x), low_z)
        axes.set_ylabel("height (m)", fontsize=style.TEXT_PT, color=style.INK)


@dataclass(frozen=True, eq=False)
class Shown:
    """A walk as it was simulated for a picture.

    Attributes:
        label: a word for it, such as "before".
        title: which walk it is, and how it ended.
        trajectory: of about 50 samples a second or more.
    """

    label: str
    title: str
    trajectory: Trajectory


def last_stretch(
    trajectory: Trajectory, terrain: Terrain, width_m: float | None = None
) -> Stretch:
    """The last `SHOWN_M` of the hip's way; poses are about `POSE_SPACING_M` apart, evenly.

    Args:
        trajectory: of at least one finite sample.
        terrain: the ground it walked on.
        width_m: of the frame; None: as wide as the poses.
    """
    trajectory = stick.finite(trajectory)
    way = np.abs(trajectory.q[-1, 0] - trajectory.q[:, 0])  # still to come
    first = max(np.flatnonzero(way > SHOWN_M), default=0)
    count = max(round(way[first] / POSE_SPACING_M), 1) + 1
    poses_s = np.linspace(trajectory.time_s[first], trajectory.time_s[-1], count)
    q = stick.at_times(trajectory, trajectory.q, poses_s)
    width = width_m or max(np.ptp(q[:, 0]) + 2.0 * MARGIN_M, NARROWEST_M)
    low_x = 0.5 * (q[:, 0].min() + q[:, 0].max() - width)
    high_x = low_x + width
    ground = terrain.height(np.linspace(low_x, high_x, 200))
    frame = (low_x, high_x, ground.min() - BELOW_GROUND_M, q[:, 1].max() + ABOVE_HIP_M)
    return Stretch(terrain, trajectory, poses_s, frame)


def write_strip(
    path: str | Path,
    trajectory: Trajectory,
    terrain: Terrain,
    title: str = "",
    dpi: int = style.PNG_DPI,
) -> Path:
    """Draw the last metres of a walk as poses at their places, muscles coloured by activation.

    Below, where the ground is not level, its profile from the first sample on. A walker
    that fell is shown falling.

    Args:
        path: of the PNG.
        trajectory: of at least one sample; about 50 samples a second or more.
        terrain: the ground it walked on.
        title: one line, such as the name of the gait and how it ended.
        dpi: pixels an inch; half of them take half the time.

    Raises:
        InputError: the file cannot be written.
    """
    figure = strips_figure([Shown("", KEY, trajectory)], terrain, title, dpi)
    return style.save_png(figure, path)


def strips_figure(
    walks: Sequence[Shown], terrain: Terrain, title: str, dpi: int = style.PNG_DPI
) -> Figure:
    """Walks on one ground below each other; then, where it is not level, the ground's profile."""
    width_m = COMPARED_M if len(walks) > 1 else None
    parts = [last_stretch(walk.trajectory, terrain, width_m) for walk in walks]
    colours = COLOURS if len(walks) > 1 else (style.MODEL,)
    x = [part.trajectory.q[:, 0] for part in parts]
    from_m, to_m = min(each.min() for each in x), max(each.max() for each in x) + 1.0
    with_profile = np.ptp(terrain.height(np.linspace(from_m, to_m, 4000))) > LEVEL_M
    low_x, high_x, *_ = parts[0].frame
    strip_in = [(part.frame[3] - part.frame[2]) * SCALE_IN_PER_M for part in parts]
    wide_in = (high_x - low_x) * SCALE_IN_PER_M
    width = LEFT_IN + wide_in + RIGHT_IN
    height = TITLE_IN + sum(strip_in) + len(parts) * (TITLE_IN + AXIS_IN)
    height += (PROFILE_IN + AXIS_IN + 0.1) * with_profile
    figure = style.new_figure(width, height, dpi)
    figure.text(
        LEFT_IN / width,
        1.0 - 0.2 / height,
        title,
        fontsize=style.TITLE_PT,
        color=style.INK,
        va="center",
    )
    bottom = height - TITLE_IN
    for walk, part, colour, high_in in zip(
        walks, parts, colours, strip_in, strict=True
    ):
        bottom -= TITLE_IN + high_in
        axes = style.axes_at(figure, LEFT_IN, bottom, wide_in, high_in)
        part.draw(axes, colour)
        axes.set_title(walk.title, loc="left", fontsize=style.TEXT_PT, color=style.INK)
        axes.set_xlabel("distance (m)", fontsize=style.TEXT_PT, color=style.INK)
        bottom -= AXIS_IN
    bar_in, bar_bottom = min(1.6, strip_in[0]), height - 2.0 * TITLE_IN - strip_in[0]
    stick.activation_bar(style.axes_at(figure, width - 0.85, bar_bottom, 0.13, bar_in))
    if with_profile:
        axes = style.axes_at(figure, LEFT_IN, AXIS_IN, wide_in, PROFILE_IN)
        _draw_profile(axes, walks, parts, colours)
    return figure


def _draw_profile(
    axes: Axes, walks: Sequence[Shown], parts: Sequence[Stretch], colours: Sequence[str]
) -> None:
    """The ground as far as walks on it came, small, with the stretches marked in their colours."""
    low = min(min(part.trajectory.q[0, 0], part.frame[0]) for part in parts)
    high = max(
        max(part.trajectory.q[:, 0].max() + 1.0, part.frame[1]) for part in parts
    )
    x = np.linspace(low, high, 4000)
    height = parts[0].terrain.height(x)
    margin = 0.1 * max(float(np.ptp(height)), 0.5)
    bottom = height.min() - margin
    style.tidy(axes)
    _draw_ground(axes, x, height, bottom)
    axes.set(xlim=(low, high), ylim=(bottom, height.max() + margin))
    axes.set_xlabel(
        "from the start: distance (m)", fontsize=style.TEXT_PT, color=style.INK
    )
    axes.text(
        0.005,
        0.97,
        "ground (m)",
        transform=axes.transAxes,
        va="top",
        fontsize=style.SMALL_PT,
        color=style.INK,
        zorder=GROUND_LAYER + 1.0,
    )
    for walk, part, colour in zip(walks, parts, colours, strict=True):
        axes.axvspan(*part.frame[:2], color=colour, alpha=0.25, linewidth=0, zorder=3)
        axes.annotate(
            walk.label,
            xy=(np.mean(part.frame[:2]), 1.0),
            xytext=(0, 2),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="center",
            fontsize=style.SMALL_PT,
            color=colour,
        )


def _draw_ground(axes: Axes, x_m: Array, height_m: Array, bottom_m: float) -> None:
    """The ground's profile, filled down to `bottom_m`."""
    axes.fill_between(
        x_m, height_m, bottom_m, color=style.GROUND, linewidth=0, zorder=GROUND_LAYER
    )
    axes.plot(x_m, height_m, color=style.INK, linewidth=1.0, zorder=GROUND_LAYER)
