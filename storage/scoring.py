"""The numbers of one shard: its points on the base setting, the survivors on disturbed ones."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage.schema import ROBUST_EVALUATED, robust_names, shard_table
from storage.sobol import sobol_gains
from storage.specification import Robust, Specification
from taichi_nmm.result import SCORE_FIELDS
from taichi_nmm.settings import Settings

Report = Callable[[float], None]
"""Called with the fraction of the shard that is done."""


@dataclass(frozen=True, eq=False)
class ScoredShard:
    """A shard's table, and which engine computed it."""

    table: pa.Table
    engine: dict[str, Any]


def score_shard(specification: Specification, number: int, report: Report) -> ScoredShard:
    """Simulate the points of shard `number`, which depends on no other shard."""
    import taichi_nmm  # here, so that reading a store never loads the simulator

    first, count = specification.shard_range(number)
    gains = sobol_gains(specification.seed, first, count)
    robust = specification.robust
    share = 1.0 if robust is None else 0.5  # of the progress; the two parts take about as long
    flat = taichi_nmm.simulate(
        gains,
        duration_s=specification.duration_s,
        bodies=specification.body,
        terrains=specification.terrain,
        settings=specification.settings,
        progress=lambda now_s, _: report(share * now_s / specification.duration_s),
    )
    columns = None
    if robust is not None:
        alive = flat.rows["duration_s"] >= robust.min_survival_s
        columns = score_robust(
            gains,
            alive,
            robust,
            specification.settings,
            lambda done: report(share + (1.0 - share) * done),
        )
    return ScoredShard(shard_table(first, gains, flat.rows, columns), dict(flat.metadata))


def score_robust(
    gains: NDArray[np.float64],
    alive: NDArray[np.bool_],
    robust: Robust,
    settings: Settings,
    report: Report,
) -> dict[str, NDArray[Any]]:
    """Mean and spread over the robust settings of every score component.

    Args:
        gains: [n, 16].
        alive: the points to run, [n]; the others get zeros.

    Returns:
        Columns by name, [n] each.
    """
    import taichi_nmm

    columns: dict[str, NDArray[Any]] = {ROBUST_EVALUATED: alive}
    names = [robust_names(component) for component, _ in SCORE_FIELDS]
    columns |= {name: np.zeros(len(gains)) for pair in names for name in pair}
    points, count = np.flatnonzero(alive), len(robust.terrains)
    if not len(points):
        return columns
    setting = np.tile(np.arange(count), len(points))
    result = taichi_nmm.simulate(
        np.repeat(gains[points], count, axis=0),
        duration_s=robust.horizon_s,
        bodies=robust.bodies.take(setting),
        terrains=robust.terrains,
        terrain_index=setting,
        settings=settings,
        progress=lambda now_s, _: report(now_s / robust.horizon_s),
    )
    rows = result.rows.reshape(len(points), count)
    for (component, _), (mean, spread) in zip(SCORE_FIELDS, names, strict=True):
        values = rows[component].astype(np.float64)
        columns[mean][points] = values.mean(axis=1)
        columns[spread][points] = values.std(axis=1)
    return columns
