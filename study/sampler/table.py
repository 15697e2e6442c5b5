"""Tables of candidates: rows of parameters, and the features that say which rows are alike.

A table describes a problem before its first trial: n parameter sets, and k numbers for
each, computed beforehand (by a simulator, a model, an expert). Their meaning does not
matter here. Users make a `FeatureTable`; `rows.Rows` is its content; `columns` reads and
checks it.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike
from optuna.distributions import BaseDistribution

from storage.inputs import checks
from storage.inputs.errors import InputError, listed
from study.sampler.arrays import Floats
from study.sampler.columns import Bounds, FileColumns, checked_rows, feature_matrix
from study.sampler.rows import Rows
from study.sampler.similarity import factor_of_gram, factor_of_graph
from study.sampler.worlds import Better, Outcomes

if TYPE_CHECKING:
    import pandas

NAMES_SHOWN = 3  # features, at a prompt

# Anything that has columns by name, as data frames do; no package of them is loaded.
IS_FRAME = checks.that(
    lambda value: not isinstance(value, type) and hasattr(value, "columns"),
    "a pandas data frame",
)
SPACE_CHECKS = {
    "space": checks.optional(checks.by_name(checks.instance(BaseDistribution))),
    "bounds": checks.optional(checks.by_name(checks.interval())),
}
COLUMN_CHECKS = SPACE_CHECKS | {
    "path": checks.path,
    "features": checks.each(checks.text),
}


class FeatureTable:
    """n candidate rows: d parameters and k features each. Make one by a `from_` method.

    What becomes of imperfect columns (each with one warning when the table is made):

    - infinity is a value, the largest or the least; NaN is a gap;
    - a row that lacks more than half of its features is kept out of the proposals;
    - a feature without a finite value, or with one value only, has no weight;
    - of rows with equal parameters, the first counts.

    A table read from a file keeps the path and a SHA-256: pickled, it carries these
    alone, and reads the file again where it is used. A table made of arrays carries its
    arrays.

    Attributes:
        digest: SHA-256 of names, parameters and features.
        source: the file or folder that it was read from; None for arrays.
    """

    @checks.checked(
        rows=checks.instance(Rows), file=checks.optional(checks.instance(FileColumns))
    )
    def __init__(self, rows: Rows, file: FileColumns | None = None):
        """Use `from_parquet`, `from_arrays` or `from_dataframe`."""
        self._rows: Rows | None = rows
        self._file = file
        self.source = None if file is None else file.path
        self.digest = rows.digest()
        self._size = _size_text(rows)
        _warn_of(rows)

    @classmethod
    @checks.checked(
        parameters=checks.optional(checks.each(checks.text)), **COLUMN_CHECKS
    )
    def from_parquet(
        cls,
        path: str | Path,
        *,
        features: Sequence[str],
        parameters: Sequence[str] | None = None,
        space: Mapping[str, BaseDistribution] | None = None,
        bounds: Bounds | None = None,
    ) -> Self:
        """Columns of a Parquet file, of a folder of them, of a text such as CSV, or of a store.

        Args:
            path: a file; a folder of Parquet files, read in the order of their names,
                in which the names of folders by the name KEY=VALUE are columns too; or
                a store of this project (folder, shard or merged file), whose parameters
                and bounds are known and need not be given.
            features: columns to compare rows by, k of them.
            parameters: columns that the study will suggest, d of them; None: `path` is
                a store.
            space: distributions of some or all parameters; by default those of
                `from_arrays`.
            bounds: as in `from_arrays`; None: of a store, those that it was made with.

        Raises:
            InputError: no such file, store or column, or what `from_arrays` refuses.
        """
        columns = FileColumns(
            path=Path(path).absolute(),
            features=features,
            parameters=parameters,
            space=space,
            bounds=bounds,
        )
        return cls(columns.read(), columns)

    @classmethod
    @checks.checked(
        "table.",
        parameters=checks.by_name(checks.anything),
        feature_names=checks.optional(checks.each(checks.text)),
        better=checks.optional(checks.word("lower", "higher")),
        limits=checks.optional(checks.by_name(checks.anything)),
        **SPACE_CHECKS,
    )
    def from_arrays(
        cls,
        parameters: Mapping[str, ArrayLike],
        features: ArrayLike | None = None,
        feature_names: Sequence[str] | None = None,
        *,
        outcomes: Outcomes | None = None,
        better: Better | None = None,
        limits: Mapping[str, Outcomes] | None = None,
        bounds: Bounds | None = None,
        space: Mapping[str, BaseDistribution] | None = None,
    ) -> Self:
        """Columns of parameters by name, each [n], and features [n, k], outcomes, or both.

        Args:
            parameters: columns without gaps (None among words or flags is a choice). A
                study may suggest each in its own way, on a logarithmic scale or as
                choices, if that holds all rows. Before a trial has suggested it, and
                without `space`, floats are floats, integers are integers, and anything
                else is a choice.
            features: higher or lower, better or worse, of any scale: their order
                counts; [n] for one feature.
            outcomes: what each row costs in each of w simulated worlds, [n, w], in the
                units of the study's values; or by family, {name: [n, w]}, where each
                family counts the same.
            better: "higher" or "lower" says which outcomes are good, where they are in
                other units than the study's values: shares survived, scores.
            limits: what each row comes to in simulated worlds, by the name of a limit,
                [n, w] or by family: above 0 it breaks the limit there, as by
                `trial.set_constraint` in a trial.
            feature_names: k names; by default feature_0, feature_1, ...
            bounds: (low, high) of numeric parameters; by default those of the columns.
                All rows lie within. Whole numbers with bounds that are not whole are
                floats.
            space: distributions of parameters, where columns do not say enough: a
                logarithmic scale, a step, choices.

        Raises:
            InputError: naming the column and row that cannot be used: lengths that
                differ, values missing, a row outside the bounds or the distribution, a
                name that is not there.
        """
        rows = checked_rows(
            parameters,
            features,
            feature_names,
            bounds=bounds,
            space=space,
            outcomes=outcomes,
            better=better,
            limits=limits,
        )
        return cls(rows)

    @classmethod
    @checks.checked(
        "table.", parameters=checks.optional(checks.by_name(checks.anything))
    )
    def from_kernel(
        cls, gram: ArrayLike, parameters: Mapping[str, ArrayLike] | None = None
    ) -> Self:
        """A pool of n rows of which a similarity is known, and nothing else.

        Args:
            gram: K [n, n], symmetric and positive semidefinite: the covariance of what
                the rows cost, up to a factor, such as Tanimoto similarities of
                molecules.
            parameters: columns that the study suggests, as in `from_arrays`; by default
                the number of the row, an integer `row` from 0.

        Raises:
            InputError: K is not such a matrix, or what `from_arrays` refuses.
        """
        return cls._of_factor(factor_of_gram(gram), parameters)

    @classmethod
    @checks.checked(
        "table.",
        hops=checks.number(1e-3, 1e3),
        parameters=checks.optional(checks.by_name(checks.anything)),
    )
    def from_graph(
        cls,
        weights: ArrayLike,
        parameters: Mapping[str, ArrayLike] | None = None,
        *,
        hops: float = 10.0,
    ) -> Self:
        """A pool of n rows that are the nodes of a graph: neighbours cost about the same.

        Args:
            weights: of edges, [n, n], symmetric, 0 where there is none; an array, or
                sparse.
            parameters: as in `from_kernel`.
            hops: how many edges away nodes are still alike.

        Raises:
            InputError: no such weights, or what `from_arrays` refuses.
        """
        return cls._of_factor(factor_of_graph(weights, hops), parameters)

    @classmethod
    def _of_factor(
        cls, factor: Floats, parameters: Mapping[str, ArrayLike] | None
    ) -> Self:
        columns = {"row": np.arange(len(factor))} if parameters is None else parameters
        rows = checked_rows(columns, factor)
        nothing = np.empty((len(factor), 0))
        return cls(replace(rows, feature_names=(), features=nothing, alike=factor))

    @classmethod
    @checks.checked(
        frame=IS_FRAME, parameters=checks.each(checks.text), **COLUMN_CHECKS
    )
    def from_dataframe(
        cls,
        frame: "pandas.DataFrame",
        *,
        parameters: Sequence[str],
        features: Sequence[str],
        bounds: Bounds | None = None,
        space: Mapping[str, BaseDistribution] | None = None,
    ) -> Self:
        """Named columns of a pandas data frame.

        Args:
            frame: a row a candidate, n of them.
            parameters: names of d columns.
            features: names of k columns of numbers.
            bounds: as in `from_arrays`.
            space: as in `from_arrays`.
        """
        for name in [*parameters, *features]:
            if name not in frame.columns:
                raise InputError(
                    "column", name, f"one of {listed(frame.columns, name)}"
                )
        columns = {name: frame[name].to_numpy() for name in parameters}
        stacked = [feature_matrix(frame[name].to_numpy(), (name,)) for name in features]
        matrix = np.hstack(stacked) if stacked else np.empty((len(frame), 0))
        return cls.from_arrays(columns, matrix, features, bounds=bounds, space=space)

    @property
    def rows(self) -> Rows:
        """The content, read again from the file where this process has not got it."""
        if self._rows is None:
            # Only tables of a file are pickled without content.
            assert self._file is not None
            rows = self._file.read()
            if rows.digest() != self.digest:
                raise InputError(
                    "store", str(self.source), "the store this table was made from"
                )
            self._rows = rows
        return self._rows

    def __len__(self) -> int:
        """Number of rows, n."""
        return len(self.rows)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._size})"

    def __getstate__(self) -> dict[str, Any]:
        """The state without the content, where it can be read again."""
        return self.__dict__ | ({} if self._file is None else {"_rows": None})


def _warn_of(rows: Rows) -> None:
    said = []
    if count := int((~rows._known).sum()):
        said.append(
            f"{count} rows that lack more than half of their features are not proposed"
        )
    if count := int((~rows._first).sum()):
        said.append(
            f"{count} rows repeat the parameters of another and are not proposed"
        )
    flags = zip(rows.feature_names, rows._informative, strict=True)
    if empty := [name for name, informative in flags if not informative]:
        said.append(f"features without information are ignored: {', '.join(empty)}")
    if said:
        # The caller's line lies beyond two doors of `checks`.
        warnings.warn(f"FeatureTable: {'; '.join(said)}.", UserWarning, stacklevel=6)


def _size_text(rows: Rows) -> str:
    """Size and features of a table, as the arguments of a call."""
    names, counts = rows.feature_names, {"row": len(rows), "parameter": len(rows.names)}
    if names or (rows.worlds is None and rows.alike is None):
        counts["feature"] = len(names)
    if rows.worlds is not None:
        counts["world"] = len(rows.worlds.names)
    sizes = [f"1 {one}" if n == 1 else f"{n} {one}s" for one, n in counts.items()]
    if rows.alike is not None:
        sizes.append(f"similarity of rank {rows.alike.shape[1]}")
    if not names:
        return ", ".join(sizes)
    more = ["..."] if len(names) > NAMES_SHOWN else []
    return f"{', '.join(sizes)}: {', '.join([*names[:NAMES_SHOWN], *more])}"
