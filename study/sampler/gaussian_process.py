"""Fitting: the constants of a covariance from trials, and the posterior under given constants.

The constants maximise log p(y | X, theta) + sum_i log N(theta_i; mode_i, sd_i^2), theta being their
logarithms. With few trials the likelihood alone is happy with any of them.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from study.sampler.covariance import Covariance
from study.sampler.likelihood import Misfit
from study.sampler.posterior import Posterior

Floats = NDArray[np.float64]

LIKELIHOOD_TRIALS = 120  # at most; constants are few, and the cost grows with the cube
ITERATIONS = 40
NOISE_STARTS = (0.0, 3.0)  # added to the log noise: the likelihood has a mode that is all noise
SECOND_START_TRIALS = 30  # up to so many: with more, the modes are rarely two


def learn(covariance: Covariance, x: Floats, y: Floats) -> Floats:
    """The constants [t], as logarithms, from trials x [n, p] with costs y [n].

    The mean of the process is taken to be that of the costs.
    """
    some = _informative(y)
    scaled, _, _ = _standard(y)
    misfit = Misfit(covariance, x[some], scaled[some])
    starts = NOISE_STARTS if len(y) <= SECOND_START_TRIALS else NOISE_STARTS[:1]
    found = [_descend(misfit, shift) for shift in starts]
    return np.asarray(min(found, key=lambda result: float(result.fun)).x)


def condition(
    covariance: Covariance,
    theta: Floats,
    x: Floats,
    y: Floats,
    *,
    noisy: bool,
    fast: bool = True,
) -> Posterior:
    """The posterior under given constants, after trials x [n, p] with costs y [n]."""
    scaled, mean, sd = _standard(y)
    return Posterior(covariance.with_theta(theta), x, scaled, mean, sd, noisy, fast)


def _descend(misfit: Misfit, noise_shift: float) -> "scipy.optimize.OptimizeResult":
    """L-BFGS from the constants that the covariance came with, the log noise shifted."""
    start, bounds = misfit.covariance.theta, misfit.covariance.bounds
    start[-1] += noise_shift
    return scipy.optimize.minimize(
        misfit,
        np.clip(start, bounds[:, 0], bounds[:, 1]),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": ITERATIONS, "ftol": 1e-5},
    )


def _standard(y: Floats) -> tuple[Floats, float, float]:
    """Costs in standard units, their mean and their standard deviation (one if they are equal)."""
    mean = float(y.mean())
    sd = float(np.sqrt(np.mean((y - mean) ** 2)))
    sd = sd if sd > 1e-12 * abs(mean) and sd > 0 else 1.0
    return (y - mean) / sd, mean, sd


def _informative(y: Floats) -> NDArray[np.int64]:
    """Trials that the constants are learned from: the best half of the limit, the rest evenly."""
    if len(y) <= LIKELIHOOD_TRIALS:
        return np.arange(len(y))
    order = np.argsort(y, kind="stable")
    best, others = np.split(order, [LIKELIHOOD_TRIALS // 2])
    spread = np.linspace(0, len(others) - 1, LIKELIHOOD_TRIALS - len(best)).astype(np.int64)
    return np.sort(np.concatenate([best, others[spread]]))
