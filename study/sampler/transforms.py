"""Costs with cliffs and infinities made fit for a Gaussian process."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LARGEST = float(np.finfo(np.float64).max)
MOST = 2.0**500


def log_excess(cost: Floats) -> Floats:
    """log(1 + (cost - least) / typical) of costs [n], typical being the median excess.

    Costs of any sign and unit, in the same order; far above the least, their logarithm: a cliff
    does not hide what is at its foot. Costs beyond a quarter of the largest float count as that.
    """
    cost = np.clip(cost, -LARGEST / 4, LARGEST / 4)  # so that excess, and two of them, are finite
    excess = cost - cost.min()
    above = excess[excess > 0]
    with np.errstate(over="ignore"):
        ratio = excess / (np.median(above) if len(above) else 1.0)
    return np.asarray(np.log1p(np.minimum(ratio, LARGEST)))


def squarable(values: Floats) -> Floats:
    """The values, those beyond +-`MOST` replaced by it: of a million others, squares can be summed.

    NaN and what is smaller stay as they are, to the bit.
    """
    return np.clip(values, -MOST, MOST)


def clip_infinities(values: Floats) -> Floats:
    """Infinite values replaced by the largest and the smallest finite one (zero if none is)."""
    finite = values[np.isfinite(values)]
    low, high = (finite.min(), finite.max()) if len(finite) else (0.0, 0.0)
    return np.where(values == np.inf, high, np.where(values == -np.inf, low, values))
