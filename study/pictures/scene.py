"""The frames of a film: a camera that follows the walker over its ground."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.text import Text
from numpy.typing import NDArray

from study.pictures import style
from study.pictures.skeleton import leg
from study.pictures.stick_figure import GROUND_LAYER, StickFigure, activation_bar, draw_ground
from study.pictures.window import at_times, finite, last_seconds
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import GRID_SPACING_M, Terrain

Array = NDArray[np.float64]

FRAME_RATE_HZ = 30
DPI = 100
SIZE_PX = (1280, 640)  # even numbers: yuv420p halves both
VIEW_WIDTH_M = 4.4
VIEW_HEIGHT_M = VIEW_WIDTH_M * SIZE_PX[1] / SIZE_PX[0]
BELOW_GROUND_M = 0.30
AHEAD = 0.45  # where the walker is in the picture, from the left
HEIGHT_TRACKING_S = 0.5  # the camera follows the ground's rise as slowly as this
FORCE_M_PER_N = 0.6 / 785.0  # one body weight of 80 kg is 0.6 m long
PRESSURE_SHIFT_M = 0.05  # heel above ball by half of it: all the force is at the ball
FORCE_SMOOTHING_S = 0.03  # impacts of a few milliseconds would only flicker


def frames(trajectory: Trajectory, terrain: Terrain, seconds: float, title: str) -> Iterator[bytes]:
    """RGBA frames of the last `seconds` in real time, each of `SIZE_PX`."""
    trajectory = finite(trajectory)
    start_s, end_s = last_seconds(trajectory, seconds)
    times_s = np.arange(start_s, end_s + 1e-9, 1.0 / FRAME_RATE_HZ)
    q = at_times(trajectory, trajectory.q, times_s)
    activation = at_times(trajectory, trajectory.activation, times_s)
    force = at_times(trajectory, _smooth_force(trajectory), times_s)
    level = _camera_level(terrain.height(q[:, 0]))
    scene = Scene(terrain, title, (q[:, 0].min(), q[:, 0].max()))
    for number, time_s in enumerate(times_s):
        scene.look_at(q[number, 0], level[number])
        scene.pose(q[number], activation[number], force[number], float(time_s))
        yield scene.picture()


class Scene:
    """The artists of a film; moved from frame to frame."""

    def __init__(self, terrain: Terrain, title: str, walked_m: tuple[float, float]) -> None:
        """A scene for a walker whose hip stays between the two `walked_m`."""
        width, height = SIZE_PX
        self._drawing = figure = style.new_figure(width / DPI, height / DPI, DPI)
        self._axes = axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        self._labels = _draw_whole_ground(axes, terrain, walked_m)
        self.look_at(walked_m[0], 0.0)
        self._figure = StickFigure(axes)
        self._forces = LineCollection(
            [], colors=style.MODEL, linewidths=3.0, capstyle="round", alpha=0.85, zorder=6.0
        )
        axes.add_collection(self._forces, autolim=False)
        text: dict[str, Any] = {"transform": axes.transAxes, "va": "top", "color": style.INK}
        axes.text(0.015, 0.97, title, fontsize=13, **text)
        self._clock = axes.text(0.015, 0.91, "", fontsize=13, **text)
        axes.text(0.015, 0.85, "blue: force of the ground", fontsize=11, **text)
        activation_bar(figure.add_axes((0.935, 0.45, 0.012, 0.4)), self._figure, size_pt=10.0)

    def look_at(self, x_m: float, ground_m: float) -> None:
        """Point the camera at a walker whose hip is at x."""
        left, bottom = x_m - AHEAD * VIEW_WIDTH_M, ground_m - BELOW_GROUND_M
        self._axes.set(xlim=(left, left + VIEW_WIDTH_M), ylim=(bottom, bottom + VIEW_HEIGHT_M))
        for label in self._labels:  # text is the slow part of a frame
            label.set_visible(left < label.get_position()[0] < left + VIEW_WIDTH_M)

    def pose(self, q: Array, activation: Array, force_n: Array, time_s: float) -> None:
        """Move the walker; force_n [4] is left x, left z, right x, right z."""
        self._figure.pose(q, activation)
        segments = []
        for side in range(2):
            foot = _pressure_point(q, side)
            segments.append([foot, foot + FORCE_M_PER_N * force_n[2 * side : 2 * side + 2]])
        self._forces.set_segments(segments)
        self._clock.set_text(f"{time_s:6.2f} s   {q[0]:7.2f} m")

    def picture(self) -> bytes:
        """The frame as RGBA bytes."""
        return style.rgba(self._drawing)


def _pressure_point(q: Array, side: int) -> Array:
    """Where the ground pushes, for the eye: at the lower end of the foot, amid a flat one."""
    joints = leg(q, side)
    share = np.clip(0.5 + (joints.heel[1] - joints.ball[1]) / PRESSURE_SHIFT_M, 0.0, 1.0)
    return np.asarray(joints.heel + share * (joints.ball - joints.heel))


def _draw_whole_ground(axes: Axes, terrain: Terrain, walked_m: tuple[float, float]) -> list[Text]:
    """The ground with a mark at every metre; returns the marks' labels."""
    labels = []
    low, high = walked_m[0] - VIEW_WIDTH_M, walked_m[1] + VIEW_WIDTH_M
    x = np.arange(low, high, GRID_SPACING_M / 2)
    height = terrain.height(x)
    draw_ground(axes, x, height, height.min() - VIEW_HEIGHT_M)
    for metre in range(int(np.ceil(low)), int(high) + 1):
        ground = float(terrain.height(metre))
        mark: dict[str, Any] = {"color": style.INK, "zorder": GROUND_LAYER + 1}
        axes.plot([metre, metre], [ground - 0.05, ground], linewidth=1.0, **mark)
        label: dict[str, Any] = {"ha": "center", "va": "top", "fontsize": 11}
        labels.append(axes.text(metre, ground - 0.08, f"{metre} m", **label, **mark))
    return labels


def _camera_level(ground_m: Array) -> Array:
    """The ground's height at each frame, smoothed for a calm camera."""
    level = ground_m.copy()
    blend = 1.0 / (FRAME_RATE_HZ * HEIGHT_TRACKING_S)
    for number in range(1, len(level)):
        level[number] = level[number - 1] + blend * (level[number] - level[number - 1])
    return level


def _smooth_force(trajectory: Trajectory) -> Array:
    """Ground forces averaged over a few samples, [t, 4]."""
    interval_s = np.diff(trajectory.time_s[:2]).sum() or 1.0
    width = max(round(FORCE_SMOOTHING_S / interval_s), 1)
    padded = np.pad(trajectory.ground_force_n, ((width // 2, (width - 1) // 2), (0, 0)), "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, width, axis=0)
    return np.asarray(windows.mean(axis=-1))
