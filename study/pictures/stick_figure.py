"""One pose of the walker on axes: bones, head, and muscles coloured by their activation."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Normalize
from matplotlib.patches import Circle
from numpy.typing import NDArray

from study.pictures import style
from study.pictures.skeleton import HEAD_RADIUS_M, leg, muscle_outlines, trunk
from taichi_nmm.result import MUSCLES

Array = NDArray[np.float64]

LEFT, RIGHT = 0, 1
FULL_ACTIVATION = Normalize(0.0, 1.0)
TRUNK_WIDTH_M, THIGH_WIDTH_M, SHANK_WIDTH_M, FOOT_WIDTH_M = 0.15, 0.09, 0.06, 0.04
GROUND_LAYER = 100.0  # over the soles: a foot is a line, and half its drawn width is below it


class StickFigure:
    """The artists of one walker; `pose` moves them. The left leg is the near one."""

    def __init__(self, axes: Axes, layer: float = 2.0) -> None:
        """Empty artists on `axes`, at `layer` and less than one above it."""
        self._axes = axes
        self._far = self._bones(style.FAR_LIMB, layer)
        self._far_muscles = self._muscles(layer + 0.1, style.FAINT)
        self._trunk = self._bones(style.NEAR_LIMB, layer + 0.2)
        self._head = Circle((0, 0), HEAD_RADIUS_M, facecolor=style.NEAR_LIMB, zorder=layer + 0.2)
        axes.add_patch(self._head)
        self._near = self._bones(style.NEAR_LIMB, layer + 0.3)
        self._near_muscles = self._muscles(layer + 0.4, style.INK)
        (self._joints,) = axes.plot([], [], "o", color=style.INK, ms=2.0, zorder=layer + 0.5)

    def pose(self, q: Array, activation: Array) -> None:
        """Move to coordinates q [9] with activations [14], left leg first."""
        far, near = leg(q, RIGHT), leg(q, LEFT)
        shoulder, head = trunk(q)
        self._head.center = (head[0], head[1])
        self._trunk.set_segments([np.array([q[:2], shoulder])])
        self._trunk.set_linewidth([self._points(TRUNK_WIDTH_M)])
        for bones, joints in ((self._far, far), (self._near, near)):
            chain = joints.chain()
            bones.set_segments([chain[0:2], chain[1:3], chain[3:5]])
            widths = (THIGH_WIDTH_M, SHANK_WIDTH_M, FOOT_WIDTH_M)
            bones.set_linewidth([self._points(width) for width in widths])
        self._joints.set_data(*near.chain()[:3].T)
        count = len(MUSCLES)
        for muscles, side, first in (
            (self._near_muscles, LEFT, 0),
            (self._far_muscles, RIGHT, count),
        ):
            muscles.set_verts(muscle_outlines(q, side))
            muscles.set_array(activation[first : first + count])

    def _bones(self, colour: str, layer: float) -> LineCollection:
        bones = LineCollection([], colors=colour, capstyle="round", zorder=layer)
        self._axes.add_collection(bones, autolim=False)
        return bones

    def _muscles(self, layer: float, edge: str) -> PolyCollection:
        muscles = PolyCollection(
            [], cmap=style.ACTIVATION_MAP, norm=FULL_ACTIVATION, edgecolors=edge,
            linewidths=0.4, zorder=layer,
        )  # fmt: skip
        self._axes.add_collection(muscles, autolim=False)
        return muscles

    def _points(self, metres: float) -> float:
        """A width on the ground's scale as a line width."""
        axes = self._axes
        pixels = axes.transData.transform([(0.0, 0.0), (metres, 0.0)])
        figure = axes.get_figure(root=True)
        assert figure is not None
        return float((pixels[1, 0] - pixels[0, 0]) * 72.0 / figure.dpi)


def activation_bar(
    colour_axes: Axes, figure_of: StickFigure, size_pt: float = style.SMALL_PT
) -> Colorbar:
    """The colour bar of the activations, in its own axes."""
    figure = colour_axes.get_figure(root=True)
    assert figure is not None
    bar = figure.colorbar(figure_of._near_muscles, cax=colour_axes, ticks=[0, 0.5, 1])
    bar.set_label("muscle activation (1)", fontsize=size_pt, color=style.INK)
    bar.ax.tick_params(labelsize=size_pt, colors=style.INK, length=2)
    bar.outline.set_visible(False)
    return bar


def draw_ground(axes: Axes, x_m: Array, height_m: Array, bottom_m: float) -> None:
    """The ground's profile, filled down to `bottom_m`."""
    axes.fill_between(x_m, height_m, bottom_m, color=style.GROUND, linewidth=0, zorder=GROUND_LAYER)
    axes.plot(x_m, height_m, color=style.INK, linewidth=1.0, zorder=GROUND_LAYER)


def draw_profile(axes: Axes, x_m: Array, height_m: Array, margin_m: float) -> None:
    """The ground of a whole walk, small, with so much room above and below it."""
    style.tidy(axes)
    draw_ground(axes, x_m, height_m, height_m.min() - margin_m)
    axes.set(xlim=(x_m[0], x_m[-1]), ylim=(height_m.min() - margin_m, height_m.max() + margin_m))
    axes.set_ylabel("ground (m)", fontsize=style.TEXT_PT, color=style.INK)
