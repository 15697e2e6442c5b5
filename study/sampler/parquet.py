"""Columns of Parquet files as the rows of a table."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution

from study.sampler.checked_rows import Bounds, make_rows
from study.sampler.columns import Floats
from study.sampler.points import let_go
from study.sampler.rows import Rows
from taichi_nmm.errors import InputError
from taichi_nmm.reading import is_folder, reading

MOST_WAITING_BYTES = 2**28  # written to a matrix that may be a file's, before memory is let go


@dataclass(frozen=True)
class ParquetColumns:
    """Where a table was read from: calling it reads it (again).

    Attributes:
        path: a file, or a folder of them.
        features: k columns.
        parameters: d columns.
        space: distributions of some parameters.
        bounds: (low, high) of some parameters.
    """

    path: Path
    features: tuple[str, ...]
    parameters: tuple[str, ...]
    space: Mapping[str, BaseDistribution] | None
    bounds: Bounds | None

    def __call__(self) -> Rows:
        """Read the columns, and check them."""
        require_features(self.features)
        table = _read(self.path, (*self.parameters, *self.features))
        return arrow_rows(table, self.parameters, self.features, self.bounds, self.space)


def require_features(features: Sequence[str]) -> None:
    """Refuse to read a table that says nothing of its rows."""
    if not features:
        raise InputError("features", "none", "at least one column")


def arrow_rows(
    table: pa.Table,
    parameters: Sequence[str],
    features: Sequence[str],
    bounds: Bounds | None,
    space: Mapping[str, BaseDistribution] | None,
) -> Rows:
    """The n rows of an Arrow table, checked as `make_rows` does.

    Args:
        table: that has all columns named here, and may have others.
        parameters: names of d columns.
        features: names of k columns of numbers.
        bounds: as of `make_rows`.
        space: as of `make_rows`.
    """
    columns = {name: _numpy(table, name) for name in parameters}
    return make_rows(columns, _matrix(table, features), features, bounds, space)


def filled(matrices: Sequence[Floats], tables: Iterable[pa.Table]) -> None:
    """Write the columns of tables, which follow one another, into matrices side by side.

    Raises:
        InputError: a column is none of numbers.
    """
    first, waiting = 0, 0
    for table in tables:
        rows = slice(first, first + len(table))
        targets = (column for matrix in matrices for column in matrix[rows].T)
        for name, target in zip(table.column_names, targets, strict=True):
            try:
                target[:] = _numpy(table, name)
            except (TypeError, ValueError):
                raise InputError("score", name, "a column of numbers") from None
        first, waiting = rows.stop, waiting + table.nbytes
        if waiting > MOST_WAITING_BYTES:
            waiting = 0
            for matrix in matrices:
                let_go(matrix)


def _read(path: Path, names: Sequence[str]) -> pa.Table:
    """Named columns of a file, or of all Parquet files of a folder in the order of their names."""
    allowed = "a Parquet file, or a folder of them, that exists"
    files = sorted(path.glob("*.parquet")) if is_folder(path) else [path]
    if not files:
        raise InputError("store", str(path), allowed)
    tables = []
    for each in files:
        with reading("store", each, allowed) as file:
            known = pq.read_schema(file).names
            for name in names:
                if name not in known:
                    raise InputError("column", name, f"one of {', '.join(known)}")
            tables.append(pq.read_table(file, columns=list(names), partitioning=None))
    with reading("store", files[0], "files of the same columns, if there are several"):
        return pa.concat_tables(tables)


def _numpy(table: pa.Table, name: str) -> NDArray[np.generic]:
    """One column, [n]."""
    values: NDArray[np.generic] = table[name].to_numpy()
    return values


def _matrix(table: pa.Table, features: Sequence[str]) -> NDArray[np.float64]:
    """Columns of numbers side by side, [n, k]."""
    matrix = np.empty((len(table), len(features)))
    for column, name in enumerate(features):
        try:
            matrix[:, column] = _numpy(table, name)
        except (TypeError, ValueError):
            raise InputError("score", name, "a column of numbers") from None
    return matrix
