"""The tables that a comparison leaves in its folder, as a report reads them."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from study.comparison.folder import ARMS_NAME, RESULTS_NAME
from study.experiment.experiment import NAME_PATTERN
from study.report.documents import LARGEST_NUMBER
from taichi_nmm.errors import InputError
from taichi_nmm.reading import is_folder, reading

Kind = tuple[Callable[[pa.DataType], bool], str]

NAMES: Kind = pa.types.is_string, "letters, digits, '.', '_' and '-'"
COUNTS: Kind = pa.types.is_integer, "whole numbers from 0"
FLAGS: Kind = pa.types.is_boolean, "true or false"
NUMBERS: Kind = pa.types.is_floating, f"numbers up to {LARGEST_NUMBER:g}"
KINDS = {
    "experiment": NAMES, "arm": NAMES, "run": COUNTS, "trial": COUNTS, "walked": FLAGS,
}  # fmt: skip


def read_trials(path: Path, columns: Sequence[str]) -> pa.Table:
    """Columns of a table of trials, each value of its kind, finite, and there.

    Raises:
        InputError: not readable, or a column is missing or has something else in it.
    """
    with reading(path.name, path, "a readable table of trials"):
        known = pq.read_schema(path).names
        for name in columns:
            if known.count(name) != 1:
                raise InputError(f"{path.name}: column", name, f"one of {', '.join(known)}, once")
        table = pq.read_table(path, columns=list(columns), partitioning=None)
    for name in columns:
        _require(table[name], name, path)
    return table


def _require(column: pa.ChunkedArray, name: str, path: Path) -> None:
    """Refuse a column of something else than what stands under its name."""
    field, (is_kind, allowed) = f"{path.name}: {name}", KINDS.get(name, NUMBERS)
    if not is_kind(column.type) or column.null_count:
        found = f"{column.type}, {column.null_count} of {len(column)} missing"
        raise InputError(field, found, f"{allowed}, none missing")
    if is_kind is NUMBERS[0] and not (np.abs(column.to_numpy()) <= LARGEST_NUMBER).all():
        raise InputError(field, "NaN, infinite or larger", allowed)
    if is_kind is COUNTS[0] and len(column) and pc.min(column).as_py() < 0:
        raise InputError(field, pc.min(column).as_py(), allowed)
    if is_kind is NAMES[0]:
        for word in pc.unique(column).to_pylist():
            if not re.fullmatch(NAME_PATTERN, word):
                raise InputError(field, word, allowed)


def table_files(folder: Path) -> list[Path]:
    """The final table of a folder, then the checkpoints of its arms: those that there are.

    Raises:
        InputError: no such folder.
    """
    if not is_folder(folder):
        raise InputError("folder", str(folder), "the output folder of taichi-nmm compare")
    final = folder / RESULTS_NAME
    checkpoints = sorted((folder / ARMS_NAME).glob("[!.]*.parquet"))
    return ([final] if final.exists() else []) + checkpoints
