"""Intervals and tests over runs. Runs are the unit: trials of one run are not independent.

Resampling is seeded by the number of runs alone, so that a report made twice is the same report,
and arms with as many runs are resampled alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Curve = tuple[Floats, Floats, Floats]  # its points and the ends of their intervals, each [t]
Statistic = Callable[..., Floats]  # np.mean or np.median

CONFIDENCE = 0.95
ENDS = (0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE))  # as quantiles
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


@cache
def wilson(successes: int, count: int) -> Interval:
    """A proportion with Wilson's score interval; of 0 runs it is unknown (nan, 0, 1)."""
    if count == 0:
        return Interval(float("nan"), 0.0, 1.0)
    test = scipy.stats.binomtest(successes, count)
    ends = test.proportion_ci(confidence_level=CONFIDENCE, method="wilson")
    return Interval(successes / count, float(ends.low), float(ends.high))


def median(values: ArrayLike) -> Interval:
    """Median over runs, [r], with its percentile bootstrap interval; infinities are allowed.

    A run without a walker counts as infinite: the median is known as long as half the runs are.
    """
    known = np.asarray(values, dtype=np.float64)
    # Not interpolated: between a number and infinity there is nothing.
    low, high = _bootstrap(known, np.median, RESAMPLES, "inverted_cdf")
    return Interval(float(np.median(known)), low, high)


def curve(values: Floats, statistic: Statistic) -> Curve:
    """Mean or median over runs of curves [r, t], with the bootstrap interval of each point."""
    ends = [_bootstrap(runs, statistic, CURVE_RESAMPLES) for runs in values.T]
    low, high = np.array(ends).T
    return statistic(values, axis=0), low, high


def _bootstrap(
    values: Floats,
    statistic: Statistic,
    times: int,
    method: Literal["linear", "inverted_cdf"] = "linear",
) -> tuple[float, float]:
    """Ends of the percentile interval of a statistic over runs, [r]."""
    drawn = statistic(values[resamples(len(values), times)], axis=1)
    low, high = np.quantile(drawn, ENDS, method=method)
    return float(low), float(high)


@cache
def resamples(count: int, times: int) -> NDArray[np.int64]:
    """Indices of runs drawn with replacement, [times, count]; not to be written to."""
    seed = np.random.SeedSequence(RESAMPLING_SEED, spawn_key=(count,))
    return np.random.default_rng(seed).integers(count, size=(times, count))


def wilcoxon(ours: ArrayLike, theirs: ArrayLike) -> PairedTest:
    """Signed-rank test of paired values, each [n]; pairs that are equal are left out."""
    difference = np.asarray(ours, dtype=np.float64) - np.asarray(theirs, dtype=np.float64)
    unequal = difference[difference != 0]
    p = float(scipy.stats.wilcoxon(unequal).pvalue) if len(unequal) else 1.0
    return PairedTest(len(difference), len(unequal), p)


def mcnemar(ours: ArrayLike, theirs: ArrayLike) -> PairedTest:
    """McNemar's exact test of paired yes and no, each [n]."""
    first, second = np.asarray(ours, dtype=bool), np.asarray(theirs, dtype=bool)
    only_first, only_second = int(np.sum(first & ~second)), int(np.sum(~first & second))
    unequal = only_first + only_second
    p = float(scipy.stats.binomtest(only_first, unequal).pvalue) if unequal else 1.0
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
