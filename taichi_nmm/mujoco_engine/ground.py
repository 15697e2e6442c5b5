"""The ground of a walk, planes under the soles, anew at every step; and that of a file, boxes.

Planes are laid by `kernel.contact_planes`. A file for MuJoCo's viewer can only have solids: a box
for each straight piece of a terrain, its top on the table.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.errors import InputError
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.contact_planes import PLANES, lay_planes
from taichi_nmm.kernel.layout import COORDINATES
from taichi_nmm.terrain import GRID_SPACING_M, GRID_X_M, Terrain

APRON_M = 30e3  # level ground before and behind the table: beyond the longest walk


class ContactPlanes:
    """The planes of some walkers, [n, PLANES], and the grounds that they lie on."""

    def __init__(self, terrains: tuple[Terrain, ...], index: NDArray[np.integer[Any]]) -> None:
        heights = np.array([ground.height_m for ground in terrains])
        self._heights = np.pad(heights, ((0, 0), (1, 1)), mode="edge")
        ends = GRID_X_M[0] - APRON_M, GRID_X_M[-1] + APRON_M
        self._nodes = np.concatenate([ends[:1], GRID_X_M, ends[1:]])
        self._index = index.astype(np.int32)
        self._qpos = np.zeros((len(index), COORDINATES))
        self._positions = np.zeros((len(index), PLANES, 3))
        self._quaternions = np.zeros((len(index), PLANES, 4))
        self._bind()

    def keep(self, still: NDArray[np.bool_]) -> None:
        """Go on with these walkers alone."""
        index = self._index[: len(still)][still]
        self._index[: len(index)] = index

    def under(self, qpos: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Where the planes lie: points [n, PLANES, 3] and quaternions [n, PLANES, 4].

        `qpos` is MuJoCo's, [n, 9]. The arrays are overwritten by the next call.
        """
        count = len(qpos)
        self._qpos[:count] = qpos
        if self._kernel.stale:
            self._bind()
        self._kernel.launch(count=count)
        return self._positions[:count], self._quaternions[:count]

    def _bind(self) -> None:
        self._kernel = backend.BoundKernel(
            lay_planes, 0, self._index, self._nodes, self._heights, self._qpos,
            self._positions, self._quaternions,
        )  # fmt: skip


Array = NDArray[np.float64]

SAME_SLOPE = 1e-9  # cells of the table whose slopes differ by less are one piece
HALF_WIDTH_M = 1.0
THICKNESSES_M = (0.2, 0.1, 0.05, 0.02, 0.01, 0.005)  # the first that nowhere comes out again
SAMPLES = 9  # of a box's end, to see that


@dataclass(frozen=True, eq=False)
class Boxes:
    """The ground from back to front, k boxes."""

    position: Array  # centres x, y, z, [k, 3]
    quaternion: Array  # w, x, y, z, [k, 4]
    half_size: Array  # along the top, across, and in thickness, [k, 3]

    def __len__(self) -> int:
        return len(self.position)


def boxes(terrain: Terrain) -> Boxes:
    """The boxes of a terrain.

    Raises:
        InputError: pieces so short and steep that the thinnest box comes out of the next one.
    """
    height = terrain.height_m
    slopes = np.concatenate([[0.0], np.diff(height) / GRID_SPACING_M, [0.0]])
    corners = np.abs(np.diff(slopes)) > SAME_SLOPE  # where straight pieces meet; then the aprons
    x = np.concatenate([[GRID_X_M[0] - APRON_M], GRID_X_M[corners], [GRID_X_M[-1] + APRON_M]])
    z = np.concatenate([height[:1], height[corners], height[-1:]])
    dx, dz = np.diff(x), np.diff(z)
    length, angle = np.hypot(dx, dz), np.arctan2(dz, dx)
    down = np.column_stack([np.sin(angle), -np.cos(angle)])
    tops = np.column_stack([x, z])
    thickness = _thickness(tops, down)
    if not np.all(thickness > 0):
        place = float(x[:-1][thickness == 0][0])
        allowed = f"in a file for MuJoCo a smoother ground than at x = {place:g} m"
        raise InputError("terrain", terrain.name, allowed)
    middle = 0.5 * (tops[:-1] + tops[1:]) + 0.5 * thickness[:, None] * down
    count = len(length)
    return Boxes(
        position=np.column_stack([middle[:, 0], np.zeros(count), middle[:, 1]]),
        # MuJoCo turns about +y from z to x: a rise is a turn back.
        quaternion=np.column_stack(
            [np.cos(0.5 * angle), np.zeros(count), -np.sin(0.5 * angle), np.zeros(count)]
        ),
        half_size=np.column_stack([0.5 * length, np.full(count, HALF_WIDTH_M), 0.5 * thickness]),
    )


def _thickness(tops: Array, down: Array) -> Array:
    """Largest thickness with which each box stays in the ground, [k]; zero where there is none."""
    thickness = np.zeros(len(down))
    along = np.linspace(0.0, 1.0, SAMPLES)
    for candidate in reversed(THICKNESSES_M):
        ends = np.stack([tops[:-1], tops[1:]], axis=1)  # [k, 2, xz]
        inner = ends[:, :, None, :] + candidate * along[:, None] * down[:, None, None, :]
        bottom = ends[:, 0, None, :] * (1.0 - along[:, None]) + ends[:, 1, None, :] * along[:, None]
        points = np.concatenate(
            [inner.reshape(len(down), -1, 2), bottom + candidate * down[:, None, :]], axis=1
        )
        ground = np.interp(points[..., 0], tops[:, 0], tops[:, 1])
        hidden = np.all(points[..., 1] <= ground + SAME_SLOPE, axis=1)
        thickness[hidden] = candidate
    return thickness
