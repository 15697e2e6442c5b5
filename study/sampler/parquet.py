"""Columns of Parquet files as the rows of a table."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution

from storage.store import open_store
from study.sampler.feature_table import make_rows
from study.sampler.rows import Rows
from taichi_nmm.errors import InputError


@dataclass(frozen=True)
class ParquetColumns:
    """Where a table was read from: calling it reads it (again)."""

    path: Path
    features: tuple[str, ...]
    parameters: tuple[str, ...] | None
    space: Mapping[str, BaseDistribution] | None
    bounds: Mapping[str, tuple[float, float]] | None

    def __call__(self) -> Rows:
        """Read the columns, and check them."""
        if not self.features:
            raise InputError("features", "none", "at least one column")
        if self.parameters is None:
            return self._of_store()
        table = _read(self.path, (*self.parameters, *self.features))
        columns = {name: _numpy(table, name) for name in self.parameters}
        matrix = _matrix(table, self.features)
        return make_rows(columns, matrix, self.features, self.bounds, self.space)

    def _of_store(self) -> Rows:
        """A store knows its parameters, those beside the 16 gains too, and their bounds."""
        store = open_store(self.path)
        store.require_bounds()
        ranges = store.specification["gains"]
        bounds = {name: (ends["low"], ends["high"]) for name, ends in ranges.items()}
        others = [name for name in store.columns if name not in bounds]
        for name in self.features:
            if name not in others:
                raise InputError("score", name, f"one of {', '.join(others)}")
        table = store.table((*bounds, *self.features))
        columns = {name: _numpy(table, name) for name in bounds}
        matrix = _matrix(table, self.features)
        return make_rows(columns, matrix, self.features, self.bounds or bounds, self.space)


def _read(path: Path, names: Sequence[str]) -> pa.Table:
    """Named columns of a file, or of all Parquet files of a folder in the order of their names."""
    files = sorted(path.glob("*.parquet")) if path.is_dir() else [path]
    if not files or not path.exists():
        raise InputError("store", str(path), "a Parquet file, or a folder of them, that exists")
    tables = []
    for file in files:
        try:
            known = pq.read_schema(file).names
        except (OSError, pa.ArrowException):
            raise InputError("store", str(file), "a Parquet file") from None
        for name in names:
            if name not in known:
                raise InputError("column", name, f"one of {', '.join(known)}")
        tables.append(pq.read_table(file, columns=list(names)))
    return pa.concat_tables(tables)


def _numpy(table: pa.Table, name: str) -> NDArray[np.generic]:
    values: NDArray[np.generic] = table[name].to_numpy()
    return values


def _matrix(table: pa.Table, features: Sequence[str]) -> NDArray[np.float64]:
    matrix = np.empty((len(table), len(features)))
    for column, name in enumerate(features):
        try:
            matrix[:, column] = _numpy(table, name)
        except (TypeError, ValueError):
            raise InputError("score", name, "a column of numbers") from None
    return matrix
