"""Candidates, trials and costs as a Gaussian process takes them."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from math import sqrt
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from study.sampler.arrays import Floats, Whole

LARGEST = float(np.finfo(np.float64).max)
QUARTERS = -LARGEST / 4, LARGEST / 4  # so that excess, and two of them, are finite
MOST = 2.0**500
INFINITE = 1e6  # times the usual size of a limit: what is larger stands for infinity
USUAL_EXPONENT = 20  # of 2: limits from 1e-6 to 1e6 stay as they are, to the bit
# Share of missing values from which having none is a feature of its own.
LEAST_GAPS = 0.02
NOTHING: Floats = np.empty(0)


@dataclass(frozen=True)
class Columns:
    """Which columns of points are what, from left to right: see `Points.matrix`.

    Attributes:
        features: of the candidates themselves.
        successes: what each world adds to the next, of rows that succeed in it; empty
            where nothing tells successes from failures.
        mean_of_successes: the mean cost in the worlds where a row succeeds.
        worlds: what each world adds to the mean over the worlds, or the factor of a
            similarity; without either, this and the next three are empty.
        one: a one in each row, whose multiple is the shift.
        mean: the mean over the worlds; 0 where only a similarity is known.
        gap: how far a point is from the rows that tell what worlds cost there: 0 at a
            row, 1 far from all.
        coordinates: of the parameters in the unit cube.
    """

    features: range
    successes: range
    mean_of_successes: range
    worlds: range
    one: range
    mean: range
    gap: range
    coordinates: range

    @property
    def of_successes(self) -> "Columns":
        """The same, with what successes cost in the place of all costs."""
        return replace(self, worlds=self.successes, mean=self.mean_of_successes)


def new_columns(
    features: int,
    coordinates: int,
    worlds: int | None = None,
    *,
    has_successes: bool = False,
) -> Columns:
    """The columns that follow from these counts; worlds None: nothing is known of any."""
    beside = (0, 0, 0, 0) if worlds is None else (worlds, 1, 1, 1)
    of_successes = beside[:2] if has_successes else (0, 0)
    counts = (features, *of_successes, *beside, coordinates)
    ends = accumulate(counts)
    parts = zip(ends, counts, strict=True)
    return Columns(*(range(end - count, end) for end, count in parts))


@dataclass(frozen=True, eq=False)
class Points:
    """m candidates or trials.

    Attributes:
        matrix: features in standard units, and then coordinates of the parameters in
            the unit cube, [m, k + e]; k and e may be 0. The last features are those of
            an ensemble or a similarity, where there is one (`Columns`).
        width: k, the number of features.
    """

    matrix: Floats
    width: int

    @classmethod
    def of(cls, features: Floats, coordinates: Floats) -> "Points":
        """Points with these features [m, k] and coordinates [m, e]."""
        matrix = features
        if coordinates.shape[1]:
            matrix = np.hstack([features, coordinates])
        return cls(matrix, features.shape[1])

    def __len__(self) -> int:
        """Number of points, m."""
        return len(self.matrix)

    @property
    def features(self) -> Floats:
        """The features, [m, k], a view."""
        return self.matrix[:, : self.width]

    @property
    def coordinates(self) -> Floats:
        """The coordinates, [m, e], a view."""
        return self.matrix[:, self.width :]

    @cached_property
    def single(self) -> NDArray[np.float32]:
        """The features in 32 bits, for an order of many; made once."""
        return self.features.astype(np.float32)

    @cached_property
    def kept(self) -> dict[bytes, Any]:
        """What was computed of them, for whoever asks again."""
        return {}

    @cached_property
    def distinct(self) -> tuple[Floats, Whole]:
        """The values of a single feature, ascending, and the place of each row among them, [m]."""
        values, place = np.unique(self.features[:, 0], return_inverse=True)
        return values, place

    def take(self, index: NDArray[Any]) -> "Points":
        """Some of them, by number or by mask."""
        return Points(self.matrix[index], self.width)

    def followed_by(self, others: "Points") -> "Points":
        """These, and then the others."""
        return Points(np.vstack([self.matrix, others.matrix]), self.width)


def log_excess(values: Floats, cost: Floats) -> Floats:
    """log(1 + (value - least) / typical) of values [m], by costs [n], typical the median excess.

    Costs of any sign and unit, in the same order; far above the least, their logarithm:
    a cliff does not hide what is at its foot. Costs beyond a quarter of the largest
    float count as that. Below the least, what is as far below is minus what is above.
    """
    cost = np.clip(cost, *QUARTERS)
    with np.errstate(over="ignore"):
        ratio = (np.clip(values, *QUARTERS) - cost.min()) / typical_excess(cost)
    return np.asarray(np.copysign(np.log1p(np.minimum(np.abs(ratio), LARGEST)), ratio))


def of_log_excess(y: Floats, cost: Floats) -> Floats:
    """The costs [m] whose `log_excess` among the costs [n] is y [m]."""
    cost = np.clip(cost, *QUARTERS)
    with np.errstate(over="ignore"):
        above = np.copysign(np.expm1(np.abs(y)), y)
        return np.asarray(cost.min() + typical_excess(cost) * above)


def typical_excess(cost: Floats) -> float:
    """The median of what costs [n] are above the least; 1 if they are equal."""
    excess = cost - cost.min()
    above = excess[excess > 0]
    return float(np.median(above)) if len(above) else 1.0


def squarable(values: Floats) -> Floats:
    """The values, those beyond +-`MOST` replaced by it: of a million others, squares can be summed.

    NaN and what is smaller stay as they are, to the bit.
    """
    return np.clip(values, -MOST, MOST)


def stand_ins(values: Floats, known: Floats = NOTHING) -> tuple[float, float]:
    """The numbers for minus infinity and for infinity among values: beyond all that are finite.

    They are as far beyond as the finite values reach: no infinity becomes as good as a
    number.

    Args:
        values: of any shape; NaN is no value.
        known: others that infinity is beyond, too, such as the value of a success.
    """
    every = np.append(values, known)
    finite = every[np.isfinite(every)]
    if not len(finite):
        return -1.0, 1.0
    low, high = np.clip([finite.min(), finite.max()], *QUARTERS).tolist()
    size = max(abs(low), abs(high))
    reach = high - low
    if reach <= 1e-9 * size:  # of equal values nothing is known but their size
        reach = size or 1.0
    return low - reach, high + reach


def without_infinities(values: Floats, ends: tuple[float, float] | Floats) -> Floats:
    """The values, those that are infinite replaced by two `stand_ins`."""
    low, high = ends
    return np.where(values == np.inf, high, np.where(values == -np.inf, low, values))


def clip_infinities(values: Floats) -> Floats:
    """Infinite values replaced by the largest and the smallest finite one (zero if none is).

    Digests of tables of version 0.3.0 are of values like these. They decide nothing
    else: what is infinitely bad must not be as good as the worst number.
    """
    finite = values[np.isfinite(values)]
    ends = (finite.min(), finite.max()) if len(finite) else (0.0, 0.0)
    return without_infinities(values, ends)


def by_side(limit: Floats) -> Floats:
    """What n trials told of one limit, as a process takes it, [n]: above 0 broken, else kept.

    NaN, a trial that told nothing, stays. The side stays always; the size may not:

    - infinity, and what stands for it (more than `INFINITE` of the usual size on either
      side), becomes as large as the largest of its side or, if there is none, of the
      other;
    - where none is below 0, as of max(0, excess), 0 becomes as far below as the others
      are above;
    - very small or large numbers are scaled, so that squares of them have a size.
    """
    found = squarable(limit)
    size = np.abs(found)
    sides = limit > 0.0, limit < 0.0
    usual = [size[side & np.isfinite(limit)] for side in sides]
    unit = min((float(np.median(some)) for some in usual if len(some)), default=1.0)
    is_usual = size <= INFINITE * unit
    most = max(size[is_usual], default=0.0) or 1.0
    for side, sign in zip(sides, (1.0, -1.0), strict=True):
        largest = max(size[side & is_usual], default=most)
        found[side & ~is_usual] = sign * largest
    if not sides[1].any():
        above = found[found > 0.0]
        found[limit == 0.0] = -float(np.median(above)) if len(above) else -1.0
    exponent = np.frexp(np.max(np.abs(found), initial=0.0, where=~np.isnan(found)))[1]
    if abs(exponent) > USUAL_EXPONENT:
        found = np.ldexp(found, 1 - exponent)
        found[sides[0]] = np.maximum(found[sides[0]], np.finfo(np.float64).tiny)
    return found


@dataclass(frozen=True)
class Standard:
    """Subtract the mean, divide by the spread, [k] each; infinity is beyond all finite values.

    A feature without information has the spread infinity: it becomes zero everywhere.

    Attributes:
        mean: of the known values, in the unit of the feature, [k].
        sd: their standard deviation, [k]; infinite where a feature has one value only.
        ends: what stands for minus infinity and for infinity, [k, 2].
    """

    mean: Floats
    sd: Floats
    ends: Floats

    @classmethod
    def of(cls, features: Floats) -> "Standard":
        """The scale of features [n, k]."""
        ends = np.array([stand_ins(column) for column in features.T]).reshape(-1, 2)
        known, features = ~np.isnan(features), _finite(features, ends)
        count = np.maximum(known.sum(axis=0), 1)
        filled = np.where(known, features, 0.0)
        mean = filled.sum(axis=0) / count
        sd = np.sqrt((np.where(known, filled - mean, 0.0) ** 2).sum(axis=0) / count)
        return cls(mean, np.where(sd > 1e-12 * np.abs(mean), sd, np.inf), ends)

    def standard(self, features: Floats) -> Floats:
        """Features [m, k] as columns of about unit variance, [m, k]; a gap becomes 0."""
        finite = _finite(features, self.ends)
        return np.asarray(
            (np.where(np.isnan(finite), self.mean, finite) - self.mean) / self.sd
        )


def _finite(features: Floats, ends: Floats) -> Floats:
    """Features [n, k], infinite ones replaced by the ends [k, 2] of their columns; NaN stays."""
    return squarable(without_infinities(features, ends.T))


@dataclass(frozen=True, eq=False)
class NormalScores:
    """Phi^-1 of the share of rows below (Blom 1958), equal values sharing theirs, unit variance.

    Only the order of values counts: heavy tails, infinities and units do not matter. A
    feature that some rows lack has a column more: whether a row has it. Those follow
    the k columns of scores, in the order of the features, each pattern of gaps once.

    Attributes:
        known: values of each of the k features in ascending order, without gaps.
        sd: of each column of scores, [k]; infinite where it has one value only.
        gaps: features whose gaps are a column, by number, each with its share of gaps.
        own: the columns of the rows themselves, in standard units, [n, k + gaps].
    """

    known: tuple[Floats, ...]
    sd: Floats
    gaps: tuple[tuple[int, float], ...]
    own: Floats

    @classmethod
    def of(cls, features: Floats) -> "NormalScores":
        """The scores among rows [n, k]; infinities are the extreme values."""
        n = len(features)
        untied = _at_ranks(np.arange(1.0, n + 1.0), n)
        known, own = list[Floats](), list[Floats]()
        sds: list[float] = []
        gaps: dict[bytes, tuple[int, float]] = {}
        for place, column in enumerate(features.T):
            missing = np.isnan(column)
            order = np.argsort(column)[: n - int(missing.sum())]  # gaps come last
            values = column[order]
            varies = len(values) > 0 and values[0] != values[-1]
            scores = _of_ascending(values, untied) if varies else np.zeros(len(values))
            sd = float(scores.std()) if varies else np.inf
            standard = np.zeros(n)
            standard[order] = scores / sd
            share = float(missing.mean()) if n else 0.0
            if LEAST_GAPS < share < 1.0 - LEAST_GAPS:
                gaps.setdefault(missing.tobytes(), (place, share))
            known.append(values)
            sds.append(sd)
            own.append(standard)
        found = tuple(gaps.values())
        columns = np.column_stack(
            [features[:, :0], *own, *_gap_columns(features, found)]
        )
        return cls(tuple(known), np.array(sds), found, columns)

    def standard(self, features: Floats) -> Floats:
        """Scores by the order alone, also of values that no row had, [m, k + gaps]; a gap is 0."""
        columns = [
            np.where(np.isnan(column), 0.0, _scores(values, column) / sd)
            for column, values, sd in zip(features.T, self.known, self.sd, strict=True)
        ]
        gaps = _gap_columns(features, self.gaps)
        return np.column_stack([features[:, :0], *columns, *gaps])


Scale = Standard | NormalScores


def _gap_columns(
    features: Floats, gaps: Iterable[tuple[int, float]]
) -> Iterator[Floats]:
    """A column for each pattern of gaps: which rows [m, k] have them, in standard units, [m]."""
    for column, share in gaps:
        missing = np.isnan(features[:, column])
        yield (missing - share) / sqrt(share * (1.0 - share))


def _at_ranks(rank: Floats, n: int) -> Floats:
    """Phi^-1((rank - 3/8) / (n + 1/4))."""
    return np.asarray(scipy.special.ndtri((rank - 0.375) / (n + 0.25)))


def _of_ascending(values: Floats, untied: Floats) -> Floats:
    """Scores of ascending values among themselves; `untied`: those of all rows if none are tied."""
    first = np.flatnonzero(np.append(True, values[1:] != values[:-1]))  # of equal ones
    if len(first) == len(untied):
        return untied
    end = np.append(first[1:], len(values))
    return np.repeat(_at_ranks(0.5 * (first + end + 1.0), len(values)), end - first)


def _scores(known: Floats, values: Floats) -> Floats:
    """Scores of values [m] among known ones [n], ascending."""
    if not len(known):
        return np.zeros(len(values))
    below = np.searchsorted(known, values, side="left")
    rank = below + np.searchsorted(known, values, side="right")
    return _at_ranks(np.clip(0.5 * (rank + 1.0), 1.0, len(known)), len(known))


def two_groups(values: Floats) -> tuple[float, float]:
    """Where m values fall apart, and how far: a share of their variance (Otsu 1979, eq. 14).

    It is the middle between two neighbours of which the variance within those below and
    within those above is least. The share that this explains is 0.75 of values that are
    spread evenly, 0.64 of normal ones, and 1 of two values. It is 0 of equal ones.
    """
    ordered = np.sort(values)
    if ordered[0] == ordered[-1]:
        return float(ordered[0]), 0.0
    total = float(((ordered - ordered.mean()) ** 2).sum())
    below, sums = np.arange(1, len(ordered)), ordered.cumsum()
    above = len(ordered) - below
    apart = sums[:-1] / below - (sums[-1] - sums[:-1]) / above
    explained = below * above / len(ordered) * apart**2
    last = int(explained.argmax())
    middle = 0.5 * float(ordered[last] + ordered[last + 1])
    return middle, float(explained[last]) / total
