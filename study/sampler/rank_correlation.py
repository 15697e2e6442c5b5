"""Spearman's rank correlation with its interval: whether a feature goes with the cost.

r is the correlation of ranks, equal values sharing the mean of theirs. Its interval is that of
Fisher's z = artanh r, which is about normal with the standard error

    sqrt((1 + r^2 / 2) / (n - 3))

(Bonett, Wright 2000, "Sample size requirements for estimating Pearson, Kendall and Spearman
correlations"). Of trials in perfect order z is infinite: they get the interval of trials
of which two neighbours are out of order, up to the end of the scale.
"""

from dataclasses import dataclass
from math import atanh, sqrt, tanh

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LEAST_TRIALS = 4
NORMAL_95 = 1.959964  # 97.5 % quantile of the normal distribution


@dataclass(frozen=True)
class RankCorrelation:
    """Of a feature and the cost, -1 to 1.

    Attributes:
        value: r.
        low: end of the interval that holds it with 95 %.
        high: its other end.
        errors: r in standard errors, on the scale of z.
    """

    value: float
    low: float
    high: float
    errors: float

    @classmethod
    def of(cls, feature: Floats, cost: Floats) -> "RankCorrelation | None":
        """Of n trials, [n] each; those without the feature (NaN) are left out.

        None: too few trials are left, or all have the same feature or the same cost.
        """
        known = ~np.isnan(feature)
        n = int(known.sum())
        if n < LEAST_TRIALS:
            return None
        a, b = _ranks(feature[known]), _ranks(cost[known])
        spread = sqrt(float((a @ a) * (b @ b)))
        if spread == 0:
            return None
        value = float(np.clip(a @ b / spread, -1.0, 1.0))
        most = 1.0 - 12.0 / (n**3 - n)  # 1 - 6 sum d^2 / (n^3 - n), two neighbours exchanged
        inner = min(max(value, -most), most)
        z, error = atanh(inner), sqrt((1.0 + inner**2 / 2.0) / (n - 3))
        low, high = tanh(z - NORMAL_95 * error), tanh(z + NORMAL_95 * error)
        return cls(value, min(low, value), max(high, value), z / error)


def _ranks(values: Floats) -> Floats:
    """Ranks of values [n] less their mean; infinities are the extreme ones."""
    ordered = np.sort(values)
    below = np.searchsorted(ordered, values, side="left")
    ranks = 0.5 * (below + np.searchsorted(ordered, values, side="right"))
    return np.asarray(ranks - ranks.mean())
