"""Features of any kind on scales that a Gaussian process can use.

`NormalScores` takes nothing from a feature but the order of its values: heavy tails, infinities,
and units do not matter. `Standard` is affine, as the paper has it.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import sqrt

import numpy as np
import scipy
from numpy.typing import NDArray

from study.sampler.transforms import squarable

Floats = NDArray[np.float64]

LEAST_GAPS = 0.02  # share of missing values from which having none is a feature of its own


class Scale(ABC):
    """What makes features [m, k] columns in standard units, learned from n rows."""

    @abstractmethod
    def standard(self, features: Floats) -> Floats:
        """Features [m, k] as columns of about unit variance, [m, k or more]; a gap becomes 0."""

    @property
    @abstractmethod
    def owners(self) -> tuple[int, ...]:
        """Of each of these columns, the number of the feature that it comes from."""


@dataclass(frozen=True)
class Standard(Scale):
    """Subtract the mean, divide by the spread, [k] each; infinite values count as gaps.

    A feature without information has the spread infinity: it becomes zero everywhere.
    """

    mean: Floats
    sd: Floats

    @classmethod
    def of(cls, features: Floats) -> "Standard":
        """The scale of features [n, k]."""
        known, features = np.isfinite(features), squarable(features)
        count = np.maximum(known.sum(axis=0), 1)
        filled = np.where(known, features, 0.0)
        mean = filled.sum(axis=0) / count
        sd = np.sqrt((np.where(known, filled - mean, 0.0) ** 2).sum(axis=0) / count)
        return cls(mean, np.where(sd > 1e-12 * np.abs(mean), sd, np.inf))

    def standard(self, features: Floats) -> Floats:
        """Affine; [m, k]."""
        finite = np.where(np.isfinite(features), squarable(features), self.mean)
        scaled = (finite - self.mean) / self.sd
        return np.asarray(scaled)

    @property
    def owners(self) -> tuple[int, ...]:
        """A column a feature."""
        return tuple(range(len(self.mean)))


@dataclass(frozen=True, eq=False)
class NormalScores(Scale):
    """Phi^-1 of the share of rows below (Blom 1958), equal values sharing theirs, unit variance.

    A feature that some rows lack has a column more: whether a row has it. Those follow the k
    columns of scores, in the order of the features, each pattern of gaps once.

    Attributes:
        known: values of each feature in ascending order, k of them, without gaps.
        sd: of each column of scores, [k]; infinite where it has one value only.
        gaps: features whose gaps are a column, and the share of rows that has them.
    """

    known: tuple[Floats, ...]
    sd: Floats
    gaps: tuple[tuple[int, float], ...]

    @classmethod
    def of(cls, features: Floats) -> "NormalScores":
        """The scores among rows [n, k]; infinities are the extreme values."""
        missing = np.isnan(features)
        known = tuple(
            np.sort(column[~gap]) for column, gap in zip(features.T, missing.T, strict=True)
        )
        sd = np.array([_spread(values) for values in known])
        gaps: dict[bytes, tuple[int, float]] = {}
        for column, gap in enumerate(missing.T):
            share = float(gap.mean()) if len(gap) else 0.0
            if LEAST_GAPS < share < 1.0 - LEAST_GAPS:
                gaps.setdefault(gap.tobytes(), (column, share))
        return cls(known, sd, tuple(gaps.values()))

    def standard(self, features: Floats) -> Floats:
        """By the order alone, also of values that no row had; [m, k + gaps]."""
        columns = [
            np.where(np.isnan(column), 0.0, _scores(values, column) / sd)
            for column, values, sd in zip(features.T, self.known, self.sd, strict=True)
        ]
        for column, share in self.gaps:
            missing = np.isnan(features[:, column])
            columns.append((missing - share) / sqrt(share * (1.0 - share)))
        return np.column_stack(columns)

    @property
    def owners(self) -> tuple[int, ...]:
        """A column a feature, then those of the gaps."""
        return (*range(len(self.known)), *(column for column, _ in self.gaps))


def _scores(known: Floats, values: Floats) -> Floats:
    """Phi^-1((rank - 3/8) / (n + 1/4)) of values [m] among known ones [n], ascending."""
    if not len(known):
        return np.zeros(len(values))
    order = np.argsort(values)  # neighbours are looked up one after the other: five times as fast
    ascending = values[order]
    rank = np.empty(len(values))
    rank[order] = np.searchsorted(known, ascending, side="left")
    rank[order] += np.searchsorted(known, ascending, side="right")
    rank = np.clip(0.5 * (rank + 1.0), 1.0, len(known))
    return np.asarray(scipy.special.ndtri((rank - 0.375) / (len(known) + 0.25)))


def _spread(known: Floats) -> float:
    """Standard deviation of the scores of ascending values; infinite where all are equal."""
    if not len(known) or known[0] == known[-1]:
        return np.inf
    return float(_scores(known, known).std())
