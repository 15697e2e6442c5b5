"""scikit-learn's Gaussian process for the covariances of `study.sampler`: what ours is held to."""

import warnings
from typing import Any

import numpy as np
from scipy.optimize import minimize
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor, kernels

from study.sampler import gp
from tests.study.sampler.studies import Floats

FORMS = gp.KERNELS | {"nearness": gp.NEARNESS}  # all that there are, by name


class Columns(kernels.Kernel):  # type: ignore[misc]
    """A kernel of scikit-learn's that sees some of the columns."""

    def __init__(self, kernel: Any, columns: slice) -> None:
        self.kernel = kernel
        self.columns = columns

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        params = {"kernel": self.kernel, "columns": self.columns}
        inner = self.kernel.get_params().items() if deep else ()
        return params | {f"kernel__{name}": value for name, value in inner}

    @property
    def hyperparameters(self) -> Any:
        return self.kernel.hyperparameters

    @property
    def theta(self) -> Any:
        return self.kernel.theta

    @theta.setter
    def theta(self, theta: Floats) -> None:
        self.kernel.theta = theta

    @property
    def bounds(self) -> Any:
        return self.kernel.bounds

    def __call__(
        self,
        X: Floats,  # noqa: N803
        Y: Floats | None = None,  # noqa: N803
        eval_gradient: bool = False,
    ) -> Any:
        other = None if Y is None else Y[:, self.columns]
        return self.kernel(X[:, self.columns], other, eval_gradient=eval_gradient)

    def diag(self, X: Floats) -> Any:  # noqa: N803
        return self.kernel.diag(X[:, self.columns])

    def is_stationary(self) -> Any:
        return self.kernel.is_stationary()


def of_covariance(covariance: gp.Covariance, theta: Floats) -> Any:
    """The same kernel of scikit-learn's with these constants and the same bounds."""
    total: Any = None
    for term, variance, scales in covariance.valued(theta):
        columns = slice(term.columns.start, term.columns.stop)
        if len(scales):
            limits = term.scales[0].bounds
            inner = kernels.RBF(scales[0] if len(scales) == 1 else scales, limits)
        else:
            inner = kernels.DotProduct(sigma_0=0.0, sigma_0_bounds="fixed")
        factor = kernels.ConstantKernel(variance, term.variance.bounds)
        product = kernels.Product(factor, Columns(inner, columns))
        total = product if total is None else kernels.Sum(total, product)
    return total + kernels.WhiteKernel(np.exp(theta[-1]), covariance.noise.bounds)


def conditioned(
    covariance: gp.Covariance, theta: Floats, x: Floats, y: Floats
) -> GaussianProcessRegressor:
    """After trials x [n, p] with y [n] in standard units; constants are kept."""
    kernel = of_covariance(covariance, theta)
    return GaussianProcessRegressor(kernel, alpha=gp.JITTER, optimizer=None).fit(x, y)


def misfit(
    covariance: gp.Covariance, x: Floats, y: Floats, theta: Floats
) -> tuple[float, Floats]:
    """`gp.misfit`, by scikit-learn."""
    regressor = conditioned(covariance, theta, x, y)
    likelihood, gradient = regressor.log_marginal_likelihood(theta, eval_gradient=True)
    z = (theta - covariance.modes) / covariance.spreads
    return float(-likelihood + 0.5 * z @ z), -gradient + z / covariance.spreads


def learned(covariance: gp.Covariance, x: Floats, y: Floats) -> Floats:
    """Theta by scikit-learn's own fit, L-BFGS on likelihood times prior; y in standard units."""

    def optimizer(
        objective: Any, start: Floats, bounds: Floats
    ) -> tuple[Floats, float]:
        def penalised(theta: Floats) -> tuple[float, Floats]:
            value, gradient = objective(theta, eval_gradient=True)
            z = (theta - covariance.modes) / covariance.spreads
            return float(value + 0.5 * z @ z), gradient + z / covariance.spreads

        found = []
        for shift in (
            gp.NOISE_STARTS if len(y) <= gp.SECOND_START_TRIALS else gp.NOISE_STARTS[:1]
        ):
            theta = start.copy()
            theta[-1] += shift
            options = {"maxiter": gp.ITERATIONS, "ftol": 1e-5}
            theta = np.clip(theta, *bounds.T)
            given = {
                "jac": True,
                "method": "L-BFGS-B",
                "bounds": bounds,
                "options": options,
            }
            found.append(minimize(penalised, theta, **given))
        best = min(found, key=lambda result: float(result.fun))
        return best.x, float(best.fun)

    kernel = of_covariance(covariance, covariance.start)
    regressor = GaussianProcessRegressor(kernel, alpha=gp.JITTER, optimizer=optimizer)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return np.asarray(regressor.fit(x, y).kernel_.theta)
