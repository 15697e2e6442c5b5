"""The posterior of a process at many candidates, in blocks that stay in the cache.

| symbol | shape | meaning |
|---|---|---|
| X | [n, p] | the trials |
| y | [n] | their costs in standard units |
| K | [n, n] | covariance of the trials, noise included |
| L | [n, n] | Cholesky factor of K |
| k | [n, m] | covariance of trials and candidates |

mean = k^T K^-1 y = (L^-1 k)^T (L^-1 y), variance = k(x, x) - |L^-1 k|^2 (Rasmussen, Williams 2006,
algorithm 2.1).

The fast path takes distances in 64 bits, and everything of size [n, m] after that in 32: the mean
as above, whose factors are of the size of the costs, where those of k^T K^-1 y would cancel.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from study.sampler.covariance import Covariance
from study.sampler.likelihood import cholesky
from study.sampler.parts import Part, Towards
from study.sampler.points import Points

Floats = NDArray[np.float64]
AnyFloats = NDArray[Any]

BLOCK = 512  # candidates at a time
LARGEST_RATIO = 5e2  # of prior variance to noise, for which 32 bits keep within 1e-4


@dataclass(frozen=True, eq=False)
class Posterior:
    """What is known of the cost, in its own unit, after some trials.

    Attributes:
        covariance: with the constants that were learned.
        x: X, the trials.
        y: their costs in standard units, [n].
        cost_mean: what `y` was centred by.
        cost_sd: what `y` was divided by.
        noisy: whether the variance is that of the next trial, noise included, or that of its
            expectation.
        fast: 32 bits.
    """

    covariance: Covariance
    x: Floats
    y: Floats
    cost_mean: float
    cost_sd: float
    noisy: bool
    fast: bool

    @property
    def kernel(self) -> Part:
        """The covariance without noise."""
        return self.covariance.kernel

    @property
    def noise(self) -> float:
        """Variance of the noise, in standard units."""
        return self.covariance.noise

    @cached_property
    def fast_is_right(self) -> bool:
        """Whether 32 bits are asked for, and enough: rounding grows with the root of this ratio."""
        prior = np.max(self.kernel.variance(self.x))
        return self.fast and bool(prior <= LARGEST_RATIO * self.noise)

    def predict(self, points: Points) -> tuple[Floats, Floats]:
        """Mean and variance of the cost at m candidates, [m] each."""
        mean, variance = np.empty(len(points)), np.empty(len(points))
        weights = (self._inverse @ self.y).astype(self._precision)
        ones = np.ones_like(weights)
        for block, x in blocks(points):
            whitened = self._whitened(x)
            mean[block] = weights @ whitened
            variance[block] = self.kernel.variance(x)
            variance[block] -= ones @ np.square(whitened, out=whitened)
        np.maximum(variance, 0.0, out=variance)
        variance += self.noise if self.noisy else 0.0
        return self.cost_mean + self.cost_sd * mean, self.cost_sd**2 * variance

    def mean(self, points: Points) -> Floats:
        """The mean alone, [m]."""
        mean = np.empty(len(points))
        alpha = self._inverse.T @ (self._inverse @ self.y)
        for block, x in blocks(points):
            mean[block] = self._cross(x).T @ alpha
        return self.cost_mean + self.cost_sd * mean

    def believing(self, points: Points) -> "Posterior":
        """The same after further trials that showed what is expected; constants are kept."""
        y = (self.mean(points) - self.cost_mean) / self.cost_sd
        x = np.vstack([self.x, points.matrix()])
        return replace(self, x=x, y=np.concatenate([self.y, y]))

    @property
    def _precision(self) -> type[np.floating[Any]]:
        """Of everything that is [n, m]."""
        return np.float32 if self.fast_is_right else np.float64

    @cached_property
    def _cross(self) -> Towards:
        """Covariance of the trials and candidates [m, p]: [n, m]."""
        return self.kernel.towards(self.x, self._precision)

    @cached_property
    def _inverse(self) -> Floats:
        """L^-1, [n, n]."""
        k, _ = self.kernel.gram(self.x)
        factor, failed = cholesky(k, self.noise)
        if failed:
            raise np.linalg.LinAlgError("the covariance of the trials has no Cholesky factor")
        return np.asarray(scipy.linalg.lapack.dtrtri(factor, lower=1, overwrite_c=1)[0])

    @cached_property
    def _whitener(self) -> AnyFloats:
        """L^-1 as the product wants it."""
        return np.asfortranarray(self._inverse.astype(self._precision))

    def _whitened(self, x: Floats) -> AnyFloats:
        """L^-1 k of candidates [b, p], [n, b]: by a triangle, in half the steps of a square."""
        blas = scipy.linalg.blas
        times = blas.strmm if self.fast_is_right else blas.dtrmm
        # BLAS counts along columns: to it, k is its transpose, and is multiplied from the right.
        k = self._cross(x).T
        whitened: AnyFloats = times(
            1.0, self._whitener, k, side=1, lower=1, trans_a=1, overwrite_b=1
        )
        return whitened.T


def blocks(points: Points) -> Iterator[tuple[slice, Floats]]:
    """Candidates block by block: which ones, and their rows [b, p]."""
    for start in range(0, len(points), BLOCK):
        block = slice(start, min(start + BLOCK, len(points)))
        yield block, points.matrix(block)
