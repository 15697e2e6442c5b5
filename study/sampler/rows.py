"""The content of a table: n rows of parameters, what is known of each, and what follows."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution

from study.sampler.arrays import Floats, Mask, Whole
from study.sampler.between import Between
from study.sampler.goals import Goals
from study.sampler.similarity import Alike, Relation
from study.sampler.space import Number, Space, first_not_taken, standing_for
from study.sampler.transforms import NormalScores, Points, Scale, Standard
from study.sampler.worlds import Ensemble, Worlds

T = TypeVar("T")
BLOCK = 2**13  # rows at a time, to stay in the cache
# 2^64 / golden ratio: Knuth's multiplicative hashing.
HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)


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
        limits: in which worlds each row breaks a limit, by its name: costs of 1, or 0.
            They change no proposal but where a sampler is allowed a risk, and are no
            part of the digest.
    """

    space: Space
    parameters: Floats
    feature_names: tuple[str, ...]
    features: Floats
    worlds: Worlds | None = None
    alike: Floats | None = None
    limits: Mapping[str, Worlds] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of rows, n."""
        return len(self.parameters)

    def __getstate__(self) -> dict[str, Any]:
        """The state without what is derived from the columns."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

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
    def offered(self) -> Mask:
        """Rows that may be proposed: half of the features known, parameters of no earlier row."""
        return self._known & self._first

    @cached_property
    def unit(self) -> Floats:
        """Rows that may be proposed in the unit cube, [m, e]."""
        chosen = self._chosen(self.parameters)
        starts = range(0, max(len(chosen), 1), BLOCK)
        blocks = [self.space.unit(chosen[start : start + BLOCK]) for start in starts]
        return np.vstack(blocks)

    @cached_property
    def numbers(self) -> Whole:
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
            parts = [features] if ensemble is None else [features, ensemble.columns]
            width = sum(part.shape[1] for part in parts)
            if coordinates:
                parts.append(self.unit)
            # One copy at most: they may be millions of numbers.
            matrix = np.hstack(parts) if len(parts) > 1 else features
            return Points(matrix, width)

        return once(ensemble or self, (by_order, coordinates), made)

    def ensemble(self, signs: Floats, goals: Goals | None = None) -> Relation:
        """Worlds, or likeness, as the model takes them, of rows that may be proposed.

        `signs` are -1 where values are maximised, [k]. Made once, unless `goals` make
        one of k.
        """
        worlds, alike = self.worlds, self.alike
        if alike is not None:
            return once(self, "alike", lambda: Alike(self._chosen(alike)))
        assert worlds is not None
        costs = partial(worlds.of_rows, self.numbers, signs, goals)
        as_costs = partial(worlds.of_outcomes, signs=signs, goals=goals)
        if goals is not None:
            return Ensemble(worlds, costs(), as_costs=as_costs)
        return once(
            self,
            ("ensemble", *signs),
            lambda: Ensemble(worlds, costs(), self.unit, as_costs),
        )

    def between(self, ensemble: Relation | None = None) -> Between:
        """What rows that may be proposed tell of points between them; made once.

        Beside worlds by kriging, if they are smooth.
        """

        def made() -> Between:
            if not isinstance(ensemble, Ensemble):
                return Between(self.unit)
            beside = ensemble.columns.shape[1]
            error = ensemble.guess_error
            return Between(self.unit, ensemble.guess, beside=beside, error=error)

        return once(ensemble or self, "between", made)

    def between_at(
        self, points: Points, place: Floats, ensemble: Relation | None
    ) -> Floats:
        """The features of rows that may be proposed, as points, at a place [e]: [k]; kept."""

        def made() -> Floats:
            between = self.between(ensemble)
            found = between.at(points.features, place[None], place[None])
            return np.asarray(found[0])

        return once(points, place.tobytes(), made)

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

    def having(self, values: Mapping[str, Any]) -> Mask:
        """Which rows these values of some parameters stand for, [n]: of several the nearest."""
        have, farthest = np.ones(len(self), dtype=bool), np.zeros(len(self))
        distributions = self.space.distributions
        for column, name in enumerate(self.names):
            if name not in values:
                continue
            number = self.space.number(column, values[name])
            distribution = distributions[column]
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
        return None if suggested == own else once(self, (column, suggested), made)

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
    def _known(self) -> Mask:
        """Rows with at least half of the informative features, and of the worlds, [n]."""
        informed = self.features[:, self._informative]
        known = np.asarray(2 * np.isnan(informed).sum(axis=1) <= informed.shape[1])
        return known if self.worlds is None else known & self.worlds.known

    @cached_property
    def _informative(self) -> Mask:
        """Features that have more than one value, [k]."""
        least = np.where(np.isnan(self.features), np.inf, self.features).min(axis=0)
        most = np.where(np.isnan(self.features), -np.inf, self.features).max(axis=0)
        return np.asarray(least < most)

    @cached_property
    def _index(self) -> tuple[NDArray[np.uint64], Whole]:
        """Hashes in ascending order, and the row of each; equal ones by row."""
        hashes = _hash(self.parameters)
        order = np.argsort(hashes, kind="stable")
        return hashes[order], order

    @cached_property
    def _first(self) -> Mask:
        """Rows that repeat no earlier row's parameters, [n]."""
        hashes, order = self._index
        first = np.ones(len(self), dtype=bool)
        first[order[1:]] = hashes[1:] != hashes[:-1]
        return first


def once(owner: Rows | Points | Relation, key: Any, made: Callable[[], T]) -> T:
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
