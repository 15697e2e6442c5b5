"""Which candidate to try next: the largest expected improvement, ties broken at random."""

from functools import cache

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TIE_TOLERANCE = 1e-9  # relative: below this, two candidates differ by rounding
LOG_SQRT_2PI = 0.5 * np.log(2.0 * np.pi)
SQRT_HALF = np.sqrt(0.5)
SQRT_HALF_PI = np.sqrt(0.5 * np.pi)
BLOCK = 4096  # candidates at a time, to stay in the cache
# Standard deviations.
FAR_BELOW, FAR_ABOVE = -1e3, 1e1
NODES_FROM, NODES_TO = -40, 10
NODES_A_UNIT = 64


def log_expected_improvement(mean: Floats, sd: Floats, best: float) -> Floats:
    """log E[max(best - f, 0)] for f ~ N(mean, sd^2): how far below `best` a cost may come, [m].

    = log sd + log h(z), h(z) = phi(z) + z Phi(z), z = (best - mean) / sd: expected improvement
    (Jones, Schonlau, Welch 1998, eq. 15), which has the same maximum, but underflows; the
    logarithm does not (Ament et al. 2023, eq. 9 and appendix A.1).
    """
    gain = best - mean
    with np.errstate(divide="ignore", invalid="ignore"):
        log_improvement = np.log(sd) + _log_h(gain / sd)
        certain = sd <= 0
        if certain.any():
            log_improvement[certain] = np.log(np.maximum(gain[certain], 0.0))
    return np.asarray(log_improvement)


def _log_h(z: Floats) -> Floats:
    """log h(z), h(z) = phi(z) + z Phi(z), within 1e-9, [m]: by a cubic between nodes."""
    nodes = _nodes()
    log_h = np.empty_like(z)
    for start in range(0, len(z), BLOCK):
        block = slice(start, start + BLOCK)
        place = NODES_A_UNIT * (np.fmin(np.fmax(z[block], NODES_FROM), NODES_TO) - NODES_FROM)
        node = place.astype(np.intp)
        place -= node
        log_h[block] = nodes[3][node]
        for coefficients in nodes[2::-1]:
            log_h[block] *= place
            log_h[block] += coefficients[node]
    outside = (z < NODES_FROM) | (z > NODES_TO)
    log_h[outside] = _exact_log_h(z[outside])
    return log_h


@cache
def _nodes() -> Floats:
    """Coefficients of the cubic from each node to the next, by ascending power, [4, nodes].

    It has the value and the slope of log h at both ends (Hermite); the slope is Phi / h.
    """
    count = int((NODES_TO - NODES_FROM) * NODES_A_UNIT)
    z = NODES_FROM + np.arange(count + 2) / NODES_A_UNIT
    value = _exact_log_h(z)
    slope = np.exp(scipy.special.log_ndtr(z) - value) / NODES_A_UNIT
    rise, first, last = np.diff(value), slope[:-1], slope[1:]
    square, cube = 3.0 * rise - 2.0 * first - last, first + last - 2.0 * rise
    return np.array([value[:-1], first, square, cube])


def _exact_log_h(z: Floats) -> Floats:
    """log h(z) as log phi(z) + log(1 + z Phi(z) / phi(z)), [m].

    Phi(z) / phi(z) = sqrt(pi/2) erfcx(-z / sqrt 2). Far below, 1 + ... is a difference of equals,
    and its series 1/z^2 - 3/z^4 takes over; far above, h(z) is z.
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
