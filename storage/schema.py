"""The columns of a store: their names, their Arrow types, and a shard's table made of them."""

from collections.abc import Iterator

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from taichi_nmm.parameters import GAIN_NAMES
from taichi_nmm.result import END_REASONS, RESULT_DTYPE, SCORE_FIELDS

ROBUST_EVALUATED = "robust_evaluated"
SCORE_UNITS = ("mps",)  # units that end the name of a score component

_ARROW_TYPES = {"f8": pa.float64(), "i4": pa.int32()}


def robust_names(component: str) -> tuple[str, str]:
    """Columns of a component's mean and spread; a unit stays last (robust_m5_sum_mean_mps)."""
    stem, _, unit = component.rpartition("_")
    if unit not in SCORE_UNITS:
        return f"robust_{component}_mean", f"robust_{component}_sd"
    return f"robust_{stem}_mean_{unit}", f"robust_{stem}_sd_{unit}"


def arrow_schema(robust: bool) -> pa.Schema:
    """The schema of a shard, with the robust columns or without."""
    fields = [("row", pa.int64()), *((name, pa.float64()) for name in GAIN_NAMES)]
    fields += list(_result_fields())
    if robust:
        fields.append((ROBUST_EVALUATED, pa.bool_()))
        for component, _ in SCORE_FIELDS:
            fields += [(name, pa.float64()) for name in robust_names(component)]
    return pa.schema([pa.field(name, kind, nullable=False) for name, kind in fields])


def columns_of(schema: pa.Schema) -> list[str]:
    """``name: type`` of every column, as a specification lists them."""
    return [f"{field.name}: {field.type}" for field in schema]


def shard_table(
    first_row: int,
    gains: NDArray[np.float64],
    rows: NDArray[np.void],
    robust: dict[str, NDArray[np.generic]] | None,
) -> pa.Table:
    """The table of one shard.

    Args:
        first_row: number of its first point in the whole store.
        gains: [n, 16].
        rows: `RESULT_DTYPE`, [n].
        robust: the robust columns by name, [n] each; None where the store has none.
    """
    columns = {"row": np.arange(first_row, first_row + len(gains))}
    columns |= dict(zip(GAIN_NAMES, gains.T, strict=True))
    columns |= {name: rows[name] for name in RESULT_DTYPE.names or ()}
    columns["end_reason"] = np.array(END_REASONS)[rows["end_reason"]]
    schema = arrow_schema(robust is not None)
    arrays = [
        pa.array(np.ascontiguousarray((columns | (robust or {}))[field.name]), field.type)
        for field in schema
    ]
    return pa.Table.from_arrays(arrays, schema=schema)


def _result_fields() -> Iterator[tuple[str, pa.DataType]]:
    for name in RESULT_DTYPE.names or ():
        kind = RESULT_DTYPE[name].str[1:]
        yield name, pa.string() if name == "end_reason" else _ARROW_TYPES[kind]
