"""The columns of a store: their names, their Arrow types, and a shard's table made of them."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from taichi_nmm.parameters import GAIN_NAMES
from taichi_nmm.result import END_REASONS, RESULT_DTYPE, SCORE_FIELDS

SCORE_UNITS = ("mps",)  # units that end the name of a score component

ORIGIN = "origin"  # column of a store with a repertoire: where a row's point comes from
SOBOL_ROW, EVOLVED_ROW = ORIGINS = ("sobol", "evolved")

_ARROW_TYPES = {"f8": pa.float64(), "i4": pa.int32()}


def evaluated_name(family: str) -> str:
    """Column that says whether a point was run on the settings of a family."""
    return f"{family}_evaluated"


def family_names(family: str, component: str) -> tuple[str, str]:
    """Columns of a component's mean and spread over a family of settings.

    A unit stays last: robust_m5_sum_mean_mps.
    """
    stem, _, unit = component.rpartition("_")
    if unit not in SCORE_UNITS:
        return f"{family}_{component}_mean", f"{family}_{component}_sd"
    return f"{family}_{stem}_mean_{unit}", f"{family}_{stem}_sd_{unit}"


def arrow_schema(
    searched: Iterable[str] = (), families: Iterable[str] = (), origin: bool = False
) -> pa.Schema:
    """The schema of a shard.

    Args:
        searched: names of the parameters searched besides the 16 gains.
        families: names of the families of settings.
        origin: whether rows say where their points come from.
    """
    fields = [("row", pa.int64()), *((name, pa.float64()) for name in (*GAIN_NAMES, *searched))]
    fields += list(_result_fields())
    for family in families:
        fields.append((evaluated_name(family), pa.bool_()))
        for component, _ in SCORE_FIELDS:
            fields += [(name, pa.float64()) for name in family_names(family, component)]
    if origin:
        fields.append((ORIGIN, pa.string()))
    return pa.schema([pa.field(name, kind, nullable=False) for name, kind in fields])


def columns_of(schema: pa.Schema) -> list[str]:
    """``name: type`` of every column, as a specification lists them."""
    return [f"{field.name}: {field.type}" for field in schema]


def shard_table(
    schema: pa.Schema,
    first_row: int,
    names: Sequence[str],
    points: NDArray[np.float64],
    rows: NDArray[np.void],
    families: dict[str, NDArray[np.generic]],
    origin: str = SOBOL_ROW,
) -> pa.Table:
    """The table of one shard.

    Args:
        schema: of the store.
        first_row: number of its first point in the whole store.
        names: of the parameters, [16 + k].
        points: [n, 16 + k].
        rows: `RESULT_DTYPE`, [n].
        families: the columns of all families of settings by name, [n] each.
        origin: where the points come from, one of `ORIGINS`.
    """
    columns = {"row": np.arange(first_row, first_row + len(points))}
    columns |= dict(zip(names, points.T, strict=True))
    columns |= {name: rows[name] for name in RESULT_DTYPE.names or ()}
    columns["end_reason"] = np.array(END_REASONS)[rows["end_reason"]]
    columns[ORIGIN] = np.full(len(points), origin)
    arrays = [
        pa.array(np.ascontiguousarray((columns | families)[field.name]), field.type)
        for field in schema
    ]
    return pa.Table.from_arrays(arrays, schema=schema)


def _result_fields() -> Iterator[tuple[str, pa.DataType]]:
    for name in RESULT_DTYPE.names or ():
        kind = RESULT_DTYPE[name].str[1:]
        yield name, pa.string() if name == "end_reason" else _ARROW_TYPES[kind]
