"""A problem's file: its pool with features and cost of every row, computed here, once."""

import json
import platform
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from optuna.distributions import distribution_to_json
from threadpoolctl import threadpool_limits

from storage.commit import commit, writable
from study.benchmarks.outside.candidate_pool import Column, pool
from study.benchmarks.outside.definition import Definition, Settings
from study.benchmarks.outside.outside_problem import COST, FEATURE_PREFIX, METADATA_KEY

PACKAGES = ("numpy", "scipy", "scikit-learn", "mujoco")

Progress = Callable[[Iterable[Settings]], Iterable[Settings]]


def make(definition: Definition, path: Path, progress: Progress, rows: int | None = None) -> None:
    """Compute a problem's file.

    Args:
        definition: of the problem.
        path: of the file.
        progress: shows how far it has come; gets the settings and gives them on, one by one.
        rows: of the pool, the first so many; None: all.

    Raises:
        InputError: the file cannot be written.
    """
    with writable(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    whole = pool(definition.name, definition.space)
    columns = {name: values[:rows] for name, values in whole.items()}
    features, cost = [], []
    with threadpool_limits(1):  # sums in one order; and small matrices are no quicker with more
        for settings in progress(rows_of(columns)):
            features.append(definition.cheap(settings))
            cost.append(definition.costly(settings))
    table = _table(definition, columns, np.array(features), np.array(cost))

    def write(temporary: Path) -> None:
        pq.write_table(table, temporary, compression="zstd", compression_level=19)

    def check(temporary: Path) -> None:
        found = pq.read_table(temporary)
        if found.schema.metadata != table.schema.metadata or not all(
            np.array_equal(*numbers, equal_nan=numbers[0].dtype.kind == "f")
            for numbers in zip(_arrays(found), _arrays(table), strict=True)
        ):
            raise OSError("what was read back differs from what was written")

    commit(path, write, check)


def rows_of(columns: dict[str, Column]) -> list[Settings]:
    """Columns [n] as n settings of plain Python values."""
    lists = [values.tolist() for values in columns.values()]
    return [dict(zip(columns, row, strict=True)) for row in zip(*lists, strict=True)]


def _table(
    definition: Definition, columns: dict[str, Column], features: Any, cost: Any
) -> pa.Table:
    """Parameters as they are, features and cost in 32 bits, and in the metadata what they mean."""
    if not np.isfinite(cost).all():
        raise AssertionError(f"{definition.name}: a cost is not finite")
    arrays = {name: pa.array(values) for name, values in columns.items()}
    with np.errstate(over="ignore"):  # beyond 32 bits a cheap run has failed: infinite
        narrow = features.astype(np.float32)
    for place, name in enumerate(definition.features):
        arrays[FEATURE_PREFIX + name] = pa.array(narrow[:, place])
    arrays[COST] = pa.array(cost.astype(np.float32))
    metadata = {METADATA_KEY: json.dumps(described(definition)).encode()}
    return pa.table(arrays).replace_schema_metadata(metadata)


def _arrays(table: pa.Table) -> list[Any]:
    """The columns of a table, [n] each: Arrow's own comparison holds NaN to differ from NaN."""
    return [column.to_numpy() for column in table.columns]


def described(definition: Definition) -> dict[str, Any]:
    """All of a definition but its functions, and where its file was made, as plain values."""
    return {
        "name": definition.name,
        "purpose": definition.purpose,
        "field": definition.field,
        "cost_meaning": definition.cost_meaning,
        "space": {name: distribution_to_json(d) for name, d in definition.space.items()},
        "features": {
            name: {"good": feature.good, "meaning": feature.meaning}
            for name, feature in definition.features.items()
        },
        "command": f"python tools/make_outside.py --problem {definition.name}",
        "versions": {"python": platform.python_version()} | _installed(),
    }


def _installed() -> dict[str, str]:
    """Versions of the packages that decide the numbers, where they are installed."""
    found = {}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found
