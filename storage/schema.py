"""The columns of a store: their names, their Arrow types, and a shard's table made of them."""

from collections.abc import Iterable, Mapping

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage.simulator import Simulator

SCORE_UNITS = ("mps",)  # units that end the name of a score

ORIGIN = "origin"  # column of a store with a repertoire: the origin of a row's point
SOBOL_ROW, EVOLVED_ROW = "sobol", "evolved"


def evaluated_name(family: str) -> str:
    """Column of flags: was a point run in the worlds of a family?"""
    return f"{family}_evaluated"


def family_names(family: str, score: str) -> tuple[str, str]:
    """Columns of a score's mean and spread over the worlds of a family.

    A unit stays last: robust_m5_sum_mean_mps.
    """
    stem, _, unit = score.rpartition("_")
    if unit not in SCORE_UNITS:
        return f"{family}_{score}_mean", f"{family}_{score}_sd"
    return f"{family}_{stem}_mean_{unit}", f"{family}_{stem}_sd_{unit}"


def arrow_schema(
    simulator: Simulator, families: Iterable[str] = (), origin: bool = False
) -> pa.Schema:
    """The schema of a shard; with `origin`, rows name the origin of their points."""
    fields = [("row", pa.int64())]
    fields += [(parameter.name, pa.float64()) for parameter in simulator.parameters]
    for name in simulator.columns.names or ():
        kind = pa.from_numpy_dtype(simulator.columns[name])
        fields.append((name, pa.string() if name in simulator.words else kind))
    for family in families:
        fields.append((evaluated_name(family), pa.bool_()))
        for score in simulator.scores:
            fields += [(name, pa.float64()) for name in family_names(family, score)]
    if origin:
        fields.append((ORIGIN, pa.string()))
    return pa.schema([pa.field(name, kind, nullable=False) for name, kind in fields])


def columns_of(schema: pa.Schema) -> list[str]:
    """``name: type`` of every column, as a specification lists them."""
    return [f"{field.name}: {field.type}" for field in schema]


def shard_table(
    schema: pa.Schema,
    simulator: Simulator,
    first_row: int,
    points: NDArray[np.float64],
    rows: NDArray[np.void],
    families: Mapping[str, NDArray[np.generic]],
    origin: str = SOBOL_ROW,
) -> pa.Table:
    """The table of one shard.

    Args:
        schema: of the store.
        simulator: of the store.
        first_row: number of the first point in the whole store.
        points: [n, p].
        rows: of the base setting, [n].
        families: the columns of all families by name, [n] each.
        origin: of the points.
    """
    columns: dict[str, NDArray[np.generic]] = {
        "row": np.arange(first_row, first_row + len(points)),
        ORIGIN: np.full(len(points), origin),
        **{each.name: values for each, values in zip(simulator.parameters, points.T, strict=True)},
        **{name: rows[name] for name in simulator.columns.names or ()},
        **{name: np.array(words)[rows[name]] for name, words in simulator.words.items()},
        **families,
    }
    arrays = [pa.array(np.ascontiguousarray(columns[each.name]), each.type) for each in schema]
    return pa.Table.from_arrays(arrays, schema=schema)
