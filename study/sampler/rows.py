"""The content of a table: parameters, features, and what is derived from them."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution

from study.sampler.points import BLOCK, Points, by_blocks, columns_of, let_go
from study.sampler.space import Space, first_not_taken
from study.sampler.transforms import NormalScores, Scale, Standard

Floats = NDArray[np.float64]
REMEMBERED = 4096  # rows
# What does not follow from the distributions: rows with others share it.
SHARED = (
    "standard",
    "scores",
    "offered",
    "numbers",
    "extent",
    "_known",
    "_index",
    "_first",
)
HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)  # 2^64 / golden ratio: Knuth's multiplicative hashing


@dataclass(frozen=True, eq=False)
class Rows:
    """n candidates.

    Attributes:
        space: the d parameters.
        parameters: [n, d]; of a categorical, the index of its choice.
        feature_names: k names.
        features: [n, k], of any scale; NaN where unknown.
    """

    space: Space
    parameters: Floats
    feature_names: tuple[str, ...]
    features: Floats

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
        """One of the two."""
        return self.scores if by_order else self.standard

    @cached_property
    def offered(self) -> NDArray[np.bool_]:
        """Rows that may be proposed: half of the features known, parameters of no earlier row."""
        return self._known & self._first

    @cached_property
    def unit(self) -> Floats:
        """Parameters in the unit cube, [n, e]."""
        return by_blocks(self.space.unit, self.parameters)

    @cached_property
    def chosen_unit(self) -> Floats:
        """The same of rows that may be proposed, [m, e]."""
        return self._chosen(self.unit)

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """Of the rows that may be proposed, ascending, [m]."""
        return np.flatnonzero(self.offered)

    def points(self, *, by_order: bool, coordinates: bool) -> Points:
        """Rows that may be proposed as points, on one of the scales; made once."""
        key = (by_order, coordinates)
        if key not in self._points:
            if coordinates:
                features = self.points(by_order=by_order, coordinates=False).features
                self._points[key] = Points(features, self.chosen_unit)
            else:
                features = self.scale(by_order=by_order).standard(self._chosen(self.features))
                self._points[key] = Points(features, np.empty((len(features), 0)))
        return self._points[key]

    @cached_property
    def extent(self) -> tuple[Floats, Floats]:
        """Least and greatest value of each parameter, [d] each."""
        ends = [(column.min(), column.max()) for column in columns_of(self.parameters)]
        least, greatest = np.array(ends).T
        return least, greatest

    @property
    def incomplete(self) -> int:
        """Number of rows that lack more than half of the features."""
        return int((~self._known).sum())

    @property
    def duplicates(self) -> int:
        """Number of rows that repeat the parameters of an earlier one."""
        return int((~self._first).sum())

    @property
    def empty_features(self) -> tuple[str, ...]:
        """Features that are constant or unknown everywhere."""
        flags = zip(self.feature_names, self._informative, strict=True)
        return tuple(name for name, informative in flags if not informative)

    def as_parameters(self, row: int) -> dict[str, Any]:
        """One row as Optuna wants it: native values by name."""
        return dict(self._native(row))

    def find(self, values: Mapping[str, Any]) -> int | None:
        """The first row with exactly these values; None where there is none."""
        wanted = self.space.row(values)
        if wanted is None:
            return None
        key, (sorted_hash, order) = _hash(wanted[None])[0], self._index
        place = int(np.searchsorted(sorted_hash, key))
        if place == len(order) or sorted_hash[place] != key:
            return None
        row = int(order[place])
        return row if bool((self.parameters[row] == wanted).all()) else None

    def having(self, values: Mapping[str, Any]) -> NDArray[np.bool_]:
        """Which rows have exactly these values of some parameters, [n]."""
        have = np.ones(len(self), dtype=bool)
        for column, name in enumerate(self.names):
            if name in values:
                number = self.space.number(column, values[name])
                have &= self.parameters[:, column] == (np.nan if number is None else number)
        return have

    def outside(self, column: int, suggested: BaseDistribution) -> int | None:
        """The first row whose value of one parameter a distribution has not; None: it has all."""
        return self._outside(column, suggested)

    def with_space(self, space: Space) -> "Rows":
        """The same rows with other distributions of the same values."""
        rows = Rows(space, self.parameters, self.feature_names, self.features)
        known = self.__dict__
        rows.__dict__.update({name: known[name] for name in SHARED if name in known})
        return rows

    def digest(self) -> str:
        """SHA-256 of names, distributions, parameters and features."""
        head = [*self.names, *map(str, self.space.distributions), *self.feature_names]
        digest = hashlib.sha256("\n".join(head).encode())
        for values in (self.parameters, self.features):
            for first in range(0, len(self), BLOCK):
                digest.update(np.ascontiguousarray(values[first : first + BLOCK]).data)
                let_go(values)
        return digest.hexdigest()

    def _chosen(self, values: Floats) -> Floats:
        """Those of rows [n, ...] that may be proposed; a copy only where that leaves some out."""
        return values if len(self.numbers) == len(self) else values[self.numbers]

    @cached_property
    def _native(self) -> Callable[[int], dict[str, Any]]:
        """Native values of a row, remembered: those of a study's trials are asked for each time."""

        def values(row: int) -> dict[str, Any]:
            found = self.space.values(self.parameters[row])
            let_go(self.parameters)
            return found

        return lru_cache(REMEMBERED)(values)

    @cached_property
    def _outside(self) -> Callable[[int, BaseDistribution], int | None]:
        """Remembered: each trial of a study is asked about, and all suggest the same."""

        def first(column: int, suggested: BaseDistribution) -> int | None:
            own = self.space.distributions[column]
            found = first_not_taken(own, self.parameters[:, column], suggested)
            let_go(self.parameters)
            return found

        return lru_cache(REMEMBERED)(first)

    @cached_property
    def _known(self) -> NDArray[np.bool_]:
        """Rows with at least half of the informative features, [n]."""
        informed = self.features[:, self._informative]
        return np.asarray(2 * np.isnan(informed).sum(axis=1) <= informed.shape[1])

    @cached_property
    def _informative(self) -> NDArray[np.bool_]:
        """Features that have more than one value, [k]."""
        least = np.where(np.isnan(self.features), np.inf, self.features).min(axis=0)
        most = np.where(np.isnan(self.features), -np.inf, self.features).max(axis=0)
        return np.asarray(least < most)

    @cached_property
    def _points(self) -> dict[tuple[bool, bool], Points]:
        """What `points` has made."""
        return {}

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


def _hash(parameters: Floats) -> NDArray[np.uint64]:
    """64 bits a row: equal rows have equal ones, and others, in practice, different ones."""
    hashes = np.zeros(len(parameters), dtype=np.uint64)
    for column in columns_of(parameters):
        bits = np.ascontiguousarray(column + 0.0).view(np.uint64)
        hashes = (hashes ^ bits) * HASH_FACTOR
        hashes ^= hashes >> np.uint64(29)
    return hashes
