"""Packs of walkers between launches: which walker is in which lane, and the sums so far."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.kernel import backend
from taichi_nmm.kernel.layout import Ends, State, Sums, WalkerRows

# So few that there is no second copy of all rows, and what is turned stays in the
# cache.
PACKS_A_COPY = 16


class Packs:
    """Rows of the walkers that still walk, and the final rows of those that have ended.

    The backend runs already: it sets lanes and precision.
    """

    def __init__(
        self,
        rows: NDArray[Any],
        constants: NDArray[np.float64],
        terrains: NDArray[np.int32] | None = None,
        starts: NDArray[Any] | None = None,
    ) -> None:
        """Walkers in the order of the batch.

        Args:
            rows: [n, row]; or of fewer walkers, if many start alike.
            constants: [n, row].
            terrains: row of the table of heights, [n]; None is 0.
            starts: for each walker, which of `rows` it starts with, [n]; None is its
                own.
        """
        self.lanes = backend.lanes()  # walkers a pack
        real = backend.real_dtype()
        count = len(constants)
        grounds = np.zeros(count, dtype=np.int32) if terrains is None else terrains
        # Batch row of each occupied lane; the last pack's rest are idle copies.
        self.walkers = np.arange(count)
        # The kernel's own order: [pack, row, lane].
        self.rows = self.fold(rows.astype(real), starts)
        self.constants = self.fold(constants.astype(real))  # [pack, row, lane]
        self.terrains = self.fold(grounds[:, None])[:, 0, :].copy()  # [pack, lane]
        self._final = np.zeros((count, Ends.count), dtype=real)
        self._sums = np.zeros((count, Sums.count))

    def drain(self) -> None:
        """Move the kernel's sums into float64 totals, so that long walks lose no digits."""
        self._sums[self.walkers] += self.unfold(self.rows[:, WalkerRows.sums :, :])
        self.rows[:, WalkerRows.sums :, :] = 0.0

    def compact(self) -> None:
        """Let the walkers that have ended go where this empties a pack.

        Walkers of the last packs take their lanes: no other row is copied.
        """
        up = self.up()
        count = int(np.count_nonzero(up))
        packs = math.ceil(count / self.lanes)
        if packs == len(self.rows):
            return
        self._keep_final(np.flatnonzero(~up))
        last = count + np.flatnonzero(up[count:])
        free = np.flatnonzero(~up[:count])
        self._copy(last, free)
        self._copy(np.array([count - 1]), np.arange(count, packs * self.lanes))
        self.walkers[free] = self.walkers[last]
        self.walkers = self.walkers[:count]
        self.rows = self.rows[:packs]
        self.constants = self.constants[:packs]
        self.terrains = self.terrains[:packs]

    def collect(self) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """Final rows [n, Ends.count] and summed rows [n, Sums.count] of every walker."""
        self._keep_final(np.arange(len(self.walkers)))
        return self._final, self._sums

    def lane_of(self, walker: int) -> tuple[int, int] | None:
        """Pack and lane of a walker, None once it has gone."""
        places = np.flatnonzero(self.walkers == walker)
        return divmod(int(places[0]), self.lanes) if len(places) else None

    def rows_of(self, walker: int) -> NDArray[Any] | None:
        """The rows of a walker, [WalkerRows.count], None once it has gone."""
        place = self.lane_of(walker)
        return None if place is None else self.rows[place[0], :, place[1]]

    def up(self) -> NDArray[np.bool_]:
        """Which of `walkers` have neither fallen nor diverged."""
        return self.unfold(self.rows[:, State.active : State.active + 1, :])[:, 0] > 0.5

    def _keep_final(self, places: NDArray[np.intp]) -> None:
        pack, lane = np.divmod(places, self.lanes)
        first = State.end_reason
        ends = self.rows[pack, first : first + Ends.count, lane]
        self._final[self.walkers[places]] = ends

    def _copy(self, sources: NDArray[np.intp], places: NDArray[np.intp]) -> None:
        """Copy the rows of some places to others, or of one to all of them."""
        pack, lane = np.divmod(places, self.lanes)
        from_pack, from_lane = np.divmod(sources, self.lanes)
        for folded in (self.rows, self.constants, self.terrains):
            folded[pack, ..., lane] = folded[from_pack, ..., from_lane]

    def fold(
        self, flat: NDArray[Any], which: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """[n, row] to [pack, row, lane]; the last pack is filled up with its last walker.

        Args:
            flat: [n, row].
            which: rows of `flat` to fold, [n], if there are others than all.
        """
        which = np.arange(len(flat)) if which is None else which
        packs = math.ceil(len(which) / self.lanes)
        folded = np.empty((packs, flat.shape[1], self.lanes), dtype=flat.dtype)
        places = np.minimum(np.arange(packs * self.lanes), len(which) - 1).reshape(
            packs, self.lanes
        )
        for first in range(0, packs, PACKS_A_COPY):
            some = slice(first, first + PACKS_A_COPY)
            folded[some] = flat[which[places[some]]].transpose(0, 2, 1)
        return folded

    def unfold(self, folded: NDArray[Any]) -> NDArray[Any]:
        """[pack, row, lane] to [n, row], without the fill."""
        flat = folded.transpose(0, 2, 1).reshape(-1, folded.shape[1])
        return flat[: len(self.walkers)]
