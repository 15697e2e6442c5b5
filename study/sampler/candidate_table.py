"""Tables of candidates: rows of parameters, and the features that say which rows are alike.

A table is all that a sampler knows of a problem before its first trial: n parameter sets, and for
each k numbers computed beforehand (by a simulator, a model, an expert). Nothing here knows what the
parameters or the features mean.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike
from optuna.distributions import BaseDistribution

from study.sampler.checked_rows import Bounds, make_rows
from study.sampler.columns import feature_matrix
from study.sampler.description import table_text
from study.sampler.rows import Rows
from taichi_nmm import checks
from taichi_nmm.errors import InputError

if TYPE_CHECKING:
    import pandas


def _frame(field: str, value: Any) -> Any:
    """Anything that has columns by name, as data frames do; no package of them is loaded."""
    if isinstance(value, type) or not hasattr(value, "columns"):
        raise InputError(field, value, "a pandas data frame")
    return value


COLUMN_CHECKS = {
    "path": checks.path,
    "features": checks.each(checks.text),
    "space": checks.optional(checks.by_name(checks.instance(BaseDistribution))),
    "bounds": checks.optional(checks.by_name(checks.interval())),
}


class CandidateTable:
    """n candidate rows: d parameters and k features each. Make one by a `from_` method.

    What becomes of imperfect columns (each with one warning when the table is made):

    - infinity is a value, the largest or the least; NaN is a gap;
    - a row that lacks more than half of its features is kept out of the proposals;
    - a feature without a finite value, or with one value only, says nothing and weighs nothing;
    - of rows with equal parameters, the first counts.

    A table read from a file keeps the path and a SHA-256: pickled, it carries these alone, and
    reads the file again where it is used. A table made of arrays carries its arrays.

    Attributes:
        digest: SHA-256 of names, parameters and features.
        source: the file or folder that it was read from; None for arrays.
    """

    @checks.checked(
        rows=checks.instance(Rows),
        reload=checks.optional(checks.function),
        source=checks.optional(checks.path),
    )
    def __init__(self, rows: Rows, reload: Callable[[], Rows] | None, source: Path | None):
        """Use `from_parquet`, `from_arrays` or `from_dataframe`."""
        self._rows: Rows | None = rows
        self._reload = reload
        self.source = source
        self.digest = rows.digest()
        self._size = table_text(len(rows), len(rows.names), rows.feature_names)
        _warn_of(rows, type(self).__name__)

    @classmethod
    @checks.checked(parameters=checks.each(checks.text), **COLUMN_CHECKS)
    def from_parquet(
        cls,
        path: str | Path,
        *,
        features: Sequence[str],
        parameters: Sequence[str],
        space: Mapping[str, BaseDistribution] | None = None,
        bounds: Bounds | None = None,
    ) -> Self:
        """Columns of a Parquet file, or of a folder of Parquet files.

        Args:
            path: a file, or a folder of files, read in the order of their names.
            features: columns to compare rows by, k of them.
            parameters: columns that the study will suggest, d of them.
            space: distributions of some or all parameters; by default those of `from_arrays`.
            bounds: as in `from_arrays`.

        Raises:
            InputError: no such file or column, or what `from_arrays` refuses.
        """
        from study.sampler.parquet import ParquetColumns  # PyArrow is slow to load

        reload = ParquetColumns(
            Path(path).absolute(),
            tuple(features),
            tuple(parameters),
            None if space is None else dict(space),
            None if bounds is None else dict(bounds),
        )
        return cls(reload(), reload, reload.path)

    @classmethod
    @checks.checked(
        "table.",
        parameters=checks.by_name(checks.anything),
        feature_names=checks.optional(checks.each(checks.text)),
        space=COLUMN_CHECKS["space"],
        bounds=COLUMN_CHECKS["bounds"],
    )
    def from_arrays(
        cls,
        parameters: Mapping[str, ArrayLike],
        features: ArrayLike,
        feature_names: Sequence[str] | None = None,
        *,
        bounds: Bounds | None = None,
        space: Mapping[str, BaseDistribution] | None = None,
    ) -> Self:
        """Columns of parameters by name, each [n], and features [n, k] or, for one, [n].

        Args:
            parameters: columns without gaps (None among words or flags is a choice). A study may
                suggest each in its own way, on a logarithmic scale or as choices, if that holds all
                rows; where none has said otherwise, floats are taken for such, integers for
                integers, and anything else for choices.
            features: higher or lower, better or worse, of any scale: their order counts.
            feature_names: k names; by default feature_0, feature_1, ...
            bounds: (low, high) of numeric parameters; by default those of the columns.
            space: distributions of parameters, where columns do not say enough: a logarithmic
                scale, a step, choices.

        Raises:
            InputError: naming the column and row that cannot be used: lengths that differ, values
                missing, a row outside the bounds or the distribution, a name that is not there.
        """
        return cls(make_rows(parameters, features, feature_names, bounds, space), None, None)

    @classmethod
    @checks.checked(frame=_frame, parameters=checks.each(checks.text), **COLUMN_CHECKS)
    def from_dataframe(
        cls,
        frame: "pandas.DataFrame",
        *,
        parameters: Sequence[str],
        features: Sequence[str],
        bounds: Bounds | None = None,
        space: Mapping[str, BaseDistribution] | None = None,
    ) -> Self:
        """Named columns of a pandas data frame; otherwise as `from_arrays`."""
        for name in [*parameters, *features]:
            if name not in frame.columns:
                known = ", ".join(str(column) for column in frame.columns)
                raise InputError("column", name, f"one of {known}")
        columns = {name: frame[name].to_numpy() for name in parameters}
        stacked = [feature_matrix(frame[name].to_numpy(), (name,)) for name in features]
        matrix = np.hstack(stacked) if stacked else np.empty((len(frame), 0))
        return cls.from_arrays(columns, matrix, features, bounds=bounds, space=space)

    @property
    def rows(self) -> Rows:
        """The content, read again from the file where this process has not got it."""
        if self._rows is None:
            assert self._reload is not None  # only tables of a file are pickled without content
            rows = self._reload()
            if rows.digest() != self.digest:
                raise InputError("store", str(self.source), "the store this table was made from")
            self._rows = rows
        return self._rows

    def __len__(self) -> int:
        """Number of rows, n."""
        return len(self.rows)

    def __repr__(self) -> str:
        """Its size and features; nothing is read for it."""
        return f"{type(self).__name__}({self._size})"

    def __getstate__(self) -> dict[str, Any]:
        """Without the content, where it can be read again."""
        state = self.__dict__.copy()
        if self._reload is not None:
            state["_rows"] = None
        return state


def _warn_of(rows: Rows, table: str) -> None:
    """Say once what the table leaves out."""
    said = []
    if rows.incomplete:
        said.append(
            f"{rows.incomplete} rows that lack more than half of their features are not proposed"
        )
    if rows.duplicates:
        said.append(f"{rows.duplicates} rows repeat the parameters of another and are not proposed")
    if rows.empty_features:
        names = ", ".join(rows.empty_features)
        said.append(f"features without information are ignored: {names}")
    if said:
        warnings.warn(f"{table}: {'; '.join(said)}.", UserWarning, stacklevel=6)  # beyond two doors
