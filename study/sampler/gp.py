"""The Gaussian process of the sampler: its constants, and the posterior.

| symbol | shape | meaning |
|---|---|---|
| X | [n, p] | trials, a row each (`study.sampler.covariance`) |
| y | [n] | their costs, in standard units |
| theta | [t] | logarithms of the constants of a kernel, the noise variance last |
| K | [n, n] | covariance of the trials, noise included |
| L | [n, n] | Cholesky factor of K |
| a | [n] | K^-1 y |
| k | [n, m] | covariance of the trials and m candidates |

The constants maximise

    log p(y | X, theta) + log N(theta; modes, prior),
    log p(y | X, theta) = -(y . a + log det K + n log 2 pi) / 2,

whose derivative by K is (a a^T - K^-1) / 2 (Rasmussen, Williams 2006, equations 2.30 and
5.9). With few trials the likelihood alone would allow almost any constants. The
posterior at a candidate x has

    mean = k^T K^-1 y = (L^-1 k)^T (L^-1 y),   variance = k(x, x) - |L^-1 k|^2  (algorithm 2.1).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from study.sampler.arrays import Floats, Whole
from study.sampler.covariance import AnyFloats, Covariance, Towards
from study.sampler.transforms import Points

JITTER = 1e-10  # variance added to the noise, so that equal rows do no harm
LIKELIHOOD_TRIALS = 120  # at most; constants are few, and the cost grows with the cube
ITERATIONS = 40
# Added to the log noise: the likelihood has a mode that is all noise.
NOISE_STARTS = (0.0, 3.0)
SECOND_START_TRIALS = 30  # up to so many: with more, the modes are rarely two
BLOCK = 512  # candidates at a time, so that a block stays in the cache
LARGEST_RATIO = 5e2  # of prior variance to noise, for which 32 bits keep within 1e-4


def misfit(
    covariance: Covariance, x: Floats, y: Floats, theta: Floats
) -> tuple[float, Floats]:
    """-log p(y | X, theta) - log N(theta; modes, prior), and its gradient [t].

    The constant of the normal density is left out. Infinite, with gradient zero,
    where rounding leaves K without a Cholesky factor.
    """
    noise = float(np.exp(theta[-1]))
    k, pull = covariance.gram(theta, x)
    factor, failed = cholesky(k, noise)
    if failed:
        return np.inf, np.zeros_like(theta)
    alpha = scipy.linalg.lapack.dpotrs(factor, y, lower=1)[0]
    log_root = np.log(factor.diagonal()).sum()  # of det K
    value = 0.5 * y @ alpha + (log_root + 0.5 * len(y) * np.log(2 * np.pi))
    # The lower halves of K^-1 and of K^-1 - a a^T. K is symmetric: one half, of which
    # the diagonal counts once and the rest twice, stands for both.
    inverse = scipy.linalg.lapack.dpotri(factor, lower=1, overwrite_c=1)[0]
    syrk = scipy.linalg.blas.dsyrk
    w = syrk(-1.0, alpha[:, None], beta=1.0, c=inverse, lower=1, overwrite_c=1).T
    np.einsum("ii->i", w)[:] *= 0.5
    gradient = np.append(pull(w), noise * np.trace(w))
    away = theta - covariance.modes
    slope = covariance.prior_precision @ away
    return float(value + 0.5 * away @ slope), gradient + slope


def cholesky(k: Floats, noise: float) -> tuple[Floats, bool]:
    """L [n, n] with L L^T = k + noise I, zero above its diagonal, and whether there is none."""
    matrix = np.array(k.T, order="F")  # as it lies in memory: it is symmetric
    np.einsum("ii->i", matrix)[:] += noise + JITTER
    factor, info = scipy.linalg.lapack.dpotrf(matrix, lower=1, clean=1, overwrite_a=1)
    return factor, info != 0


def learn(covariance: Covariance, x: Floats, y: Floats) -> Floats:
    """Theta [t] from trials x [n, p] with costs y [n], by L-BFGS."""
    some = _informative(y)
    scaled = _standard(y)[0] if covariance.standardised else y
    x, y = x[some], scaled[some]
    starts = NOISE_STARTS if len(scaled) <= SECOND_START_TRIALS else NOISE_STARTS[:1]
    found = []
    for shift in starts:
        start = covariance.start.copy()
        start[-1] += shift
        result = scipy.optimize.minimize(
            lambda theta: misfit(covariance, x, y, theta),
            np.clip(start, *covariance.bounds.T),
            jac=True,
            method="L-BFGS-B",
            bounds=covariance.bounds,
            options={"maxiter": ITERATIONS, "ftol": 1e-5},
        )
        found.append(result)
    return np.asarray(min(found, key=lambda result: float(result.fun)).x)


def condition(
    covariance: Covariance, theta: Floats, x: Floats, y: Floats, *, noisy: bool
) -> "Posterior":
    """The posterior under given constants, after trials x [n, p] with costs y [n]."""
    scaled, mean, sd = _standard(y) if covariance.standardised else (y, 0.0, 1.0)
    return Posterior(
        covariance=covariance,
        theta=theta,
        x=x,
        y=scaled,
        cost_mean=mean,
        cost_sd=sd,
        noisy=noisy,
    )


def _standard(y: Floats) -> tuple[Floats, float, float]:
    """Costs in standard units, their mean and their standard deviation (one if they are equal)."""
    mean = float(y.mean())
    sd = float(np.sqrt(np.mean((y - mean) ** 2)))
    sd = sd if sd > 1e-12 * abs(mean) and sd > 0 else 1.0
    return (y - mean) / sd, mean, sd


def _informative(y: Floats) -> Whole:
    """Trials that the constants are learned from: the best half of the limit, the rest evenly."""
    if len(y) <= LIKELIHOOD_TRIALS:
        return np.arange(len(y))
    order = np.argsort(y, kind="stable")
    best, others = np.split(order, [LIKELIHOOD_TRIALS // 2])
    spread = np.linspace(0, len(others) - 1, LIKELIHOOD_TRIALS - len(best))
    return np.sort(np.concatenate([best, others[spread.astype(np.int64)]]))


@dataclass(frozen=True, eq=False)
class Posterior:
    """The distribution of the cost, in its own unit, after some trials.

    Where 32 bits are enough, the mean is (L^-1 k)^T (L^-1 y), whose factors are of the
    size of the costs; those of k^T K^-1 y would cancel.

    Attributes:
        covariance: of the trials.
        theta: the constants that were learned, [t].
        x: X, the trials, [n, p].
        y: their costs in standard units, [n].
        cost_mean: what `y` was centred by, in the unit of the cost.
        cost_sd: what `y` was divided by, in the same unit, positive.
        noisy: whether the variance is that of the next trial, noise included; if not,
            of its expectation.
    """

    covariance: Covariance
    theta: Floats
    x: Floats
    y: Floats
    cost_mean: float
    cost_sd: float
    noisy: bool

    @property
    def noise(self) -> float:
        """Variance of the noise, in standard units."""
        return float(np.exp(self.theta[-1]))

    @property
    def shortest_scale(self) -> float:
        """The smallest length scale, in standard units; infinite without any."""
        values = self.covariance.valued(self.theta)
        return float(min(scales.min(initial=np.inf) for _, _, scales in values))

    def gram(self) -> Floats:
        """K without noise, [n, n]."""
        return self.covariance.gram(self.theta, self.x)[0]

    @cached_property
    def precision(self) -> type[np.floating[Any]]:
        """The precision of all that is [n, m]: 32 bits where rounding, which grows with the ratio
        of prior variance to noise, is small.
        """
        prior = np.max(self.covariance.variance(self.theta, self.x))
        return np.float32 if prior <= LARGEST_RATIO * self.noise else np.float64

    def predict(self, points: Points) -> tuple[Floats, Floats]:
        """Mean and variance of the cost at m candidates, [m] each."""
        mean, variance = np.empty(len(points)), np.empty(len(points))
        weights = (self._inverse @ self.y).astype(self.precision)
        ones = np.ones_like(weights)
        for start in range(0, len(points), BLOCK):
            block = slice(start, start + BLOCK)
            x = points.matrix[block]
            whitened = self._whitened(x)
            mean[block] = weights @ whitened
            variance[block] = self.covariance.variance(self.theta, x)
            variance[block] -= ones @ np.square(whitened, out=whitened)
        np.maximum(variance, 0.0, out=variance)
        variance += self.noise if self.noisy else 0.0
        return self.cost_mean + self.cost_sd * mean, self.cost_sd**2 * variance

    def mean(self, points: Points) -> Floats:
        """The mean alone, of few candidates, [m]."""
        alpha = self._inverse.T @ (self._inverse @ self.y)
        return self.cost_mean + self.cost_sd * (self._cross(points.matrix).T @ alpha)

    def believing(self, points: Points) -> "Posterior":
        """The posterior after further trials with their expected costs; constants are kept."""
        y = (self.mean(points) - self.cost_mean) / self.cost_sd
        x = np.vstack([self.x, points.matrix])
        return replace(self, x=x, y=np.concatenate([self.y, y]))

    @cached_property
    def _cross(self) -> Towards:
        """Covariance of the trials and candidates [m, p]: [n, m]."""
        return self.covariance.towards(self.theta, self.x, self.precision)

    @cached_property
    def _inverse(self) -> Floats:
        """L^-1, [n, n]."""
        factor, failed = cholesky(self.gram(), self.noise)
        if failed:
            raise np.linalg.LinAlgError(
                "the covariance of the trials has no Cholesky factor"
            )
        return np.asarray(scipy.linalg.lapack.dtrtri(factor, lower=1, overwrite_c=1)[0])

    @cached_property
    def _whitener(self) -> AnyFloats:
        return np.asfortranarray(self._inverse.astype(self.precision))

    def _whitened(self, x: Floats) -> AnyFloats:
        """L^-1 k of candidates [b, p], [n, b]: by a triangle, in half the steps of a square."""
        times = scipy.linalg.get_blas_funcs("trmm", [self._whitener])
        # BLAS counts along columns: to it, k is its transpose, and is multiplied from
        # the right.
        options = {"side": 1, "lower": 1, "trans_a": 1, "overwrite_b": 1}
        return np.asarray(times(1.0, self._whitener, self._cross(x).T, **options).T)
