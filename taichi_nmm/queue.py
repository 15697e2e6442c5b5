"""The walkers of a batch on a GPU, between launches of `kernel.queue`.

A launch takes a part of a second: then the host reports, and can be interrupted. What a
walker does depends neither on the others nor on where launches end.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.kernel import backend
from taichi_nmm.kernel.layout import PER_WALKER, Ends, Sums, WalkerRows
from taichi_nmm.kernel.muscle_table import muscle_table
from taichi_nmm.kernel.queue import pick, put, seats_per_block, turn, walk
from taichi_nmm.settings import Settings
from taichi_nmm.walkers import Batch, blends, kind_rows, leg_gains, start_rows

# Four warps on each of 132 multiprocessors: what they keep then stays in the nearest
# cache (docs/speed.md). A smaller GPU takes them in turns.
SEATS = 16_896
LAUNCH_TICKS = 5000  # a sixth of a second on such a GPU; longer ones gain nothing
ROWS_A_PART = 65_536  # of results, which the host makes while it gets the next


class Queue:
    """Walkers that wait, walk and have ended.

    Attributes:
        tick: of the seats' clock.
    """

    def __init__(
        self, batch: Batch, settings: Settings, ticks: int, at_once: bool = False
    ) -> None:
        """Nobody walks yet. The backend runs already: it sets the precision.

        Args:
            batch: the walkers.
            settings: of the simulation.
            ticks: after which a walk is over.
            at_once: whether all walkers begin together, so that constants may change at
                a tick, and walkers be looked at.
        """
        self.tick = 0
        self._count, self._ticks, self._settings = len(batch), ticks, settings
        real = backend.real_dtype()
        block = seats_per_block()
        most = self._count if at_once else min(SEATS, self._count)
        seats = math.ceil(most / block) * block
        rows, starts = start_rows(batch)
        heights = np.array([ground.height_m for ground in batch.terrains], dtype=real)
        step_s = settings.physics_step_s
        kinds = kind_rows(batch, settings).T
        index = np.arange(self._count) % kinds.shape[1]
        self._counters = self._put(np.array([[seats, 0]], np.int32))
        self._seats = backend.empty_on_device((WalkerRows.count, seats), real)
        self._gains = self._put(leg_gains(batch, real))
        self._kinds = self._put(kinds.astype(real))
        self._ends = backend.empty_on_device((Ends.count, self._count), real)
        self._totals = backend.empty_on_device((self._count, Sums.count), np.float64)
        self._others = (
            self._put(np.array([index, starts, batch.terrain_index], np.int32)),
            self._put(rows.T.astype(real)),
            self._put(heights),
            self._put(muscle_table(step_s).astype(real)),
        )
        self._taken = backend.empty_on_device((2, seats), np.int32)
        self._numbers = settings.substeps, step_s, *blends(step_s), int(heights.any())

    def advance(self, ticks: int = 0) -> int:
        """Let the seats' clock go on by so many ticks, 0 being as many as a launch should have.

        Returns how many walkers have not ended.
        """
        ticks = ticks or LAUNCH_TICKS
        backend.launch(
            walk,
            self._seats,
            self._taken,
            self._counters,
            self._gains,
            self._kinds,
            *self._others,
            self._ends,
            self._totals,
            self.tick,
            ticks,
            self._ticks,
            self._count,
            *self._numbers,
        )
        self.tick += ticks
        return self._count - int(backend.on_host(self._counters, put)[0, 1])

    def set_constants(self, rows: NDArray[np.float64]) -> None:
        """Give all walkers other constants, [n, Const.count]."""
        columns = rows.T.astype(backend.real_dtype())
        self._gains = self._put(columns[:PER_WALKER])
        self._kinds = self._put(columns[PER_WALKER:])
        every = np.arange(self._count, dtype=np.int32)
        indices = backend.on_host(self._others[0], put)
        self._others = self._put(np.vstack([every, indices[1:]])), *self._others[1:]

    def rows_of(self, walker: int) -> NDArray[Any]:
        """Rows of a walker of those that all began together, [WalkerRows.count]."""
        found = np.empty((WalkerRows.count, 1), backend.real_dtype())
        backend.launch(pick, self._seats, walker, found)
        return found[:, 0]

    def collect(self) -> Iterator[tuple[NDArray[Any], NDArray[np.float64]]]:
        """Final rows [k, Ends.count] and summed rows [k, Sums.count] of all walkers, in parts."""
        ends = backend.on_host(self._ends, put).T
        for first in range(0, self._count, ROWS_A_PART):
            part = ends[first : first + ROWS_A_PART]
            sums = np.empty((Sums.count, len(part)))
            backend.launch(turn, self._totals, first, sums)
            yield part, sums.T

    @staticmethod
    def _put(array: NDArray[Any]) -> Any:
        return backend.on_device(np.ascontiguousarray(array), put)
