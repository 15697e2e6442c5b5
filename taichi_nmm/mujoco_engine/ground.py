"""The ground of a walk: planes under the soles, laid anew at every step by a kernel."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.kernel import backend
from taichi_nmm.kernel.contact_planes import PLANES, lay_planes
from taichi_nmm.kernel.layout import COORDINATES
from taichi_nmm.terrain import GRID_X_M, Terrain

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
