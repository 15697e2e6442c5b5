"""A strip of stick figures over the ground they walk on, to scale."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from study.pictures import style
from study.pictures.stick_figure import (
    LEFT,
    StickFigure,
    activation_bar,
    at_times,
    draw_ground,
    draw_profile,
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
LEVEL_M = 0.01  # ground that varies by less is level


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
    trajectory = finite(trajectory)
    poses_s = pose_times(trajectory, SHOWN_M)
    q = at_times(trajectory, trajectory.q, poses_s)
    low_x, high_x, low_z, high_z = _frame(q, terrain)
    figure, axes, bar, profile = _layout(
        high_x - low_x, high_z - low_z, _uneven(trajectory, terrain), dpi
    )
    axes.set(xlim=(low_x, high_x), ylim=(low_z, high_z))
    activation_bar(bar, draw_poses(axes, trajectory, poses_s))
    draw_ghosts(axes, trajectory, poses_s, style.MODEL)
    x = np.linspace(low_x, high_x, 2000)
    draw_ground(axes, x, terrain.height(x), low_z)
    if profile is not None:
        _draw_profile(profile, trajectory, terrain, (low_x, high_x))
    axes.set_title(title, loc="left", fontsize=style.TITLE_PT, color=style.INK, pad=20)
    axes.text(0.0, 1.012, KEY, transform=axes.transAxes, fontsize=style.SMALL_PT, color=style.INK)
    return style.save_png(figure, path)


def pose_times(trajectory: Trajectory, shown_m: float) -> Array:
    """Times of poses over the last metres, evenly spaced, so many that they are a step apart."""
    start_s, end_s = last_metres(trajectory, shown_m)
    x = np.interp([start_s, end_s], trajectory.time_s, trajectory.q[:, 0])
    count = max(round(abs(x[1] - x[0]) / POSE_SPACING_M), 1) + 1
    return np.linspace(start_s, end_s, count)


def _frame(q: Array, terrain: Terrain) -> tuple[float, float, float, float]:
    """Limits of the picture: x from, to; z from, to."""
    middle = 0.5 * (q[:, 0].min() + q[:, 0].max())
    width = max(np.ptp(q[:, 0]) + 2.0 * MARGIN_M, NARROWEST_M)
    low_x, high_x = middle - 0.5 * width, middle + 0.5 * width
    ground = terrain.height(np.linspace(low_x, high_x, 200))
    return low_x, high_x, ground.min() - BELOW_GROUND_M, q[:, 1].max() + ABOVE_HIP_M


def _uneven(trajectory: Trajectory, terrain: Terrain) -> bool:
    x = trajectory.q[:, 0]
    ground = terrain.height(np.linspace(x.min(), x.max() + 1.0, 4000))
    return bool(np.ptp(ground) > LEVEL_M)


def _layout(
    width_m: float, height_m: float, with_profile: bool, dpi: int
) -> tuple[Figure, Axes, Axes, Axes | None]:
    """Figure, axes of the poses, of the colour bar, and of the profile if one is wanted."""
    strip_in = height_m * SCALE_IN_PER_M
    profile_in = 1.25 if with_profile else 0.0
    width_in = width_m * SCALE_IN_PER_M + 1.6
    height_in = strip_in + profile_in + 1.05
    figure = style.new_figure(width_in, height_in, dpi)

    def box(left: float, bottom: float, width: float, height: float) -> Axes:
        return figure.add_axes(
            (left / width_in, bottom / height_in, width / width_in, height / height_in)
        )

    axes = box(0.6, profile_in + 0.5, width_in - 1.6, strip_in)
    axes.set_aspect("equal", anchor="W")
    style.tidy(axes)
    axes.grid(False)
    axes.set_xlabel("distance (m)", fontsize=style.TEXT_PT, color=style.INK)
    axes.set_ylabel("height (m)", fontsize=style.TEXT_PT, color=style.INK)
    bar = box(width_in - 0.85, profile_in + 0.5 + 0.15 * strip_in, 0.13, 0.7 * strip_in)
    profile = box(0.6, 0.5, width_in - 1.6, profile_in - 0.65) if with_profile else None
    return figure, axes, bar, profile


def draw_poses(axes: Axes, trajectory: Trajectory, times_s: Array) -> StickFigure:
    """The walker at these times, [n]: one over the other, the last of which is returned.

    The axes' limits must be set: the bones are as wide as their scale says.
    """
    q = at_times(trajectory, trajectory.q, times_s)
    activation = at_times(trajectory, trajectory.activation, times_s)
    for number in range(len(times_s)):
        figure = StickFigure(axes, layer=3.0 + number)
        figure.pose(q[number], activation[number])
    return figure


def draw_ghosts(axes: Axes, trajectory: Trajectory, poses_s: Array, hip_colour: str) -> None:
    """The left leg and the hip's path between the poses, as a chronophotograph has them."""
    times_s = np.arange(poses_s[0], poses_s[-1], GHOST_INTERVAL_S)
    if not len(times_s):
        return
    near = leg(at_times(trajectory, trajectory.q, times_s), LEFT)
    chains = near.chain()[:, [0, 1, 2, 4]]
    axes.add_collection(
        LineCollection(list(chains), colors=style.FAINT, linewidths=0.4, alpha=0.55, zorder=1.5),
        autolim=False,
    )
    axes.plot(*near.hip.T, color=hip_colour, linewidth=0.8, zorder=1.6)


def _draw_profile(
    axes: Axes, trajectory: Trajectory, terrain: Terrain, shown_m: tuple[float, float]
) -> None:
    """The ground of all that was recorded, with the part above marked."""
    x = np.linspace(trajectory.q[0, 0], trajectory.q[:, 0].max() + 1.0, 4000)
    height = terrain.height(x)
    draw_profile(axes, x, height, margin_m=0.1 * np.ptp(height))
    axes.axvspan(*shown_m, color=style.MODEL, alpha=0.18, linewidth=0, zorder=3)
    axes.set_xlabel("from the start: distance (m)", fontsize=style.TEXT_PT, color=style.INK)
