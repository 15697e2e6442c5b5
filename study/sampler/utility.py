"""How good a candidate is by its mean and variance: chances, and the improvement to expect.

Each is a logarithm, [m], and has slopes by the mean and by the variance, so that points
can climb it.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from study.sampler.arrays import Floats

TIE_TOLERANCE = 1e-9  # relative: below this, two candidates differ by rounding
LOG_SQRT_2PI = 0.5 * np.log(2.0 * np.pi)
SQRT_HALF = np.sqrt(0.5)
SQRT_HALF_PI = np.sqrt(0.5 * np.pi)
FAR_BELOW, FAR_ABOVE = -1e3, 1e1  # standard deviations
LEAST_VARIANCE = 1e-24


@dataclass(frozen=True)
class Improvement:
    """log E[max(best - f, 0)] for f ~ N(mean, sd^2): how far below `best` a cost may come.

    Attributes:
        best: the cost to improve on.
    """

    best: float

    def __call__(self, mean: Floats, variance: Floats) -> Floats:
        """The logarithm, [m]."""
        return log_expected_improvement(mean, np.sqrt(variance), self.best)

    def slopes(self, mean: Floats, variance: Floats) -> tuple[Floats, Floats]:
        """Derivatives by the mean, -Phi / sd h, and the variance, phi / 2 sd^2 h, [m] each."""
        sd = np.sqrt(np.maximum(variance, LEAST_VARIANCE))
        z = (self.best - mean) / sd
        log_h = _log_h(z)
        by_mean = -np.exp(scipy.special.log_ndtr(z) - log_h) / sd
        log_density = -0.5 * z**2 - LOG_SQRT_2PI
        return by_mean, 0.5 * np.exp(log_density - log_h) / sd**2


@dataclass(frozen=True)
class Chance:
    """log P(f <= goal) for f ~ N(mean, sd^2).

    Attributes:
        goal: the largest cost, or excess of a limit, that will do.
    """

    goal: float

    def __call__(self, mean: Floats, variance: Floats) -> Floats:
        """The logarithm, [m]."""
        return log_chance_below_zero(mean - self.goal, variance)

    def slopes(self, mean: Floats, variance: Floats) -> tuple[Floats, Floats]:
        """Derivatives by mean, -phi / sd Phi, and variance, -z phi / 2 sd^2 Phi, [m] each."""
        sd = np.sqrt(np.maximum(variance, LEAST_VARIANCE))
        z = (self.goal - mean) / sd
        log_density = -0.5 * z**2 - LOG_SQRT_2PI
        ratio = np.exp(log_density - scipy.special.log_ndtr(z))
        return -ratio / sd, -0.5 * z * ratio / sd**2


Utility = Improvement | Chance


def log_expected_improvement(mean: Floats, sd: Floats, best: float) -> Floats:
    """log E[max(best - f, 0)] for f ~ N(mean, sd^2): how far below `best` a cost may come, [m].

    = log sd + log h(z), h(z) = phi(z) + z Phi(z), z = (best - mean) / sd: expected
    improvement (Jones, Schonlau, Welch 1998, eq. 15), which has the same maximum, but
    underflows; the logarithm does not (Ament et al. 2023, eq. 9 and appendix A.1).
    """
    gain = best - mean
    with np.errstate(divide="ignore", invalid="ignore"):
        log_improvement = np.log(sd) + _log_h(gain / sd)
        certain = sd <= 0
        if certain.any():
            log_improvement[certain] = np.log(np.maximum(gain[certain], 0.0))
    return np.asarray(log_improvement)


def _log_h(z: Floats) -> Floats:
    """log h(z) as log phi(z) + log(1 + z Phi(z) / phi(z)), [m].

    Phi(z) / phi(z) = sqrt(pi/2) erfcx(-z / sqrt 2). Far below, 1 + ... is a difference
    of equals, and its series 1/z^2 - 3/z^4 takes over; far above, h(z) is z.
    """
    middle = np.clip(z, FAR_BELOW, FAR_ABOVE)
    ratio = SQRT_HALF_PI * middle * scipy.special.erfcx(-SQRT_HALF * middle)
    log_h = np.asarray(np.log(1.0 + ratio) - 0.5 * middle**2 - LOG_SQRT_2PI)
    far = z > FAR_ABOVE
    log_h[far] = np.log(z[far])
    far = z < FAR_BELOW
    square = z[far] ** 2
    log_h[far] = np.log1p(-3.0 / square) - np.log(square) - 0.5 * square - LOG_SQRT_2PI
    return log_h


def argmax_random_tie(values: Floats, rng: np.random.Generator) -> int:
    """Index of the largest value; one of them at random where several are equal."""
    largest = float(values.max())
    if np.isinf(largest):
        return int(rng.choice(np.flatnonzero(values == largest)))
    tied = np.flatnonzero(values >= largest - TIE_TOLERANCE * abs(largest))
    return int(rng.choice(tied))


def log_chance_below_zero(mean: Floats, variance: Floats) -> Floats:
    """log P(limit <= 0) of a limit, or of a cost above its goal, ~ N(mean, variance), [m].

    Gelbart, Snoek, Adams 2014, section 3. Of limits that are 1 (failed) or -1, it is
    the least-squares classifier (Rasmussen, Williams 2006, section 6.5).
    """
    sd = np.sqrt(np.maximum(variance, LEAST_VARIANCE))
    return np.asarray(scipy.special.log_ndtr(-mean / sd))
