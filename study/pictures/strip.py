"""A strip of stick figures over the ground they walk on, to scale."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from study.pictures import style
from study.pictures.stick_figure import (
    LEFT,
    activation_bar,
    at_times,
    draw_walker,
    finite,
    last_metres,
    leg,
)
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import Terrain

Array = NDArray[np.float64]

SHOWN_M = 6.6
POSE_SPACING_M = 0.66  # not a whole number of steps: the poses run through the stride
GHOST_INTERVAL_S = 0.04
MARGIN_M = 0.7
NARROWEST_M = 4.0
ABOVE_HIP_M = 0.95
BELOW_GROUND_M = 0.16
SCALE_IN_PER_M = 1.12
KEY = f"Left leg in front. Thin: left leg every {1e3 * GHOST_INTERVAL_S:.0f} ms. Blue: hip."
GROUND_LAYER = 100.0  # over the soles: a foot is a line, and half its drawn width is below it
LEVEL_M = 0.01  # ground that varies by less is level


@dataclass(frozen=True, eq=False)
class Stretch:
    """The last metres of a walk, as they are drawn."""

    terrain: Terrain
    trajectory: Trajectory  # the whole walk, as far as its pose is finite
    poses_s: Array  # times of the poses, [n]
    frame: tuple[float, float, float, float]  # limits of the picture in m: x from, to; z from, to

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the frame."""
        low_x, high_x, low_z, high_z = self.frame
        return high_x - low_x, high_z - low_z

    def draw(self, axes: Axes, hip_colour: str) -> PolyCollection:
        """Draw poses, ghosts and ground to the frame; return muscles, for `activation_bar`."""
        style.tidy(axes)
        axes.grid(False)
        low_x, high_x, low_z, high_z = self.frame
        axes.set(xlim=(low_x, high_x), ylim=(low_z, high_z))  # the bones are as wide as its scale
        q = at_times(self.trajectory, self.trajectory.q, self.poses_s)
        activation = at_times(self.trajectory, self.trajectory.activation, self.poses_s)
        for number in range(len(q)):
            muscles = draw_walker(axes, q[number], activation[number], layer=3.0 + number)
        self._draw_ghosts(axes, hip_colour)
        x = np.linspace(low_x, high_x, 2000)
        _draw_ground(axes, x, self.terrain.height(x), low_z)
        axes.set_ylabel("height (m)", fontsize=style.TEXT_PT, color=style.INK)
        return muscles

    def _draw_ghosts(self, axes: Axes, hip_colour: str) -> None:
        """The left leg and the hip's path between the poses, as in a chronophotograph."""
        times_s = np.arange(self.poses_s[0], self.poses_s[-1], GHOST_INTERVAL_S)
        if not len(times_s):
            return
        near = leg(at_times(self.trajectory, self.trajectory.q, times_s), LEFT)
        chains = list(near.chain()[:, [0, 1, 2, 4]])
        thin = LineCollection(chains, colors=style.FAINT, linewidths=0.4, alpha=0.55, zorder=1.5)
        axes.add_collection(thin, autolim=False)
        axes.plot(*near.hip.T, color=hip_colour, linewidth=0.8, zorder=1.6)


def last_stretch(
    trajectory: Trajectory,
    terrain: Terrain,
    shown_m: float = SHOWN_M,
    width_m: float | None = None,
    below_m: float = BELOW_GROUND_M,
) -> Stretch:
    """The last `shown_m` metres of the hip's way; poses are about `POSE_SPACING_M` apart, evenly.

    The frame is by default as wide as the poses, and shows `below_m` of ground below its lowest
    point.
    """
    trajectory = finite(trajectory)
    start_s, end_s = last_metres(trajectory, shown_m)
    x = np.interp([start_s, end_s], trajectory.time_s, trajectory.q[:, 0])
    count = max(round(abs(x[1] - x[0]) / POSE_SPACING_M), 1) + 1
    poses_s = np.linspace(start_s, end_s, count)
    q = at_times(trajectory, trajectory.q, poses_s)
    width = width_m or max(np.ptp(q[:, 0]) + 2.0 * MARGIN_M, NARROWEST_M)
    low_x = 0.5 * (q[:, 0].min() + q[:, 0].max() - width)
    high_x = low_x + width
    ground = terrain.height(np.linspace(low_x, high_x, 200))
    frame = (low_x, high_x, ground.min() - below_m, q[:, 1].max() + ABOVE_HIP_M)
    return Stretch(terrain, trajectory, poses_s, frame)


