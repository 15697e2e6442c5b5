"""What `simulate` is given, checked and brought into one form: `Batch`."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_nmm import checks
from taichi_nmm.body import Bodies
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import LOW_LEVEL_GAINS, gain_rows
from taichi_nmm.terrain import Terrain, flat
from taichi_nmm.world import Worlds


@dataclass(frozen=True, eq=False)
class Batch:
    """Checked input: n walkers, each with its gains, body and terrain.

    Attributes:
        gains: in the order of `parameters.GAINS`, [n, gain].
        low_level: in the order of `parameters.LOW_LEVEL_GAINS`, [n, gain].
        bodies: n of them.
        worlds: n of them.
        terrains: the different grounds.
        terrain_index: each walker's, [n].
    """

    gains: NDArray[np.float64]
    low_level: NDArray[np.float64]
    bodies: Bodies
    worlds: Worlds
    terrains: tuple[Terrain, ...]
    terrain_index: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.gains)


def check_batch(
    gains: ArrayLike,
    bodies: Bodies | None = None,
    terrains: Terrain | Sequence[Terrain] | None = None,
    terrain_index: ArrayLike | None = None,
    low_level_gains: ArrayLike | None = None,
    worlds: Worlds | None = None,
) -> Batch:
    """A `Batch` from what `simulate` takes; see there for defaults.

    Raises:
        InputError: a shape, a value or an index that cannot be used.
    """
    checks.optional(checks.instance(Bodies))("bodies", bodies)
    checks.optional(checks.instance(Worlds))("worlds", worlds)
    rows = gain_rows(gains)
    count = len(rows)
    if low_level_gains is None:
        low_level_gains = [parameter.default for parameter in LOW_LEVEL_GAINS]
    low_level = gain_rows(low_level_gains, LOW_LEVEL_GAINS, "low_level_gains")
    if len(low_level) not in (1, count):
        size = len(LOW_LEVEL_GAINS)
        raise InputError("low_level_gains.shape", low_level.shape, f"[{count}, {size}] or [{size}]")
    bodies = Bodies.nominal() if bodies is None else bodies
    if len(bodies) not in (1, count):
        raise InputError("bodies", len(bodies), f"one body, or {count}: one a walker")
    worlds = Worlds.nominal() if worlds is None else worlds
    if len(worlds) not in (1, count):
        raise InputError("worlds", len(worlds), f"one world, or {count}: one a walker")
    grounds, index = _check_terrains(terrains, terrain_index, count)
    everyone = np.arange(count)
    return Batch(
        rows,
        low_level[everyone % len(low_level)],
        bodies.take(everyone % len(bodies)),
        worlds.take(everyone % len(worlds)),
        grounds,
        index,
    )


def _check_terrains(
    terrains: Terrain | Sequence[Terrain] | None, terrain_index: ArrayLike | None, count: int
) -> tuple[tuple[Terrain, ...], NDArray[np.int32]]:
    if terrains is None:
        terrains = flat()
    listed = (terrains,) if isinstance(terrains, Terrain) else terrains
    grounds: tuple[Terrain, ...] = checks.each(checks.instance(Terrain))("terrains", listed)
    if not grounds:
        raise InputError("terrains", "none", "at least one terrain")
    if terrain_index is None:
        if len(grounds) not in (1, count):
            allowed = f"one, or {count}: one a walker; else give terrain_index"
            raise InputError("terrains", len(grounds), allowed)
        return grounds, np.arange(count, dtype=np.int32) % np.int32(len(grounds))
    index = checks.row_numbers("terrain_index", terrain_index, len(grounds))
    if len(index) != count:
        raise InputError("terrain_index.shape", index.shape, f"[{count}] of whole numbers")
    return grounds, index.astype(np.int32)
