"""The Gaussian process of cost over score: scikit-learn fits it, blocks of candidates query it.

| symbol | shape | meaning |
|---|---|---|
| x | [n] | scores of the finished trials, standardised over the table |
| y | [n] | their costs, standardised over the trials |
| K | [n, n] | c exp(-(x_i - x_j)^2 / (2 l^2)) + s^2 I: the DoG kernel with its constants learned |
| L | [n, n] | Cholesky factor of K |
| alpha | [n] | K^-1 y |

Many parameter sets share one score, and their costs differ: s^2 is that spread, which no repetition
would remove. It belongs to what the next trial will show, so `predict` includes it, as
scikit-learn's does.
"""

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

Floats = NDArray[np.float64]

# Initial value and bounds, in standard deviations of the costs (variances) and of the scores.
SIGNAL_VARIANCE = (1.0, (1e-2, 1e2))
LENGTH_SCALE = (1.0, (5e-2, 2e1))
NOISE_VARIANCE = (0.3, (1e-4, 1e1))

RESTARTS = 2  # the likelihood has a mode that explains everything as noise
BLOCK = 2048  # candidates at a time: [n, block] stays in the cache


@dataclass(frozen=True, eq=False)
class ScoreProcess:
    """A fitted process.

    Attributes:
        regressor: fitted on x and y.
        cost_mean: what `y` was centred by.
        cost_sd: what `y` was divided by.
    """

    regressor: GaussianProcessRegressor
    cost_mean: float
    cost_sd: float

    @classmethod
    def fit(cls, score: Floats, cost: Floats, seed: int) -> "ScoreProcess":
        """Fit to trials [n], n >= 1; constants by marginal likelihood, best of several starts."""
        mean, sd = float(cost.mean()), float(cost.std())
        sd = sd if sd > 0 else 1.0
        regressor = GaussianProcessRegressor(
            kernel=new_kernel(), alpha=0.0, n_restarts_optimizer=RESTARTS, random_state=seed
        )
        with warnings.catch_warnings():
            # With few trials a constant at its bound is an answer, not a failure.
            warnings.simplefilter("ignore", ConvergenceWarning)
            regressor.fit(score[:, None], (cost - mean) / sd)
        return cls(regressor, mean, sd)

    def predict(self, score: Floats) -> tuple[Floats, Floats]:
        """Mean and standard deviation of the cost of new rows with these scores [m]."""
        mean, variance = np.empty(len(score)), np.empty(len(score))
        for start in range(0, len(score), BLOCK):
            block = slice(start, start + BLOCK)
            mean[block], variance[block] = self._posterior(score[block])
        return self.cost_mean + self.cost_sd * mean, self.cost_sd * np.sqrt(variance)

    def _posterior(self, score: Floats) -> tuple[Floats, Floats]:
        """Mean k^T alpha and variance c + s^2 - |L^-1 k|^2, in standard units, [m]."""
        fitted = self.regressor
        signal, noise = fitted.kernel_.k1.k1.constant_value, fitted.kernel_.k2.noise_level
        distance = (fitted.X_train_ - score) / fitted.kernel_.k1.k2.length_scale
        k = signal * np.exp(-0.5 * distance**2)
        whitened = solve_triangular(fitted.L_, k, lower=True, check_finite=False)
        # The trials cannot explain more than the signal; rounding can.
        explained = np.minimum(np.sum(whitened**2, axis=0), signal)
        return fitted.alpha_ @ k, signal + noise - explained


def new_kernel() -> ConstantKernel:
    """The DoG kernel before learning: constant x RBF + white noise."""
    return ConstantKernel(*SIGNAL_VARIANCE) * RBF(*LENGTH_SCALE) + WhiteKernel(*NOISE_VARIANCE)