def write_strip(
    path: str | Path,
    trajectory: Trajectory,
    terrain: Terrain,
    title: str = "",
    dpi: int = style.PNG_DPI,
) -> Path:
    """Draw the last metres of a walk as poses at their places, muscles coloured by activation.

    Below, where the ground is not level, its profile from the first sample on. A walker that fell
    is shown falling.

    Args:
        path: of the PNG.
        trajectory: of at least one sample; about 50 samples a second or more.
        terrain: the ground it walked on.
        title: one line, such as the name of the gait and how it ended.
        dpi: pixels an inch; half of them take half the time.

    Raises:
        InputError: the file cannot be written.
    """
    shown = last_stretch(trajectory, terrain)
    x = shown.trajectory.q[:, 0]
    ground = terrain.height(np.linspace(x.min(), x.max() + 1.0, 4000))
    figure, axes, bar, profile = _layout(shown.size_m, bool(np.ptp(ground) > LEVEL_M), dpi)
    activation_bar(bar, shown.draw(axes, style.MODEL))
    if profile is not None:
        draw_profile(profile, [shown], [style.MODEL])
        profile.set_xlabel("from the start: distance (m)", fontsize=style.TEXT_PT, color=style.INK)
    axes.set_title(title, loc="left", fontsize=style.TITLE_PT, color=style.INK, pad=20)
    axes.text(0.0, 1.012, KEY, transform=axes.transAxes, fontsize=style.SMALL_PT, color=style.INK)
    return style.save_png(figure, path)


def _layout(
    size_m: tuple[float, float], with_profile: bool, dpi: int
) -> tuple[Figure, Axes, Axes, Axes | None]:
    """Figure, axes of the poses, of the colour bar, and of the profile if there is one."""
    strip_in = size_m[1] * SCALE_IN_PER_M
    profile_in = 1.25 if with_profile else 0.0
    width_in = size_m[0] * SCALE_IN_PER_M + 1.6
    height_in = strip_in + profile_in + 1.05
    figure = style.new_figure(width_in, height_in, dpi)
    box = partial(style.axes_at, figure)
    axes = box(0.6, profile_in + 0.5, width_in - 1.6, strip_in)
    axes.set_aspect("equal", anchor="W")
    axes.set_xlabel("distance (m)", fontsize=style.TEXT_PT, color=style.INK)
    bar = box(width_in - 0.85, profile_in + 0.5 + 0.15 * strip_in, 0.13, 0.7 * strip_in)
    profile = box(0.6, 0.5, width_in - 1.6, profile_in - 0.65) if with_profile else None
    return figure, axes, bar, profile


def draw_profile(axes: Axes, parts: Sequence[Stretch], colours: Sequence[str]) -> None:
    """The ground as far as walks on it came, small, with the stretches marked in their colours."""
    low = min(min(part.trajectory.q[0, 0], part.frame[0]) for part in parts)
    high = max(max(part.trajectory.q[:, 0].max() + 1.0, part.frame[1]) for part in parts)
    x = np.linspace(low, high, 4000)
    height = parts[0].terrain.height(x)
    margin = 0.1 * max(float(np.ptp(height)), 0.5)
    bottom = height.min() - margin
    style.tidy(axes)
    _draw_ground(axes, x, height, bottom)
    axes.set(xlim=(low, high), ylim=(bottom, height.max() + margin))
    axes.set_ylabel("ground (m)", fontsize=style.TEXT_PT, color=style.INK)
    for part, colour in zip(parts, colours, strict=True):
        axes.axvspan(*part.frame[:2], color=colour, alpha=0.25, linewidth=0, zorder=3)


def _draw_ground(axes: Axes, x_m: Array, height_m: Array, bottom_m: float) -> None:
    """The ground's profile, filled down to `bottom_m`."""
    axes.fill_between(x_m, height_m, bottom_m, color=style.GROUND, linewidth=0, zorder=GROUND_LAYER)
    axes.plot(x_m, height_m, color=style.INK, linewidth=1.0, zorder=GROUND_LAYER)
