"""Tables of candidates: rows of parameters, and the features that say which rows are alike.

A table describes a problem before its first trial: n parameter sets, and k numbers for
each, computed beforehand (by a simulator, a model, an expert). Their meaning does not
matter here. Users make a `FeatureTable`; `Rows` is its content, with derived arrays;
`columns` reads and checks.
"""

import hashlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray
from optuna.distributions import BaseDistribution

from storage.inputs import checks
from storage.inputs.errors import InputError, listed
from study.sampler.columns import Bounds, FileColumns, checked_columns, feature_matrix
from study.sampler.goals import Goals
from study.sampler.similarity import Alike, Relation, factor_of_gram, factor_of_graph
from study.sampler.space import Number, Space, first_not_taken, standing_for
from study.sampler.transforms import (
    NormalScores,
    Points,
    Scale,
    Standard,
)
from study.sampler.worlds import Better, Ensemble, Outcomes, Worlds

if TYPE_CHECKING:
    import pandas

Floats = NDArray[np.float64]
T = TypeVar("T")
NAMES_SHOWN = 3  # features, at a prompt
NEAR_ROWS = 8  # whose mean a point off the table has
NEAR_POWER = 4  # of the distance, by which their weights fall
BLOCK = 2**13  # rows at a time, to stay in the cache
NEAR_POOL = 128  # rows near each centre, among which these are looked for
HASH_FACTOR = np.uint64(
    0x9E3779B97F4A7C15
)  # 2^64 / golden ratio: Knuth's multiplicative hashing


