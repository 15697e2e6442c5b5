"""The probability that a candidate keeps its limits, from trials that did and did not."""

import numpy as np
import scipy
from numpy.typing import NDArray

from study.sampler.points import Points
from study.sampler.posterior import Posterior

Floats = NDArray[np.float64]


def log_kept(mean: Floats, variance: Floats) -> Floats:
    """log P(limit <= 0) of a limit ~ N(mean, variance), [m].

    Gelbart, Snoek, Adams 2014, section 3. Of a mere failed / did not fail, told as 1 / -1, it is
    the least-squares classifier (Rasmussen, Williams 2006, section 6.5).
    """
    sd = np.sqrt(np.maximum(variance, 1e-24))
    return np.asarray(scipy.special.log_ndtr(-mean / sd))


def log_all_kept(limits: list[Posterior], points: Points) -> Floats:
    """The sum over independent limits, [m]."""
    total = np.zeros(len(points))
    for posterior in limits:
        total += log_kept(*posterior.predict(points))
    return total
