"""How likely constants are, given trials: the marginal likelihood times priors, and its gradient.

| symbol | shape | meaning |
|---|---|---|
| X | [n, p] | the trials |
| y | [n] | their costs in standard units |
| K | [n, n] | covariance of the trials, noise included |
| a | [n] | K^-1 y |
| W | [n, n] | derivative of what is returned by each entry of K |

log p(y | X, theta) = -(y^T a + log det K + n log 2 pi) / 2, and its derivative by K is
(a a^T - K^-1) / 2 (Rasmussen, Williams 2006, equations 2.30 and 5.9). The priors are normal
densities of theta, the logarithms of the constants.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from study.sampler.covariance import Covariance

Floats = NDArray[np.float64]

JITTER = 1e-10  # variance that is added to the noise, so that equal rows do no harm


class Misfit:
    """-log p(y | X, theta) - sum_i log N(theta_i; mode_i, sd_i^2), a constant left out."""

    def __init__(self, covariance: Covariance, x: Floats, y: Floats) -> None:
        """Of trials x [n, p] with costs y [n] in standard units."""
        self.covariance = covariance
        self.x = x
        self.y = y

    def __call__(self, theta: Floats) -> tuple[float, Floats]:
        """The misfit of constants [t], given as logarithms, and its gradient [t].

        Infinite, with gradient zero, where rounding leaves K without a Cholesky factor.
        """
        there = self.covariance.with_theta(theta)
        k, pull = there.kernel.gram(self.x)
        factor, failed = cholesky(k, there.noise)
        if failed:
            return np.inf, np.zeros_like(theta)
        alpha = scipy.linalg.lapack.dpotrs(factor, self.y, lower=1)[0]
        log_root = np.log(factor.diagonal()).sum()  # of det K
        misfit = 0.5 * self.y @ alpha + (log_root + 0.5 * len(self.y) * np.log(2 * np.pi))
        # The lower halves of K^-1 and of K^-1 - a a^T. K is symmetric: one half, of which the
        # diagonal counts once and the rest twice, stands for both.
        inverse = scipy.linalg.lapack.dpotri(factor, lower=1, overwrite_c=1)[0]
        syrk = scipy.linalg.blas.dsyrk
        w = syrk(-1.0, alpha[:, None], beta=1.0, c=inverse, lower=1, overwrite_c=1).T
        np.einsum("ii->i", w)[:] *= 0.5
        gradient = np.append(pull(w), there.noise * np.trace(w))
        z = (theta - self.covariance.modes) / self.covariance.spreads
        return float(misfit + 0.5 * z @ z), gradient + z / self.covariance.spreads


def cholesky(k: Floats, noise: float) -> tuple[Floats, bool]:
    """L [n, n] with L L^T = k + noise I, zero above its diagonal, and whether there is none."""
    matrix = np.array(k.T, order="F")  # as it lies in memory: it is symmetric
    np.einsum("ii->i", matrix)[:] += noise + JITTER
    factor, info = scipy.linalg.lapack.dpotrf(matrix, lower=1, clean=1, overwrite_a=1)
    return factor, info != 0
