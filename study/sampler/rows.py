"""The content of a table: parameters, features, and what is derived from them."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution

from study.sampler.points import Points
from study.sampler.space import Space, first_not_taken

Floats = NDArray[np.float64]
REMEMBERED = 4096  # rows
# What does not follow from the distributions: rows with others share it.
SHARED = (
    "scale",
    "standard",
    "offered",
    "numbers",
    "features_alone",
    "extent",
    "_complete",
    "_index",
    "_first",
)
HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)  # 2^64 / golden ratio: Knuth's multiplicative hashing


@dataclass(frozen=True)
class Scale:
    """What standardises features: subtract the mean, divide by the spread, [k] each.

    A feature without information has the spread infinity: it becomes zero everywhere.
    """

    mean: Floats
    sd: Floats

    @classmethod
    def of(cls, features: Floats) -> "Scale":
        """The scale of features [n, k], NaN left out."""
        known = np.isfinite(features)
        count = np.maximum(known.sum(axis=0), 1)
        filled = np.where(known, features, 0.0)
        mean = filled.sum(axis=0) / count
        sd = np.sqrt((np.where(known, features - mean, 0.0) ** 2).sum(axis=0) / count)
        return cls(mean, np.where(sd > 1e-12 * np.abs(mean), sd, np.inf))

    def standard(self, features: Floats) -> Floats:
        """Features [n, k] in standard units; NaN becomes the mean, 0."""
        scaled = (features - self.mean) / self.sd
        return np.where(np.isnan(scaled), 0.0, scaled)


@dataclass(frozen=True, eq=False)
class Rows:
    """n candidates.

    Attributes:
        space: the d parameters.
        parameters: [n, d]; of a categorical, the index of its choice.
        feature_names: k names.
        features: [n, k], NaN where unknown.
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
    def scale(self) -> Scale:
        """Mean and spread of each feature over the rows."""
        return Scale.of(self.features)

    @cached_property
    def standard(self) -> Floats:
        """Features in standard units, [n, k]."""
        return self.scale.standard(self.features)

    @cached_property
    def offered(self) -> NDArray[np.bool_]:
        """Rows that may be proposed: all features known, no earlier row with equal parameters."""
        return self._complete & self._first

    @cached_property
    def unit(self) -> Floats:
        """Parameters in the unit cube, [n, e]."""
        return self.space.unit(self.parameters)

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """Of the rows that may be proposed, ascending, [m]."""
        return np.flatnonzero(self.offered)

    @cached_property
    def features_alone(self) -> Points:
        """Rows that may be proposed as points without coordinates."""
        features = self._chosen(self.standard)
        return Points(features, np.empty((len(features), 0)))

    @cached_property
    def features_and_coordinates(self) -> Points:
        """Rows that may be proposed as points."""
        return Points(self.features_alone.features, self._chosen(self.unit))

    @cached_property
    def extent(self) -> tuple[Floats, Floats]:
        """Least and greatest value of each parameter, [d] each."""
        return self.parameters.min(axis=0), self.parameters.max(axis=0)

    @property
    def incomplete(self) -> int:
        """Number of rows with a feature that is not known."""
        return int((~self._complete).sum())

    @property
    def duplicates(self) -> int:
        """Number of rows that repeat the parameters of an earlier one."""
        return int((~self._first).sum())

    @property
    def empty_features(self) -> tuple[str, ...]:
        """Features that are constant or unknown everywhere."""
        flags = zip(self.feature_names, np.isinf(self.scale.sd), strict=True)
        return tuple(name for name, empty in flags if empty)

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
            digest.update(np.ascontiguousarray(values).data)
        return digest.hexdigest()

    def _chosen(self, values: Floats) -> Floats:
        """Those of rows [n, ...] that may be proposed; a copy only where that leaves some out."""
        return values if len(self.numbers) == len(self) else values[self.numbers]

    @cached_property
    def _native(self) -> Callable[[int], dict[str, Any]]:
        """Native values of a row, remembered: those of a study's trials are asked for each time."""
        return lru_cache(REMEMBERED)(lambda row: self.space.values(self.parameters[row]))

    @cached_property
    def _outside(self) -> Callable[[int, BaseDistribution], int | None]:
        """Remembered: each trial of a study is asked about, and all suggest the same."""

        def first(column: int, suggested: BaseDistribution) -> int | None:
            own = self.space.distributions[column]
            return first_not_taken(own, self.parameters[:, column], suggested)

        return lru_cache(REMEMBERED)(first)

    @cached_property
    def _complete(self) -> NDArray[np.bool_]:
        """Rows whose informative features are all finite, [n]."""
        informed = self.features[:, np.isfinite(self.scale.sd)]
        return np.asarray(np.isfinite(informed).all(axis=1))

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
    for column in (parameters + 0.0).T:
        bits = np.ascontiguousarray(column).view(np.uint64)
        hashes = (hashes ^ bits) * HASH_FACTOR
        hashes ^= hashes >> np.uint64(29)
    return hashes