@dataclass(frozen=True, eq=False)
class Rows:
    """n candidates.

    Attributes:
        space: the d parameters.
        parameters: of each row, [n, d]; of a categorical, the index of its choice.
        feature_names: k names.
        features: of each row, of any scale, [n, k]; NaN where unknown.
        worlds: what each row costs in simulated worlds; None: that is not known.
        alike: vectors whose products are the covariance of the rows, [n, r]; None:
            there are none.
    """

    space: Space
    parameters: Floats
    feature_names: tuple[str, ...]
    features: Floats
    worlds: Worlds | None = None
    alike: Floats | None = None

    def __len__(self) -> int:
        """Number of rows, n."""
        return len(self.parameters)

    def __getstate__(self) -> dict[str, Any]:
        """Without what is derived from the columns."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the d parameters."""
        return self.space.names

    @cached_property
    def standard(self) -> Standard:
        """The affine scale of the features, of rows that may be proposed."""
        return Standard.of(self._chosen(self.features))

    @cached_property
    def scores(self) -> NormalScores:
        """The scale of their order, among rows that may be proposed."""
        return NormalScores.of(self._chosen(self.features))

    def scale(self, *, by_order: bool) -> Scale:
        """`scores` or `standard`."""
        return self.scores if by_order else self.standard

    @cached_property
    def offered(self) -> NDArray[np.bool_]:
        """Rows that may be proposed: half of the features known, parameters of no earlier row."""
        return self._known & self._first

    @cached_property
    def unit(self) -> Floats:
        """Rows that may be proposed in the unit cube, [m, e]."""
        chosen = self._chosen(self.parameters)
        blocks = (
            chosen[first : first + BLOCK]
            for first in range(0, max(len(chosen), 1), BLOCK)
        )
        return np.vstack([self.space.unit(block) for block in blocks])

    @cached_property
    def _lengths(self) -> Floats:
        """|u|^2 of `unit`, [m]."""
        return np.asarray(np.einsum("me,me->m", self.unit, self.unit))

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """Numbers of the rows that may be proposed, ascending, [m]."""
        return np.flatnonzero(self.offered)

    def points(
        self, *, by_order: bool, coordinates: bool, ensemble: Relation | None = None
    ) -> Points:
        """Rows that may be proposed as points, on one of the scales; made once.

        An ensemble of theirs adds columns to the features.
        """

        def made() -> Points:
            chosen = self._chosen(self.features)
            features = self.scores.own if by_order else self.standard.standard(chosen)
            if ensemble is not None:
                features = np.hstack([features, ensemble.columns])
            return Points(
                features, self.unit if coordinates else np.empty((len(features), 0))
            )

        return _once(ensemble or self, (by_order, coordinates), made)

    def ensemble(self, signs: Floats, goals: Goals | None = None) -> Relation:
        """Worlds, or likeness, as the model takes them, of rows that may be proposed.

        `signs` are -1 where values are maximised, [k]. Made once, unless `goals` make
        one of k.
        """
        worlds, alike = self.worlds, self.alike
        if alike is not None:
            return _once(self, "alike", lambda: Alike(self._chosen(alike)))
        assert worlds is not None
        costs = partial(worlds.of_rows, self.numbers, signs, goals)
        if goals is not None:
            return Ensemble(worlds, costs())
        return _once(self, ("ensemble", *signs), lambda: Ensemble(worlds, costs()))

    def mixed(self, columns: Floats, points: Floats, centres: Floats) -> Floats:
        """Columns [m, k] of rows that may be proposed, at other points of the unit cube, [n, k].

        Each point [e] has a mean of its `NEAR_ROWS` nearest rows, weighted by 1 /
        distance^4 (in many dimensions all but the nearest are about as far). They are
        looked for among the `NEAR_POOL` rows that are nearest to each of the centres
        [c, e], which points are near to.
        """
        pools = [
            _once(self, ("pool", c.tobytes()), partial(self._pool, c)) for c in centres
        ]
        pool = np.unique(np.concatenate(pools))
        unit = self.unit[pool]
        # |a|^2 + |b|^2 - 2 a . b, with one product of matrices.
        squares = (
            (points**2).sum(axis=1)[:, None]
            + (unit**2).sum(axis=1)
            - 2.0 * points @ unit.T
        )
        count = min(NEAR_ROWS, len(pool))
        # Of rows as far as the last one all count. To find how far is a third of
        # finding which.
        near = squares <= np.partition(squares, count - 1, axis=1)[:, count - 1 : count]
        weight = 1.0 / (np.sqrt(np.maximum(squares[near], 0.0)) + 1e-3) ** NEAR_POWER
        starts = np.append(0, near.sum(axis=1).cumsum())
        weight /= np.repeat(np.add.reduceat(weight, starts[:-1]), np.diff(starts))
        places = near.nonzero()[1]
        matrix = scipy.sparse.csr_array((weight, places, starts), squares.shape)
        return np.asarray(matrix @ columns[pool])

    def mixed_at(self, points: Points, place: Floats) -> Floats:
        """The features of rows that may be proposed, as points, mixed at a place [e]: [k]."""
        made = partial(self.mixed, points.features, place[None], place[None])
        return np.asarray(_once(points, place.tobytes(), made)[0])

    def _pool(self, centre: Floats) -> NDArray[np.int64]:
        """Places of the rows that are nearest to a point of the unit cube [e]."""
        squares = self._lengths - 2.0 * (
            self.unit @ centre
        )  # less |centre|^2, which all share
        count = min(NEAR_POOL, len(squares))
        return np.argpartition(squares, count - 1)[:count]

    def as_parameters(self, row: int) -> dict[str, Any]:
        """One row as Optuna takes it: native values by name."""
        return self.space.values(self.parameters[row])

    def find(self, values: Mapping[str, Any]) -> int | None:
        """The first row that these values are, or stand for (`space`); None without any."""
        wanted = self.space.row(values)
        if wanted is None:
            return None
        key, (sorted_hash, order) = _hash(wanted[None])[0], self._index
        place = int(np.searchsorted(sorted_hash, key))
        if place < len(order) and sorted_hash[place] == key:
            row = int(order[place])
            if bool((self.parameters[row] == wanted).all()):
                return row
        near = self.having(values)
        return int(near.argmax()) if near.any() else None

    def having(self, values: Mapping[str, Any]) -> NDArray[np.bool_]:
        """Which rows these values of some parameters stand for, [n]: of several the nearest."""
        have, farthest = np.ones(len(self), dtype=bool), np.zeros(len(self))
        distributions = self.space.distributions
        for column, name in enumerate(self.names):
            if name not in values:
                continue
            number, distribution = (
                self.space.number(column, values[name]),
                distributions[column],
            )
            if number is None:
                return np.zeros(len(self), dtype=bool)
            own = self.parameters[:, column]
            if isinstance(distribution, Number):
                near, away = standing_for(distribution, own, number)
                farthest = np.maximum(farthest, away)
            else:
                near = own == number
            have &= near
            if not have.any():
                return have
        return np.asarray(have & (farthest == farthest[have].min()))

    def outside(self, column: int, suggested: BaseDistribution) -> int | None:
        """The first row whose value of one parameter a distribution has not; None: it has all."""
        own = self.space.distributions[column]
        made = partial(first_not_taken, own, self.parameters[:, column], suggested)
        return None if suggested == own else _once(self, (column, suggested), made)

    def digest(self) -> str:
        """SHA-256 of names, distributions, parameters, features and worlds."""
        head = [*self.names, *map(str, self.space.distributions), *self.feature_names]
        matrices = [self.parameters, self.features]
        if self.alike is not None:
            matrices.append(self.alike)
        if self.worlds is not None:
            head += [*self.worlds.names, *filter(None, [self.worlds.better])]
            before = self.worlds.as_before
            matrices.append(self.worlds.costs if before is None else before)
        digest = hashlib.sha256("\n".join(head).encode())
        for values in matrices:
            digest.update(np.ascontiguousarray(values).data)
        return digest.hexdigest()

    def _chosen(self, values: Floats) -> Floats:
        """Those of rows [n, ...] that may be proposed; a copy only where that leaves some out."""
        return values if len(self.numbers) == len(self) else values[self.numbers]

    @cached_property
    def kept(self) -> dict[Any, Any]:
        """What was computed of them, for whoever asks again."""
        return {}

    @cached_property
    def _known(self) -> NDArray[np.bool_]:
        """Rows with at least half of the informative features, and of the worlds, [n]."""
        informed = self.features[:, self._informative]
        known = np.asarray(2 * np.isnan(informed).sum(axis=1) <= informed.shape[1])
        return known if self.worlds is None else known & self.worlds.known

    @cached_property
    def _informative(self) -> NDArray[np.bool_]:
        """Features that have more than one value, [k]."""
        least = np.where(np.isnan(self.features), np.inf, self.features).min(axis=0)
        most = np.where(np.isnan(self.features), -np.inf, self.features).max(axis=0)
        return np.asarray(least < most)

    @cached_property
    def _index(self) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
        """Hashes in ascending order, and the row of each; equal ones by row."""
        hashes = _hash(self.parameters)
        order = np.argsort(hashes, kind="stable")
        return hashes[order], order

    @cached_property
    def _first(self) -> NDArray[np.bool_]:
        """Rows that repeat no earlier row's parameters, [n]."""
        hashes, order = self._index
        first = np.ones(len(self), dtype=bool)
        first[order[1:]] = hashes[1:] != hashes[:-1]
        return first


