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
from scipy.spatial.distance import cdist
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import (
    RBF,
    ConstantKernel,
    DotProduct,
    Kernel,
    Matern,
    Product,
    Sum,
    WhiteKernel,
)

from study.sampler.points import Points
from study.sampler.terms import Slice

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
    def theta(self) -> Floats:
        """Logarithms of the constants."""
        return np.asarray(self.regressor.kernel_.theta)

    @cached_property
    def noise(self) -> float:
        """Variance of the noise, in standard units."""
        return noise_of(self.regressor.kernel_)

    @cached_property
    def fast_is_right(self) -> bool:
        """Whether 32 bits are asked for, and enough: rounding grows with the root of this ratio."""
        fitted = self.regressor
        prior = np.max(prior_variance(fitted.kernel_, fitted.X_train_))
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
        prior = np.broadcast_to(cross(self.regressor.kernel_, x, x, fast=False), (len(x),) * 2)
        mean = k.T @ self.regressor.alpha_
        covariance = self.cost_sd**2 * (prior - whitened.T @ whitened)
        return self.cost_mean + self.cost_sd * mean, covariance

    def _cross(self, x: Floats, fast: bool) -> AnyFloats:
        fitted = self.regressor
        k = cross(fitted.kernel_, fitted.X_train_, x, fast)
        return np.asarray(np.broadcast_to(k, (len(fitted.X_train_), len(x))))

    def _block_exact(self, x: Floats) -> tuple[Floats, Floats]:
        k = self._cross(x, fast=False)
        whitened = solve_triangular(self.regressor.L_, k, lower=True, check_finite=False)
        explained = np.einsum("nm,nm->m", whitened, whitened)
        return self.regressor.alpha_ @ k, prior_variance(self.regressor.kernel_, x) - explained

    def _block_fast(self, x: Floats) -> tuple[AnyFloats, AnyFloats]:
        inverse, weights = self._whitener
        whitened = inverse @ self._cross(x, fast=True)
        explained = np.einsum("nm,nm->m", whitened, whitened)
        return weights @ whitened, prior_variance(self.regressor.kernel_, x) - explained

    @cached_property
    def _whitener(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """L^-1 [n, n] and L^-1 y [n]."""
        factor = self.regressor.L_
        identity = np.eye(len(factor))
        inverse = solve_triangular(factor, identity, lower=True, check_finite=False)
        weights = inverse @ self.regressor.y_train_
        return inverse.astype(np.float32), weights.astype(np.float32)


def blocks(points: Points) -> Iterator[tuple[slice, Floats]]:
    """Candidates block by block, [b, p]."""
    for start in range(0, len(points), BLOCK):
        block = slice(start, min(start + BLOCK, len(points)))
        yield block, points.matrix(block)


def cross(kernel: Kernel, a: Floats, b: Floats, fast: bool) -> Any:
    """Covariance [n, m] of two sets of different rows (no noise), or a number where constant."""
    if isinstance(kernel, Sum):
        return cross(kernel.k1, a, b, fast) + cross(kernel.k2, a, b, fast)
    if isinstance(kernel, Product):
        return cross(kernel.k1, a, b, fast) * cross(kernel.k2, a, b, fast)
    if isinstance(kernel, ConstantKernel):
        return float(kernel.constant_value)
    if isinstance(kernel, WhiteKernel):
        return 0.0
    if isinstance(kernel, Slice):
        columns = slice(kernel.start, kernel.end)
        return cross(kernel.kernel, a[:, columns], b[:, columns], fast)
    if isinstance(kernel, DotProduct):
        return _precise(kernel.sigma_0**2 + a @ b.T, fast)
    return _stationary(kernel, a, b, fast)


def _stationary(kernel: Kernel, a: Floats, b: Floats, fast: bool) -> AnyFloats:
    """Squared exponential or Matern 5/2 of scaled distances, [n, m]."""
    a, b = a / kernel.length_scale, b / kernel.length_scale
    square = _precise(_squared_distances(a, b) if fast else cdist(a, b, "sqeuclidean"), fast)
    if isinstance(kernel, Matern):  # before RBF, whose subclass it is
        assert kernel.nu == 2.5  # the only one that is built
        distance = np.sqrt(5.0 * square)
        return (1.0 + distance + distance**2 / 3.0) * np.exp(-distance)
    assert isinstance(kernel, RBF)
    square *= -0.5
    return np.asarray(np.exp(square, out=square))


def _squared_distances(a: Floats, b: Floats) -> Floats:
    """|a - b|^2 = |a|^2 + |b|^2 - 2 a b, as one product of matrices, [n, m]."""
    if a.shape[1] == 1:
        return np.asarray((a - b.T) ** 2)
    left = np.column_stack([-2.0 * a, np.einsum("np,np->n", a, a), np.ones(len(a))])
    right = np.column_stack([b, np.ones(len(b)), np.einsum("mp,mp->m", b, b)])
    return np.asarray(np.maximum(left @ right.T, 0.0))


def _precise(values: Floats, fast: bool) -> AnyFloats:
    return values.astype(np.float32) if fast else values


def prior_variance(kernel: Kernel, x: Floats) -> Any:
    """k(x, x) without noise, [m], or a number where constant."""
    if isinstance(kernel, Sum):
        return prior_variance(kernel.k1, x) + prior_variance(kernel.k2, x)
    if isinstance(kernel, Product):
        return prior_variance(kernel.k1, x) * prior_variance(kernel.k2, x)
    if isinstance(kernel, ConstantKernel):
        return float(kernel.constant_value)
    if isinstance(kernel, WhiteKernel):
        return 0.0
    if isinstance(kernel, Slice):
        return prior_variance(kernel.kernel, x[:, kernel.start : kernel.end])
    if isinstance(kernel, DotProduct):
        return kernel.sigma_0**2 + np.einsum("mp,mp->m", x, x)
    return 1.0


def noise_of(kernel: Kernel) -> float:
    """The variance of the white noise in a kernel."""
    if isinstance(kernel, WhiteKernel):
        return float(kernel.noise_level)
    if isinstance(kernel, Sum):
        return noise_of(kernel.k1) + noise_of(kernel.k2)
    return 0.0
