"""Which candidate to try next: expected improvement, ties broken at random."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

Floats = NDArray[np.float64]

TIE_TOLERANCE = 1e-9  # relative: below this, two candidates differ by rounding


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


def argmax_random_tie(values: Floats, rng: np.random.Generator) -> int:
    """Index of the largest value; one of them at random where several are equal."""
    largest = float(values.max())
    tied = np.flatnonzero(values >= largest - TIE_TOLERANCE * abs(largest))
    return int(rng.choice(tied))