def _once(owner: Rows | Points | Relation, key: Any, made: Callable[[], T]) -> T:
    """What an owner keeps under a key: each proposal needs it, and the first one computes it."""
    if key not in owner.kept:
        owner.kept[key] = made()
    found: T = owner.kept[key]
    return found


def _hash(parameters: Floats) -> NDArray[np.uint64]:
    """64 bits a row: equal rows have equal ones, and others, in practice, different ones."""
    hashes = np.zeros(len(parameters), dtype=np.uint64)
    for column in parameters.T:
        bits = np.ascontiguousarray(column + 0.0).view(np.uint64)
        hashes = (hashes ^ bits) * HASH_FACTOR
        hashes ^= hashes >> np.uint64(29)
    return hashes


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
            Path(path).absolute(), features, parameters, space, bounds
        )
        return cls(Rows(*columns.read()), columns)

    @classmethod
    @checks.checked(
        "table.",
        parameters=checks.by_name(checks.anything),
        feature_names=checks.optional(checks.each(checks.text)),
        better=checks.optional(checks.word("lower", "higher")),
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
        content = checked_columns(
            parameters, features, feature_names, bounds, space, outcomes, better
        )
        return cls(Rows(*content))

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
        space, raw, *_ = checked_columns(columns, factor)
        return cls(Rows(space, raw, (), np.empty((len(factor), 0)), alike=factor))

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
            assert (
                self._file is not None
            )  # only tables of a file are pickled without content
            rows = Rows(*self._file.read())
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
        """Without the content, where it can be read again."""
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
    names, numbers = (
        rows.feature_names,
        {"row": len(rows), "parameter": len(rows.names)},
    )
    if names or (rows.worlds is None and rows.alike is None):
        numbers["feature"] = len(names)
    if rows.worlds is not None:
        numbers["world"] = len(rows.worlds.names)
    counts = [f"{n} {thing}{'s' * (n != 1)}" for thing, n in numbers.items()]
    if rows.alike is not None:
        counts.append(f"similarity of rank {rows.alike.shape[1]}")
    shown = ", ".join(names[:NAMES_SHOWN]) + (
        ", ..." if len(names) > NAMES_SHOWN else ""
    )
    return f"{', '.join(counts)}{': ' * bool(names)}{shown}"
