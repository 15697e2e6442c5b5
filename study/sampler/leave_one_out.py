"""What a model would have said of each trial if it had not seen it.

With K the covariance of the n trials, noise included, and y their costs less what is expected
before any of them, the cost of trial i is missed by [K^-1 y]_i / [K^-1]_ii (Rasmussen, Williams
2006, equation 5.12), without a fit for each trial: the constants are those learned from all. What
is expected is the mean of the costs, here that of the others, so that a model that knows nothing
errs as the constant does.
"""

import numpy as np
from numpy.typing import NDArray

from study.sampler.likelihood import JITTER
from study.sampler.posterior import Posterior

Floats = NDArray[np.float64]


def residuals(posterior: Posterior) -> Floats:
    """Costs less what the other trials let expect, in the unit of the costs, [n]."""
    k, _ = posterior.kernel.gram(posterior.x)
    n, y = len(posterior.y), posterior.y  # whose mean is zero
    if n < 2:
        return np.full(n, np.nan)
    inverse = np.linalg.inv(k + (posterior.noise + JITTER) * np.eye(n))
    others = -y / (n - 1)  # mean of the others
    missed = (inverse @ y - others * inverse.sum(axis=1)) / np.diag(inverse)
    return np.asarray(posterior.cost_sd * missed)


def residuals_of_constant(cost: Floats) -> Floats:
    """The same where the mean of the others is expected, [n]."""
    n = len(cost)
    if n < 2:
        return np.full(n, np.nan)
    return np.asarray((cost - cost.mean()) * n / (n - 1))


def rms(values: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))
