"""Candidates as a Gaussian process sees them: features and unit-cube coordinates side by side."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from study.sampler.large import let_go, rows_of, side_by_side

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Points:
    """m candidates.

    Attributes:
        features: in standard units, [m, k]; k may be 0.
        coordinates: in the unit cube, [m, e]; e may be 0.
    """

    features: Floats
    coordinates: Floats

    def __len__(self) -> int:
        """Number of candidates, m."""
        return len(self.features)

    def matrix(self, block: slice = slice(None)) -> Floats:
        """All or some of them, [m, k + e]."""
        let_go(self._stacked)  # of a large table what was read before
        return self._stacked[block]

    @cached_property
    def _stacked(self) -> Floats:
        """All of them, made once."""
        if not self.coordinates.shape[1]:
            return self.features
        return side_by_side(self.features, self.coordinates)

    @cached_property
    def distinct(self) -> tuple[Floats, NDArray[np.int64]]:
        """Of a single feature: its values in ascending order, and the place of each row, [m]."""
        values, place = np.unique(self.features[:, 0], return_inverse=True)
        return values, place

    def take(self, index: NDArray[Any]) -> "Points":
        """Some of them, by number or by mask."""
        return Points(self.features[index], rows_of(self.coordinates, index))

    def only(self, *, features: bool, coordinates: bool) -> "Points":
        """With the columns that a kernel looks at."""
        if (features or not self.features.size) and (coordinates or not self.coordinates.size):
            return self
        return Points(
            self.features if features else self.features[:, :0],
            self.coordinates if coordinates else self.coordinates[:, :0],
        )
