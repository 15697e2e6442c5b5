"""The posterior of a fitted process at many candidates, in blocks that stay in the cache.

| symbol | shape | meaning |
|---|---|---|
| X | [n, p] | the trials |
| y | [n] | their costs in standard units |
| K | [n, n] | covariance of the trials, noise included |
| L | [n, n] | Cholesky factor of K (scikit-learn's `L_`) |
| alpha | [n] | K^-1 y (scikit-learn's `alpha_`) |
| k | [n, m] | covariance of trials and candidates |

mean = k^T alpha, variance = k(x, x) - |L^-1 k|^2 (Rasmussen, Williams 2006, algorithm 2.1).

The fast path takes exponents in 64 bits, and everything of size [n, m] after that in 32: the mean
as (L^-1 k)^T (L^-1 y), whose factors are of the size of the costs, where those of k^T alpha would
cancel.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from sklearn.gaussian_process import GaussianProcessRegressor

from study.sampler.parts import Part
from study.sampler.points import Points

Floats = NDArray[np.float64]
AnyFloats = NDArray[Any]

BLOCK = 512  # candidates at a time
LARGEST_RATIO = 5e2  # of prior variance to noise, for which 32 bits keep within 1e-4


@dataclass(frozen=True, eq=False)
class Posterior:
    """What is known of the cost, in its own unit, after some trials.

    Attributes:
        regressor: of scikit-learn, fitted on X and y; y may be [n, outputs].
        cost_mean: what `y` was centred by.
        cost_sd: what `y` was divided by.
        noisy: whether the variance is that of the next trial, noise included (as scikit-learn's
            is), or that of its expectation.
        fast: 32 bits.
    """

    regressor: GaussianProcessRegressor
    cost_mean: float
    cost_sd: float
    noisy: bool
    fast: bool

    @property
    def kernel(self) -> Part:
        """The whole covariance, with the constants that were learned."""
        kernel: Part = self.regressor.kernel_
        return kernel

    @cached_property
    def noise(self) -> float:
        """Variance of the noise, in standard units."""
        return self.kernel.noise

    @cached_property
    def fast_is_right(self) -> bool:
        """Whether 32 bits are asked for, and enough: rounding grows with the root of this ratio."""
        prior = np.max(self.kernel.variance(self.regressor.X_train_))
        return self.fast and bool(prior <= LARGEST_RATIO * self.noise)

    def predict(self, points: Points) -> tuple[Floats, Floats]:
        """Mean and variance of the cost at m candidates, [m] each."""
        mean, variance = np.empty(len(points)), np.empty(len(points))
        posterior = self._block_fast if self.fast_is_right else self._block_exact
        for block, x in blocks(points):
            mean[block], variance[block] = posterior(x)
        np.maximum(variance, 0.0, out=variance)
        variance += self.noise if self.noisy else 0.0
        return self.cost_mean + self.cost_sd * mean, self.cost_sd**2 * variance

    def mean(self, points: Points) -> Floats:
        """The mean alone, [m] or [m, outputs]."""
        outputs = self.regressor.alpha_.shape[1:]
        mean = np.empty((len(points), *outputs))
        for block, x in blocks(points):
            mean[block] = self._cross(x, self.fast_is_right).T @ self.regressor.alpha_
        return self.cost_mean + self.cost_sd * mean

    def joint(self, points: Points) -> tuple[Floats, Floats]:
        """Mean [m] and covariance [m, m] of the expected cost at a few candidates."""
        x = points.matrix()
        k = self._cross(x, fast=False)
        whitened = solve_triangular(self.regressor.L_, k, lower=True, check_finite=False)
        prior = np.broadcast_to(self.kernel.cross(x, x, fast=False), (len(x),) * 2)
        mean = k.T @ self.regressor.alpha_
        covariance = self.cost_sd**2 * (prior - whitened.T @ whitened)
        return self.cost_mean + self.cost_sd * mean, covariance

    def _cross(self, x: Floats, fast: bool) -> AnyFloats:
        """Covariance of the trials and candidates [m, p]: [n, m]."""
        trials = self.regressor.X_train_
        k = self.kernel.cross(trials, x, fast)
        return np.asarray(np.broadcast_to(k, (len(trials), len(x))))

    def _block_exact(self, x: Floats) -> tuple[Floats, Floats]:
        """Mean and variance in standard units of candidates [b, p], [b] each; 64 bits."""
        k = self._cross(x, fast=False)
        whitened = solve_triangular(self.regressor.L_, k, lower=True, check_finite=False)
        explained = np.einsum("nm,nm->m", whitened, whitened)
        return self.regressor.alpha_ @ k, self.kernel.variance(x) - explained

    def _block_fast(self, x: Floats) -> tuple[AnyFloats, AnyFloats]:
        """The same in 32 bits."""
        inverse, weights = self._whitener
        whitened = inverse @ self._cross(x, fast=True)
        explained = np.einsum("nm,nm->m", whitened, whitened)
        return weights @ whitened, self.kernel.variance(x) - explained

    @cached_property
    def _whitener(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """L^-1 [n, n] and L^-1 y [n]."""
        factor = self.regressor.L_
        identity = np.eye(len(factor))
        inverse = solve_triangular(factor, identity, lower=True, check_finite=False)
        weights = inverse @ self.regressor.y_train_
        return inverse.astype(np.float32), weights.astype(np.float32)


def blocks(points: Points) -> Iterator[tuple[slice, Floats]]:
    """Candidates block by block: which ones, and their rows [b, p]."""
    for start in range(0, len(points), BLOCK):
        block = slice(start, min(start + BLOCK, len(points)))
        yield block, points.matrix(block)
