"""Figure: two walks of one run, as poses over its ground: before and after, or on two engines."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from study.palette import BLUE, VERMILION
from study.pictures import style
from study.pictures.stick_figure import StickFigure, activation_bar, draw_ground, draw_profile
from study.pictures.strip import draw_ghosts, draw_poses, pose_times
from study.pictures.window import at_times, finite
from study.report.axes import save
from study.report.before_after import Pair, Shown
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import Terrain

Floats = NDArray[np.float64]

WIDTH_M = 8.4
SHOWN_M = 6.8
SCALE_IN_PER_M = 1.05
LEFT_IN, RIGHT_IN, PROFILE_IN = 0.75, 1.0, 0.85
ABOVE_HIP_M, BELOW_GROUND_M = 0.95, 0.14
COLOURS = (VERMILION, BLUE)  # of the first walk and the second


@dataclass(frozen=True, eq=False)
class Panel:
    """One of the two walks: what is drawn of it, and where.

    Attributes:
        shown: which it is.
        colour: of its mark in the profile.
        trajectory: of it, as far as its pose is finite.
        poses_s: times of the poses.
        frame: x from, to; z from, to, in m.
    """

    shown: Shown
    colour: str
    trajectory: Trajectory
    poses_s: Floats
    frame: tuple[float, float, float, float]

    @property
    def height_in(self) -> float:
        """Height of its axes on the page."""
        return (self.frame[3] - self.frame[2]) * SCALE_IN_PER_M


def write_strips(folder: Path, title: str, pair: Pair) -> list[Path]:
    """Draw both walks and, below them, the profile of the ground, as strips.png and .svg.

    Args:
        folder: where to.
        title: of the figure.
        pair: the walks and their ground.
    """
    panels = [
        _panel(shown, colour, pair.terrain)
        for shown, colour in zip((pair.first, pair.second), COLOURS, strict=True)
    ]
    width = WIDTH_M * SCALE_IN_PER_M + LEFT_IN + RIGHT_IN
    height = sum(panel.height_in + 0.62 for panel in panels) + PROFILE_IN + 0.95
    figure = style.new_figure(width, height)

    def axes_at(top_in: float, high_in: float) -> Axes:
        box = (LEFT_IN, height - top_in - high_in, WIDTH_M * SCALE_IN_PER_M, high_in)
        return figure.add_axes((box[0] / width, box[1] / height, box[2] / width, box[3] / height))

    top = 0.35
    for panel in panels:
        top += 0.3
        axes = axes_at(top, panel.height_in)
        figure_of = _draw_panel(axes, panel, pair.terrain)
        top += panel.height_in + 0.32
    bar = figure.add_axes(
        ((width - 0.75) / width, 1.0 - (0.9 + 1.6) / height, 0.12 / width, 1.6 / height)
    )
    activation_bar(bar, figure_of)
    _draw_profile(axes_at(top + 0.1, PROFILE_IN), panels, pair.terrain)
    figure.text(
        LEFT_IN / width, 1.0 - 0.25 / height, title,
        fontsize=style.TITLE_PT, color=style.INK, va="center",
    )  # fmt: skip
    return save(figure, folder, "strips")


def _panel(shown: Shown, colour: str, terrain: Terrain) -> Panel:
    trajectory = finite(shown.trajectory)
    poses_s = pose_times(trajectory, SHOWN_M)
    q = at_times(trajectory, trajectory.q, poses_s)
    low_x = 0.5 * (q[:, 0].min() + q[:, 0].max() - WIDTH_M)
    ground = terrain.height(np.linspace(low_x, low_x + WIDTH_M, 200))
    frame = (low_x, low_x + WIDTH_M, ground.min() - BELOW_GROUND_M, q[:, 1].max() + ABOVE_HIP_M)
    return Panel(shown, colour, trajectory, poses_s, frame)


def _draw_panel(axes: Axes, panel: Panel, terrain: Terrain) -> StickFigure:
    """A walk on its ground; the last of its poses is returned."""
    low_x, high_x, low_z, high_z = panel.frame
    style.tidy(axes)
    axes.grid(False)
    axes.set(xlim=(low_x, high_x), ylim=(low_z, high_z))
    last = draw_poses(axes, panel.trajectory, panel.poses_s)
    draw_ghosts(axes, panel.trajectory, panel.poses_s, panel.colour)
    x = np.linspace(low_x, high_x, 2000)
    draw_ground(axes, x, terrain.height(x), low_z)
    axes.set_title(panel.shown.title, loc="left", fontsize=style.TEXT_PT, color=style.INK)
    axes.set_ylabel("height (m)", fontsize=style.TEXT_PT, color=style.INK)
    return last


def _draw_profile(axes: Axes, panels: Sequence[Panel], terrain: Terrain) -> None:
    """The ground as far as either came, with the parts above marked."""
    end = max(float(panel.trajectory.q[:, 0].max()) for panel in panels) + 2.0
    x = np.linspace(min(0.0, *(panel.frame[0] for panel in panels)), max(end, WIDTH_M), 4000)
    height = terrain.height(x)
    draw_profile(axes, x, height, margin_m=0.1 * max(float(np.ptp(height)), 0.5))
    for panel in panels:
        axes.axvspan(*panel.frame[:2], color=panel.colour, alpha=0.25, linewidth=0, zorder=3)
        axes.annotate(
            panel.shown.label, xy=(np.mean(panel.frame[:2]), 1.0), xytext=(0, 2),
            xycoords=("data", "axes fraction"), textcoords="offset points", ha="center",
            fontsize=style.SMALL_PT, color=panel.colour,
        )  # fmt: skip
    axes.set_xlabel("distance (m)", fontsize=style.TEXT_PT, color=style.INK)
