"""The poses of a walk as arrays that the page draws frame by frame, the same shapes as in films."""

from dataclasses import dataclass, fields

import matplotlib
import numpy as np
from numpy.typing import NDArray

from study.pictures import style
from study.pictures.scene import FORCE_M_PER_N, motion_of, pressure_point
from study.pictures.skeleton import leg, muscle_outlines, trunk
from study.pictures.stick_figure import LEFT, RIGHT
from study.pictures.window import finite
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import GRID_SPACING_M, Terrain

Array = NDArray[np.float32]

RATE_HZ = 30
BEFORE_M, BEYOND_M = 4.0, 6.0  # ground that is drawn besides where the hip was
COLOURS = [
    matplotlib.colors.to_hex(matplotlib.colormaps[style.ACTIVATION_MAP](level))
    for level in range(256)
]


@dataclass(frozen=True, eq=False)
class Frames:
    """f frames; points are x and z in metres.

    Attributes:
        time_s: [f].
        camera_m: where the hip is, and the ground there, smoothed, [f, 2].
        near, far: hip, knee, ankle, heel and ball of the left and the right leg, [f, 5, 2].
        trunk: hip and shoulder, [f, 2, 2].
        head: its centre, [f, 1, 2].
        muscles: closed outlines, left leg then right, [f, 14, p, 2].
        activation: of these, in 255ths, [f, 14].
        forces: foot and tip of the arrow of the ground's force, left and right, [f, 2, 2, 2].
        ground: profile, [k, 2].
    """

    time_s: Array
    camera_m: Array
    near: Array
    far: Array
    trunk: Array
    head: Array
    muscles: Array
    activation: NDArray[np.uint8]
    forces: Array
    ground: Array

    def columns(self) -> dict[str, list[NDArray[np.generic]]]:
        """By name, each as the one entry of a column, as Bokeh sends arrays of any shape."""
        return {each.name: [getattr(self, each.name)] for each in fields(self)}


def frames_of(trajectory: Trajectory, terrain: Terrain) -> Frames:
    """All of a walk, as far as its poses are finite.

    Raises:
        InputError: not one is.
    """
    shown = finite(trajectory)
    motion = motion_of(shown, terrain, float(shown.time_s[-1]), RATE_HZ)
    q = motion.q
    shoulder, head = trunk(q)
    feet = [pressure_point(q, side) for side in (LEFT, RIGHT)]
    pushes = [FORCE_M_PER_N * motion.force_n[:, 2 * side : 2 * side + 2] for side in (LEFT, RIGHT)]
    arrows = [
        np.stack([foot, foot + push], axis=1) for foot, push in zip(feet, pushes, strict=True)
    ]
    outlines = [*muscle_outlines(q, LEFT), *muscle_outlines(q, RIGHT)]
    x = np.arange(q[:, 0].min() - BEFORE_M, q[:, 0].max() + BEYOND_M, GRID_SPACING_M)
    return Frames(
        time_s=_float(motion.time_s),
        camera_m=_float(np.stack([q[:, 0], motion.level_m], axis=1)),
        near=_float(leg(q, LEFT).chain()),
        far=_float(leg(q, RIGHT).chain()),
        trunk=_float(np.stack([q[:, :2], shoulder], axis=1)),
        head=_float(head[:, None]),
        muscles=_float(np.stack(outlines, axis=1)),
        activation=np.clip(255.0 * motion.activation, 0, 255).astype(np.uint8),
        forces=_float(np.stack(arrows, axis=1)),
        ground=_float(np.stack([x, terrain.height(x)], axis=1)),
    )


def _float(values: NDArray[np.float64]) -> Array:
    return np.ascontiguousarray(values, dtype=np.float32)
