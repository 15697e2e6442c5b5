"""Simple regret of many runs: what an arm had reached, and how sure that is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RESAMPLES = 4000
CONFIDENCE = 0.95
BOOTSTRAP_SEED = 16


@dataclass(frozen=True)
class Summary:
    """A statistic over seeds, with the ends of its bootstrap confidence interval."""

    value: float
    low: float
    high: float


def simple_regret(costs: Floats) -> Floats:
    """Least cost so far, less the least possible cost of 0: [seeds, trials] -> the same."""
    return np.asarray(np.minimum.accumulate(costs, axis=-1))


def mean_of(regrets: Floats) -> Summary:
    """Mean of the regrets of the seeds, [seeds]."""
    means = regrets[_resamples(len(regrets))].mean(axis=1)
    return _summary(float(regrets.mean()), means)


def median_of(regrets: Floats) -> Summary:
    """Median of the regrets of the seeds, [seeds]."""
    medians = np.median(regrets[_resamples(len(regrets))], axis=1)
    return _summary(float(np.median(regrets)), medians)


def ratio_of_means(ours: Floats, theirs: Floats) -> Summary:
    """Mean regret of one arm over another's on the same seeds, each [seeds], resampled in pairs."""
    drawn = _resamples(len(ours))
    ratios = ours[drawn].mean(axis=1) / theirs[drawn].mean(axis=1)
    return _summary(float(ours.mean() / theirs.mean()), ratios)


def _resamples(seeds: int) -> NDArray[np.int64]:
    """Numbers of the seeds of each bootstrap sample, [RESAMPLES, seeds]."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    return rng.integers(seeds, size=(RESAMPLES, seeds))


def _summary(value: float, resampled: Floats) -> Summary:
    """A statistic with the central interval of its bootstrap values [RESAMPLES]."""
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(resampled, [tail, 100.0 - tail])
    return Summary(value, float(low), float(high))
