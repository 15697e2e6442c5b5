"""Packs of walkers between launches: who sits in which lane, and what has been summed so far."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.kernel.layout import FIRST_SUM, State, Sums

FULL_ENOUGH = 0.9  # compacting copies every row: not worth it for a few fallen walkers


class Packs:
    """Rows of the walkers that still walk, and the final rows of those that have ended.

    Attributes:
        lanes: walkers a pack.
        rows: [pack, row, lane], what the kernel advances.
        constants: [pack, row, lane].
        terrains: [pack, lane].
        walkers: batch row of each occupied lane, in order; the last pack's rest are idle copies.
    """

    def __init__(
        self,
        rows: NDArray[Any],
        constants: NDArray[np.float64],
        terrains: NDArray[np.int32],
        lanes: int,
        real: type[np.floating[Any]],
    ) -> None:
        self.lanes = lanes
        self.walkers = np.arange(len(rows))
        self.rows = self.fold(rows.astype(real))
        self.constants = self.fold(constants.astype(real))
        self.terrains = self.fold(terrains[:, None])[:, 0, :].copy()
        self._final = np.zeros((len(rows), State.count))
        self._sums = np.zeros((len(rows), Sums.count))

    @property
    def active(self) -> int:
        """How many walkers have neither fallen nor diverged."""
        return int(np.count_nonzero(self.up()))

    def drain(self) -> None:
        """Move the kernel's sums into float64 totals, so that long walks lose no digits."""
        sums = self.unfold(self.rows[:, FIRST_SUM:, :])
        self._sums[self.walkers] += sums
        self.rows[:, FIRST_SUM:, :] = 0.0

    def compact(self) -> None:
        """Let the walkers that have ended go once they leave enough lanes idle."""
        up = self.up()
        if np.count_nonzero(up) > FULL_ENOUGH * len(up):
            return
        self._keep_final(~up)
        rows, constants = self.unfold(self.rows)[up], self.unfold(self.constants)[up]
        terrains = self.unfold(self.terrains[:, None, :])[up]
        self.walkers = self.walkers[up]
        self.rows = self.fold(rows)
        self.constants = self.fold(constants)
        self.terrains = self.fold(terrains)[:, 0, :].copy()

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
