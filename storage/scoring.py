"""The numbers of one shard: its points on the base setting, the survivors on disturbed ones.

And of points on the settings of one family, which is also what a search asks for.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage.families import Family
from storage.schema import EVOLVED_ROW, SOBOL_ROW, evaluated_name, family_names, shard_table
from storage.searched import split_points
from storage.sobol import sobol_gains
from storage.specification import Specification
from taichi_nmm.result import SCORE_FIELDS, Result

Report = Callable[[float], None]
"""Called with the fraction of the shard that is done."""

SURVIVED = "survived_fraction"
TYPICAL_ALIVE = 0.1  # of random points, at the age from which families run them
TYPICAL_KEPT = 0.01  # of random points, where a family comes after another one


@dataclass(frozen=True, eq=False)
class ScoredShard:
    """A shard's table, and which engine computed it."""

    table: pa.Table
    engine: dict[str, Any]


def score_shard(
    specification: Specification,
    number: int,
    report: Report,
    evolved: NDArray[np.float64] | None = None,
) -> ScoredShard:
    """Simulate the points of shard `number`, which depends on no other shard.

    Args:
        specification: of the store.
        number: of the shard.
        report: called with the fraction of it that is done.
        evolved: its points, [n, 16 + k], where it is one of those after the grid's.
    """
    first, count = specification.shard_range(number)
    parameters, families = specification.parameters, specification.families
    points = evolved
    if points is None:
        points = sobol_gains(specification.seed, first, count, parameters)
    parts = progress_parts(specification, report)
    base = _simulate(
        specification,
        points,
        parts[0],
        duration_s=specification.conditions.duration_s,
        bodies=specification.body,
        worlds=specification.world,
        terrains=specification.terrain,
    )
    columns: dict[str, NDArray[Any]] = {}
    for family, part in zip(families, parts[1:], strict=True):
        chosen = base.rows["duration_s"] >= family.min_survival_s
        if family.after:
            survived = columns[family_names(family.after, SURVIVED)[0]]
            chosen &= survived >= family.min_survived_fraction
        columns |= score_family(specification, family, points, chosen, part)
        part(1.0)
    names = [parameter.name for parameter in parameters]
    origin = SOBOL_ROW if evolved is None else EVOLVED_ROW
    table = shard_table(specification.schema, first, names, points, base.rows, columns, origin)
    return ScoredShard(table, dict(base.metadata))


def score_family(
    specification: Specification,
    family: Family,
    points: NDArray[np.float64],
    chosen: NDArray[np.bool_],
    report: Report,
) -> dict[str, NDArray[Any]]:
    """Mean and spread of every score component over the settings of a family.

    Args:
        specification: the store that the family belongs to.
        family: one of its families.
        points: [n, 16 + k].
        chosen: the points to run, [n]; the others get zeros.
        report: called with the fraction of this family that is done.

    Returns:
        Columns by name, [n] each.
    """
    columns: dict[str, NDArray[Any]] = {evaluated_name(family.name): chosen}
    names = [family_names(family.name, component) for component, _ in SCORE_FIELDS]
    columns |= {name: np.zeros(len(points)) for pair in names for name in pair}
    rows_chosen = np.flatnonzero(chosen)
    if not len(rows_chosen):
        return columns
    rows = walk_family(specification, family, points[rows_chosen], report)
    for (component, _), (mean, spread) in zip(SCORE_FIELDS, names, strict=True):
        values = rows[component].astype(np.float64)
        columns[mean][rows_chosen] = values.mean(axis=1)
        columns[spread][rows_chosen] = values.std(axis=1)
    return columns


def walk_family(
    specification: Specification,
    family: Family,
    points: NDArray[np.float64],
    report: Report,
) -> NDArray[np.void]:
    """Walk every point on every setting of a family.

    Args:
        specification: the store that is being filled.
        family: the settings.
        points: [n, 16 + k].
        report: called with the fraction that is done.

    Returns:
        `RESULT_DTYPE`, [n, settings].
    """
    setting = np.tile(np.arange(family.settings), len(points))
    result = _simulate(
        specification,
        np.repeat(points, family.settings, axis=0),
        report,
        duration_s=family.horizon_s,
        bodies=family.bodies.take(setting),
        worlds=family.worlds.take(setting),
        terrains=family.terrains,
        terrain_index=setting,
    )
    rows: NDArray[np.void] = result.rows.reshape(len(points), family.settings)
    return rows


def progress_parts(specification: Specification, report: Report) -> list[Report]:
    """`report` cut into one for the base setting and one a family, in proportion to their work."""
    work = [specification.conditions.duration_s]
    work += [
        (TYPICAL_KEPT if family.after else TYPICAL_ALIVE) * family.walk_s
        for family in specification.families
    ]
    ends = np.cumsum([0.0, *work]) / sum(work)
    ends[-1] = 1.0

    def part(start: float, end: float) -> Report:
        return lambda done: report(start + (end - start) * min(done, 1.0))

    return [part(float(start), float(end)) for start, end in pairwise(ends)]


def _simulate(
    specification: Specification,
    points: NDArray[np.float64],
    report: Report,
    duration_s: float,
    **options: Any,
) -> Result:
    """Walk the points; low-level gains that are not searched are the simulator's own."""
    import taichi_nmm  # here, so that reading a store never loads the simulator

    gains, low_level = split_points(points, specification.searched)
    if specification.searched:
        options["low_level_gains"] = low_level
    return taichi_nmm.simulate(
        gains,
        duration_s=duration_s,
        settings=specification.conditions.settings,
        progress=lambda now_s, _: report(now_s / duration_s),
        **options,
    )
