"""Which candidate to try next: acquisition functions of a posterior, ties broken at random.

All are of a cost, lower is better, and are themselves to be maximised.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcx, ndtr

Floats = NDArray[np.float64]

TIE_TOLERANCE = 1e-9  # relative: below this, two candidates differ by rounding
LOG_SQRT_2PI = 0.5 * np.log(2.0 * np.pi)
LOG_SQRT_HALF_PI = 0.5 * np.log(0.5 * np.pi)
ASYMPTOTIC_Z = -1e6  # below it, 1/z^4 is less than rounding


def expected_improvement(mean: Floats, sd: Floats, best: float) -> Floats:
    """E[max(best - f, 0)] for f ~ N(mean, sd^2): how far below `best` a cost is expected, [m].

    = sd (z Phi(z) + phi(z)), z = (best - mean) / sd (Jones, Schonlau, Welch 1998, eq. 15).
    """
    gain = best - mean
    with np.errstate(divide="ignore", invalid="ignore"):
        z = gain / sd
        density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
        uncertain = gain * ndtr(z) + sd * density
    return np.maximum(np.where(sd > 0, uncertain, gain), 0.0)


def log_expected_improvement(mean: Floats, sd: Floats, best: float) -> Floats:
    """log of `expected_improvement`, finite where that underflows, [m].

    log sd + log h(z), h(z) = phi(z) + z Phi(z) (Ament et al. 2023, eq. 9 and appendix A.1).
    """
    gain = best - mean
    with np.errstate(divide="ignore", invalid="ignore"):
        uncertain = np.log(sd) + _log_h(gain / sd)
        certain = np.log(np.maximum(gain, 0.0))
    return np.asarray(np.where(sd > 0, uncertain, certain))


def _log_h(z: Floats) -> Floats:
    """log(phi(z) + z Phi(z)), [m]."""
    log_h = np.empty_like(z)
    near, far = z > -1.0, z <= ASYMPTOTIC_Z
    middle = ~(near | far)
    a = z[near]
    log_h[near] = np.log(np.exp(-0.5 * a**2 - LOG_SQRT_2PI) + a * ndtr(a))
    b = z[middle]
    # h = phi(z) (1 + z Phi(z) / phi(z)), the ratio being sqrt(pi/2) erfcx(-z / sqrt 2), below 1.
    ratio = np.exp(LOG_SQRT_HALF_PI + np.log(-b * erfcx(-b * np.sqrt(0.5))))
    # Far out the ratio tends to 1 - 1/z^2 and the difference to rounding: the series takes over.
    series = 1.0 / b**2 - 3.0 / b**4
    rest = np.where(b < -1e3, series, np.maximum(1.0 - ratio, 1e-300))
    log_h[middle] = -0.5 * b**2 - LOG_SQRT_2PI + np.log(rest)
    c = z[far]
    log_h[far] = -0.5 * c**2 - LOG_SQRT_2PI - 2.0 * np.log(-c)
    return log_h


def confidence_bound(mean: Floats, sd: Floats, exploration: float) -> Floats:
    """-(mean - exploration sd): how low a cost may well be, [m] (Srinivas et al. 2010, eq. 6)."""
    return exploration * sd - mean


def thompson(mean: Floats, covariance: Floats, rng: np.random.Generator) -> Floats:
    """Minus one draw from the joint posterior, [m] (Thompson 1933)."""
    values, vectors = np.linalg.eigh(covariance)
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(-(mean + spread @ rng.standard_normal(len(mean))))


def fading_log_weight(rank: Floats, prior_weight: float, trials: int) -> Floats:
    """log of rank^(prior_weight / n), [m]: piBO's weight (Hvarfner et al. 2022, eq. 6).

    Args:
        rank: share of candidates that the prior thinks no better, above 0 to 1, [m].
        prior_weight: its beta.
        trials: finished so far, n; 0 counts as 1.
    """
    return np.asarray(prior_weight / max(trials, 1) * np.log(rank))


def argmax_random_tie(values: Floats, rng: np.random.Generator) -> int:
    """Index of the largest value; one of them at random where several are equal."""
    largest = float(values.max())
    if np.isinf(largest):
        return int(rng.choice(np.flatnonzero(values == largest)))
    tied = np.flatnonzero(values >= largest - TIE_TOLERANCE * abs(largest))
    return int(rng.choice(tied))
