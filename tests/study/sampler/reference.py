"""scikit-learn's Gaussian process for the covariances of `study.sampler`: what ours is held to."""

import numpy as np
from scipy.optimize import minimize
from sklearn.gaussian_process import GaussianProcessRegressor, kernels

from study.sampler import covariance as kinds
from study.sampler import gp

FORMS = kinds.KERNELS | {"nearness": kinds.NEARNESS}  # all that there are, by name


class Columns(kernels.Kernel):
    """A kernel of scikit-learn's that sees some of the columns."""

    def __init__(self, kernel, columns):
        self.kernel = kernel
        self.columns = columns

    def get_params(self, deep=True):
        params = {"kernel": self.kernel, "columns": self.columns}
        inner = self.kernel.get_params().items() if deep else ()
        return params | {f"kernel__{name}": value for name, value in inner}

    @property
    def hyperparameters(self):
        return self.kernel.hyperparameters

    @property
    def theta(self):
        return self.kernel.theta

    @theta.setter
    def theta(self, theta):
        self.kernel.theta = theta

    @property
    def bounds(self):
        return self.kernel.bounds

    def __call__(
        self,
        X,  # noqa: N803
        Y=None,  # noqa: N803
        eval_gradient=False,
    ):
        other = None if Y is None else Y[:, self.columns]
        return self.kernel(X[:, self.columns], other, eval_gradient=eval_gradient)

    def diag(self, X):  # noqa: N803
        return self.kernel.diag(X[:, self.columns])

    def is_stationary(self):
        return self.kernel.is_stationary()


def of_covariance(covariance, theta):
    """The same kernel of scikit-learn's with these constants and the same bounds."""
    total = None
    for term, variance, scales in covariance.valued(theta):
        first = term.columns.start
        columns = slice(first + term.gapped, term.columns.stop)
        if len(scales):
            limits = term.scales[0].bounds
            lengths = scales[0] if len(scales) == 1 else scales
            if term.rough:
                inner = kernels.Matern(lengths, limits, nu=2.5)
            else:
                inner = kernels.RBF(lengths, limits)
        else:
            inner = kernels.DotProduct(sigma_0=0.0, sigma_0_bounds="fixed")
        factor = kernels.ConstantKernel(variance, term.variance.bounds)
        product = kernels.Product(factor, Columns(inner, columns))
        if term.gapped:
            linear = kernels.DotProduct(sigma_0=0.0, sigma_0_bounds="fixed")
            gap = Columns(linear, slice(first, first + 1))
            product = kernels.Product(gap, product)
        total = product if total is None else kernels.Sum(total, product)
    return total + kernels.WhiteKernel(np.exp(theta[-1]), covariance.noise.bounds)


def conditioned(covariance, theta, x, y):
    """After trials x [n, p] with y [n] in standard units; constants are kept."""
    kernel = of_covariance(covariance, theta)
    return GaussianProcessRegressor(kernel, alpha=gp.JITTER, optimizer=None).fit(x, y)


def misfit(covariance, x, y, theta):
    """`gp.misfit`, by scikit-learn."""
    regressor = conditioned(covariance, theta, x, y)
    likelihood, gradient = regressor.log_marginal_likelihood(theta, eval_gradient=True)
    away = theta - covariance.modes
    slope = np.linalg.solve(covariance.prior, away)
    return float(-likelihood + 0.5 * away @ slope), -gradient + slope


def learned(covariance, x, y):
    """Theta by SciPy's L-BFGS on scikit-learn's likelihood times prior; y in standard units."""
    few = len(y) <= gp.SECOND_START_TRIALS
    found = []
    for shift in gp.NOISE_STARTS if few else gp.NOISE_STARTS[:1]:
        start = covariance.start.copy()
        start[-1] += shift
        result = minimize(
            lambda theta: misfit(covariance, x, y, theta),
            np.clip(start, *covariance.bounds.T),
            jac=True,
            method="L-BFGS-B",
            bounds=covariance.bounds,
            options={"maxiter": gp.ITERATIONS, "ftol": 1e-5},
        )
        found.append(result)
    return min(found, key=lambda result: float(result.fun)).x
