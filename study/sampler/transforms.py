"""Costs with cliffs and infinities made fit for a Gaussian process."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def log_excess(cost: Floats) -> Floats:
    """log(1 + (cost - least) / typical) of costs [n], typical being the median excess.

    Costs of any sign and unit, in the same order; far above the least, their logarithm: a cliff
    does not hide what is at its foot.
    """
    excess = cost - cost.min()
    above = excess[excess > 0]
    return np.asarray(np.log1p(excess / (np.median(above) if len(above) else 1.0)))


def clip_infinities(values: Floats) -> Floats:
    """Infinite values replaced by the largest and the smallest finite one (zero if none is)."""
    finite = values[np.isfinite(values)]
    low, high = (finite.min(), finite.max()) if len(finite) else (0.0, 0.0)
    return np.where(values == np.inf, high, np.where(values == -np.inf, low, values))
