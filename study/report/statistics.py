"""Intervals and tests over runs. Runs are the unit: trials of one run are not independent.

Resampling is seeded by the number of runs alone, so that a report made twice is the same report,
and arms with as many runs are resampled alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Floats = NDArray[np.float64]

CONFIDENCE = 0.95
TAIL = 0.5 * (1.0 - CONFIDENCE)
RESAMPLES = 10_000
CURVE_RESAMPLES = 2_000  # of each of a curve's points
RESAMPLING_SEED = 2016


@dataclass(frozen=True)
class Interval:
    """An estimate with the ends of its 95 % confidence interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class PairedTest:
    """Two arms on the same runs.

    Attributes:
        pairs: runs that both have, n.
        unequal: those of them on which the two differ; the test rests on these.
        p: two-sided; 1 where no pair differs.
    """

    pairs: int
    unequal: int
    p: float


def wilson(successes: int, count: int) -> Interval:
    """A proportion with Wilson's score interval; of 0 runs it is unknown (nan, 0, 1)."""
    if count == 0:
        return Interval(float("nan"), 0.0, 1.0)
    z = float(stats.norm.ppf(1.0 - TAIL))
    share = successes / count
    scale = 1.0 + z * z / count
    centre = (share + 0.5 * z * z / count) / scale
    half = z / scale * np.sqrt(share * (1.0 - share) / count + 0.25 * z * z / count**2)
    # At 0 and 1 an end is the proportion itself, but for the last bit.
    return Interval(share, float(min(centre - half, share)), float(max(centre + half, share)))


def median(values: ArrayLike) -> Interval:
    """Median over runs, [r], with its percentile bootstrap interval; infinities are allowed.

    A run without a walker counts as infinite: the median is known as long as half the runs are.
    """
    known = np.asarray(values, dtype=np.float64)
    drawn = known[resamples(len(known), RESAMPLES)]
    # Not interpolated: between a number and infinity there is nothing.
    low, high = np.quantile(np.median(drawn, axis=1), [TAIL, 1.0 - TAIL], method="inverted_cdf")
    return Interval(float(np.median(known)), float(low), float(high))


def mean_curve(values: Floats) -> tuple[Floats, Floats, Floats]:
    """Mean over runs of curves [r, t], and the ends of its bootstrap interval, each [t]."""
    count = len(values)
    drawn = resamples(count, CURVE_RESAMPLES)
    weights = np.apply_along_axis(np.bincount, 1, drawn, minlength=count) / count
    low, high = np.quantile(weights @ values, [TAIL, 1.0 - TAIL], axis=0)
    return values.mean(axis=0), low, high


def median_curve(values: Floats) -> tuple[Floats, Floats, Floats]:
    """Median over runs of curves [r, t], and the ends of its bootstrap interval, each [t]."""
    drawn = resamples(len(values), CURVE_RESAMPLES)
    ends = np.empty((2, values.shape[1]))
    for trial, column in enumerate(values.T):  # trial by trial: the whole would not fit in a cache
        ends[:, trial] = np.quantile(np.median(column[drawn], axis=1), [TAIL, 1.0 - TAIL])
    return np.median(values, axis=0), ends[0], ends[1]


def wilcoxon(ours: ArrayLike, theirs: ArrayLike) -> PairedTest:
    """Signed-rank test of paired values, each [n]; pairs that are equal are left out."""
    difference = np.asarray(ours, dtype=np.float64) - np.asarray(theirs, dtype=np.float64)
    unequal = difference[difference != 0]
    p = float(stats.wilcoxon(unequal).pvalue) if len(unequal) else 1.0
    return PairedTest(len(difference), len(unequal), p)


def mcnemar(ours: ArrayLike, theirs: ArrayLike) -> PairedTest:
    """McNemar's exact test of paired yes and no, each [n]."""
    first, second = np.asarray(ours, dtype=bool), np.asarray(theirs, dtype=bool)
    only_first, only_second = int(np.sum(first & ~second)), int(np.sum(~first & second))
    unequal = only_first + only_second
    p = float(stats.binomtest(only_first, unequal).pvalue) if unequal else 1.0
    return PairedTest(len(first), unequal, p)


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's adjusted p-values, in the order given."""
    count = len(p_values)
    order = np.argsort(p_values, kind="stable")
    factors = count - np.arange(count)
    adjusted = np.minimum(np.maximum.accumulate(np.asarray(p_values)[order] * factors), 1.0)
    result = np.empty(count)
    result[order] = adjusted
    return [float(p) for p in result]


def resamples(count: int, times: int) -> NDArray[np.int64]:
    """Indices of runs drawn with replacement, [times, count]."""
    seed = np.random.SeedSequence(RESAMPLING_SEED, spawn_key=(count,))
    return np.random.default_rng(seed).integers(count, size=(times, count))
