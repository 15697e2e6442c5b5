"""The candidate nearest to any point of a space: how peers that propose anywhere are answered."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray
from optuna.distributions import BaseDistribution, CategoricalDistribution

from study.benchmarks.outside.definition import Settings

Floats = NDArray[np.float64]


class Nearest:
    """Candidates in the unit cube, where distance is Euclidean.

    A number is its place between the ends of its range, on its own scale (logarithmic where its
    distribution is); an integer as well. A choice is a corner of its own: one coordinate a choice,
    of which one is 1. Two choices are therefore sqrt 2 apart, farther than the ends of a range: the
    choice that was asked for is kept unless everything else would have to change.
    """

    def __init__(
        self, space: Mapping[str, BaseDistribution], columns: Mapping[str, ArrayLike]
    ) -> None:
        self._space = dict(space)
        self._points = self._coordinates({name: columns[name] for name in self._space})

    def row(self, settings: Settings) -> int:
        """The nearest candidate's row; of several, the first."""
        point = self._coordinates({name: [settings[name]] for name in self._space})
        return int(np.argmin(((self._points - point) ** 2).sum(axis=1)))

    def _coordinates(self, columns: Mapping[str, ArrayLike]) -> Floats:
        """Columns [n] as points of the cube, [n, coordinates]."""
        return np.column_stack([_cube(self._space[name], columns[name]) for name in self._space])


def _cube(distribution: BaseDistribution, values: ArrayLike) -> Floats:
    """A column [n] as coordinates, [n, 1] or, of a choice, [n, choices]."""
    if isinstance(distribution, CategoricalDistribution):
        return np.asarray(values)[:, None] == np.array(distribution.choices)  # type: ignore[no-any-return]
    numbers = np.asarray(values, dtype=np.float64)
    low, high = float(distribution.low), float(distribution.high)  # type: ignore[attr-defined]
    if distribution.log:  # type: ignore[attr-defined]
        numbers, low, high = np.log(numbers), np.log(low), np.log(high)
    return np.asarray(((numbers - low) / (high - low))[:, None])
