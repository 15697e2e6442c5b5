"""Costs with cliffs made fit for a Gaussian process: ranks, or logarithms."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import rankdata

Floats = NDArray[np.float64]


def transformed(cost: Floats, transform: str) -> Floats:
    """Costs [n] on another scale, in the same order.

    - "none": as they are.
    - "rank": normal scores, Phi^-1((rank - 3/8) / (n + 1/4)) (Blom 1958), equal costs sharing
      theirs: what a cost is worth is its place, and the height of a cliff does not count.
    - "log": log(1 + (cost - least) / typical), typical being the median excess over the least:
      costs of any sign and unit; far above the least, their logarithm.
    """
    if transform == "rank":
        return np.asarray(ndtri((rankdata(cost) - 0.375) / (len(cost) + 0.25)))
    if transform == "log":
        excess = cost - cost.min()
        above = excess[excess > 0]
        return np.asarray(np.log1p(excess / (np.median(above) if len(above) else 1.0)))
    return cost


def clip_infinities(values: Floats) -> Floats:
    """Infinite values replaced by the largest and the smallest finite one (zero if none is)."""
    finite = values[np.isfinite(values)]
    low, high = (finite.min(), finite.max()) if len(finite) else (0.0, 0.0)
    return np.where(values == np.inf, high, np.where(values == -np.inf, low, values))
