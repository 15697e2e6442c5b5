"""Fitting: scikit-learn's marginal likelihood, times priors on the constants.

The constants maximise log p(y | X, theta) + sum_i log N(theta_i; mode_i, sd_i^2), theta being their
logarithms. With few trials the likelihood alone is happy with any of them.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor

from study.sampler.posterior import Posterior
from study.sampler.terms import Term

Floats = NDArray[np.float64]
Objective = Callable[[Floats], tuple[float, Floats]]

JITTER = 1e-10  # scikit-learn's own
LIKELIHOOD_TRIALS = 120  # at most; constants are few, and the cost grows with the cube
ITERATIONS = 40
NOISE_STARTS = (0.0, 3.0)  # added to the log noise: the likelihood has a mode that is all noise
SECOND_START_TRIALS = 30  # up to so many: with more, the modes are rarely two


@dataclass(frozen=True)
class PriorOptimizer:
    """An optimizer for scikit-learn's regressor: L-BFGS on likelihood times prior."""

    term: Term
    starts: tuple[float, ...]

    def __call__(self, objective: Any, start: Floats, bounds: Floats) -> tuple[Floats, float]:
        """The best theta [t] of the starts, and the objective there."""
        mode = np.array([prior.mode for prior in self.term.priors])
        sd = np.array([prior.sd for prior in self.term.priors])

        def penalised(theta: Floats) -> tuple[float, Floats]:
            value, gradient = objective(theta, eval_gradient=True)
            z = (theta - mode) / sd
            return float(value + 0.5 * z @ z), gradient + z / sd

        found = [self._descend(penalised, start, bounds, shift) for shift in self.starts]
        best = min(found, key=lambda result: float(result.fun))
        return best.x, float(best.fun)

    @staticmethod
    def _descend(objective: Objective, start: Floats, bounds: Floats, noise_shift: float) -> Any:
        """One descent from theta [t] with the log noise shifted; scipy's result."""
        theta = start.copy()
        theta[-1] += noise_shift  # white noise is the last term of every kernel
        return minimize(
            objective,
            np.clip(theta, bounds[:, 0], bounds[:, 1]),
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": ITERATIONS, "ftol": 1e-5},
        )


def learn(term: Term, x: Floats, y: Floats, *, center: bool = True) -> Floats:
    """The constants [t], as logarithms, from trials x [n, p] with costs y [n] or [n, outputs].

    `center` takes the mean of the process to be that of the costs; else it is zero.
    """
    some = _informative(y)
    scaled, _, _ = _standard(y, center)
    starts = NOISE_STARTS if len(y) <= SECOND_START_TRIALS else NOISE_STARTS[:1]
    optimizer = PriorOptimizer(term, starts)
    return np.asarray(_regressor(term, x[some], scaled[some], optimizer).kernel_.theta)


def condition(
    term: Term,
    theta: Floats,
    x: Floats,
    y: Floats,
    *,
    center: bool = True,
    noisy: bool,
    fast: bool,
) -> Posterior:
    """The posterior under given constants, after trials x [n, p] with costs y [n]."""
    scaled, mean, sd = _standard(y, center)
    kept = Term(term.kernel.clone_with_theta(theta), term.priors)
    return Posterior(_regressor(kept, x, scaled, None), mean, sd, noisy, fast)


def believe(posterior: Posterior, x: Floats, y: Floats) -> Posterior:
    """The same after further trials, with costs in their own unit; constants and scale are kept."""
    old = posterior.regressor
    scaled = (y - posterior.cost_mean) / posterior.cost_sd
    term = Term(old.kernel_, ())
    regressor = _regressor(
        term, np.vstack([old.X_train_, x]), np.concatenate([old.y_train_, scaled]), None
    )
    return Posterior(
        regressor, posterior.cost_mean, posterior.cost_sd, posterior.noisy, posterior.fast
    )


def _regressor(
    term: Term, x: Floats, y: Floats, optimizer: PriorOptimizer | None
) -> GaussianProcessRegressor:
    """scikit-learn's, fitted on x [n, p] and y in standard units; None keeps the constants."""
    regressor = GaussianProcessRegressor(term.kernel, alpha=JITTER, optimizer=optimizer)
    with warnings.catch_warnings():
        # With few trials a constant at its bound is an answer, not a failure.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return regressor.fit(x, y)


def _standard(y: Floats, center: bool) -> tuple[Floats, float, float]:
    """Costs in standard units, their mean and their standard deviation (one if they are equal)."""
    mean = float(y.mean()) if center else 0.0
    sd = float(np.sqrt(np.mean((y - mean) ** 2)))
    sd = sd if sd > 1e-12 * abs(mean) and sd > 0 else 1.0
    return (y - mean) / sd, mean, sd


def _informative(y: Floats) -> NDArray[np.int64]:
    """Trials that the constants are learned from: the best half of the limit, the rest evenly."""
    if len(y) <= LIKELIHOOD_TRIALS:
        return np.arange(len(y))
    order = np.argsort(y if y.ndim == 1 else np.abs(y).sum(axis=1), kind="stable")
    best, others = np.split(order, [LIKELIHOOD_TRIALS // 2])
    spread = np.linspace(0, len(others) - 1, LIKELIHOOD_TRIALS - len(best)).astype(np.int64)
    return np.sort(np.concatenate([best, others[spread]]))
