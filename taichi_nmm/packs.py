"""Packs of walkers between launches: which walker is in which lane, and the sums so far."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.kernel import backend
from taichi_nmm.kernel.layout import FIRST_SUM, State, Sums

FULL_ENOUGH = 0.9  # compacting copies every row: not worth it for a few fallen walkers


class Packs:
    """Rows of the walkers that still walk, and the final rows of those that have ended.

    The backend runs already: it sets lanes and precision.

    Attributes:
        lanes: walkers a pack.
        rows: [pack, row, lane], advanced by the kernel.
        constants: [pack, row, lane].
        terrains: [pack, lane].
        walkers: batch row of each occupied lane, in order; the last pack's rest are idle copies.
    """

    def __init__(
        self,
        rows: NDArray[Any],
        constants: NDArray[np.float64],
        terrains: NDArray[np.int32] | None = None,
    ) -> None:
        self.lanes, real = backend.lanes(), backend.real_dtype()
        grounds = np.zeros(len(rows), dtype=np.int32) if terrains is None else terrains
        self._seat(np.arange(len(rows)), rows.astype(real), constants.astype(real), grounds)
        self._final = np.zeros((len(rows), State.count))
        self._sums = np.zeros((len(rows), Sums.count))

    def _seat(
        self,
        walkers: NDArray[np.intp],
        rows: NDArray[Any],
        constants: NDArray[Any],
        terrains: NDArray[np.int32],
    ) -> None:
        self.walkers = walkers
        self.rows = self.fold(rows)
        self.constants = self.fold(constants)
        self.terrains = self.fold(terrains[:, None])[:, 0, :].copy()

    def drain(self) -> None:
        """Move the kernel's sums into float64 totals, so that long walks lose no digits."""
        self._sums[self.walkers] += self.unfold(self.rows[:, FIRST_SUM:, :])
        self.rows[:, FIRST_SUM:, :] = 0.0

    def compact(self) -> None:
        """Let the walkers that have ended go once they leave enough lanes idle."""
        up = self.up()
        if np.count_nonzero(up) > FULL_ENOUGH * len(up):
            return
        self._keep_final(~up)
        unfolded = (self.rows, self.constants, self.terrains[:, None, :])
        rows, constants, terrains = (self.unfold(folded)[up] for folded in unfolded)
        self._seat(self.walkers[up], rows, constants, terrains[:, 0])

    def collect(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Final state rows [n, State.count] and summed rows [n, Sums.count] of every walker."""
        self._keep_final(np.ones(len(self.walkers), dtype=bool))
        return self._final, self._sums

    def lane_of(self, walker: int) -> tuple[int, int] | None:
        """Pack and lane of a walker, None once it has gone."""
        position = int(np.searchsorted(self.walkers, walker))
        if position == len(self.walkers) or self.walkers[position] != walker:
            return None
        return divmod(position, self.lanes)

    def up(self) -> NDArray[np.bool_]:
        """Which of `walkers` have neither fallen nor diverged."""
        return self.unfold(self.rows[:, State.active : State.active + 1, :])[:, 0] > 0.5

    def _keep_final(self, which: NDArray[np.bool_]) -> None:
        final = self.unfold(self.rows[:, : State.count, :])
        self._final[self.walkers[which]] = final[which]

    def fold(self, flat: NDArray[Any]) -> NDArray[Any]:
        """[n, row] to [pack, row, lane]; the last pack is filled up with its last walker."""
        count = -(-len(flat) // self.lanes) * self.lanes
        padded = flat[np.minimum(np.arange(count), len(flat) - 1)] if len(flat) else flat
        folded = padded.reshape(-1, self.lanes, flat.shape[1]).transpose(0, 2, 1)
        return np.ascontiguousarray(folded)

    def unfold(self, folded: NDArray[Any]) -> NDArray[Any]:
        """[pack, row, lane] to [n, row], without the fill."""
        flat = folded.transpose(0, 2, 1).reshape(-1, folded.shape[1])
        return flat[: len(self.walkers)]
