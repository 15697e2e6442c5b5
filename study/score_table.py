"""The rows a sampler may propose: parameter sets with their score, from a store or from arrays."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from storage.store import open_store
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, lower_bounds, upper_bounds

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rows:
    """The content of a table.

    Attributes:
        names: of the d parameters.
        low: smallest value allowed of each, [d].
        high: largest value allowed of each, [d].
        parameters: [n, d].
        score: [n].
        standard_score: the score less its mean, divided by its standard deviation, [n].
    """

    names: tuple[str, ...]
    low: Floats
    high: Floats
    parameters: Floats
    score: Floats
    standard_score: Floats

    def __len__(self) -> int:
        """Number of rows, n."""
        return len(self.score)

    def as_parameters(self, row: int) -> dict[str, float]:
        """One row as Optuna wants it: native numbers by name."""
        return dict(zip(self.names, self.parameters[row].tolist(), strict=True))

    def find(self, parameters: Mapping[str, Any]) -> int | None:
        """The first row with exactly these values; None where there is none."""
        if any(name not in parameters for name in self.names):
            return None
        values = np.array([parameters[name] for name in self.names], dtype=np.float64)
        found = np.flatnonzero((self.parameters == values).all(axis=1))
        return int(found[0]) if len(found) else None

    def digest(self) -> str:
        """SHA-256 of names, parameters and scores."""
        digest = hashlib.sha256(" ".join(self.names).encode())
        for values in (self.parameters, self.score):
            digest.update(np.ascontiguousarray(values).data)
        return digest.hexdigest()


class ScoreTable:
    """Parameter sets with one score each.

    A table read from a store keeps the path and a digest: pickled, it carries these alone, and
    reads the store again where it is used. A table made of arrays carries its arrays.
    """

    def __init__(self, rows: Rows, store: Path | None = None, score_name: str = "score") -> None:
        """Use `from_store` or `from_arrays`."""
        self._rows: Rows | None = rows
        self.store = store
        self.score_name = score_name
        self.digest = rows.digest()

    @classmethod
    def from_store(cls, path: str | Path, *, score: str = "phi_printed") -> "ScoreTable":
        """The 16 gains and one score column of a store of this project.

        Args:
            path: a store's folder, one of its shards, or a merged file.
            score: column to compare rows by: `phi_printed` (the paper's), `phi_corrected`, or
                another number of the store.
        """
        path = Path(path).absolute()
        return cls(_read_store(path, score), path, score)

    @classmethod
    def from_arrays(
        cls,
        parameters: Mapping[str, ArrayLike],
        score: ArrayLike,
        *,
        bounds: Mapping[str, tuple[float, float]] | None = None,
    ) -> "ScoreTable":
        """Columns of parameters by name, each [n], and their scores [n].

        Args:
            parameters: columns of finite numbers.
            score: higher or lower, better or worse: only likeness counts.
            bounds: range of each parameter; by default, of its column.
        """
        if not parameters:
            raise InputError("table.parameters", "none", "at least one column")
        columns = [_column(name, values) for name, values in parameters.items()]
        scores = _column("score", score)
        for name, column in zip(parameters, columns, strict=True):
            if len(column) != len(scores):
                raise InputError(f"table.{name}.shape", column.shape, f"{scores.shape}, as score")
        matrix = np.column_stack(columns)
        low, high = _bounds(tuple(parameters), matrix, bounds)
        return cls(_rows(tuple(parameters), low, high, matrix, scores))

    @property
    def rows(self) -> Rows:
        """The content, read again from the store where this process has not got it."""
        if self._rows is None:
            assert self.store is not None  # only tables of a store are pickled without content
            rows = _read_store(self.store, self.score_name)
            if rows.digest() != self.digest:
                raise InputError("store", str(self.store), "the store this table was made from")
            self._rows = rows
        return self._rows

    def __len__(self) -> int:
        """Number of rows, n."""
        return len(self.rows)

    def __getstate__(self) -> dict[str, Any]:
        """Without the content, where it can be read again."""
        state = self.__dict__.copy()
        if self.store is not None:
            state["_rows"] = None
        return state


def _read_store(path: Path, score: str) -> Rows:
    store = open_store(path)
    store.require_bounds()
    if score in GAIN_NAMES or score not in store.columns:
        others = (name for name in store.columns if name not in GAIN_NAMES)
        raise InputError("score", score, f"one of {', '.join(others)}")
    scores = _column(score, store.numpy((score,))[score])
    return _rows(GAIN_NAMES, lower_bounds(), upper_bounds(), store.gains(), scores)


def _column(name: str, values: ArrayLike) -> Floats:
    """A column of finite numbers."""
    try:
        column = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"table.{name}", type(values).__name__, "a column of numbers") from None
    if column.ndim != 1 or not len(column):
        raise InputError(f"table.{name}.shape", column.shape, "[n], n at least 1")
    bad = np.flatnonzero(~np.isfinite(column))
    if len(bad):
        raise InputError(f"table.{name}[{bad[0]}]", float(column[bad[0]]), "a finite number")
    return column


def _bounds(
    names: tuple[str, ...], matrix: Floats, bounds: Mapping[str, tuple[float, float]] | None
) -> tuple[Floats, Floats]:
    """Bounds in the order of the names; those of the columns where none are given."""
    if bounds is None:
        return matrix.min(axis=0), matrix.max(axis=0)
    if set(bounds) != set(names):
        raise InputError("table.bounds", sorted(bounds), f"a range for each of {sorted(names)}")
    pairs = np.array([bounds[name] for name in names], dtype=np.float64)
    return pairs[:, 0], pairs[:, 1]


def _rows(
    names: tuple[str, ...], low: Floats, high: Floats, parameters: Floats, score: Floats
) -> Rows:
    """The content, once every row lies within the bounds."""
    outside = np.argwhere(~((low <= parameters) & (parameters <= high)))
    if len(outside):
        row, column = (int(index) for index in outside[0])
        raise InputError(
            f"table.{names[column]}[{row}]",
            float(parameters[row, column]),
            f"{low[column]:g} to {high[column]:g}",
        )
    sd = float(score.std())
    standard_score = (score - score.mean()) / (sd if sd > 0 else 1.0)
    return Rows(names, low, high, parameters, score, standard_score)
