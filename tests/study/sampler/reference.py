"""scikit-learn's Gaussian process for the covariances of `study.sampler`: what ours is held to."""

import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor, kernels

from study.sampler import gp
from study.sampler.covariance import KERNELS, NEARNESS, SIMILARITY, WITH_WORLDS

# All that there are, by name.
OTHERS = {"nearness": NEARNESS, "worlds": WITH_WORLDS, "similarity": SIMILARITY}
FORMS = KERNELS | OTHERS


class Columns(kernels.Kernel):
    """A kernel of scikit-learn's that sees some of the columns."""

    def __init__(self, kernel, columns):
        self.kernel = kernel
        self.columns = columns

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
        inner = linear = kernels.DotProduct(sigma_0=0.0, sigma_0_bounds="fixed")
        if len(scales):
            shape = {"length_scale_bounds": term.scales[0].bounds}
            shape["length_scale"] = scales[0] if len(scales) == 1 else scales
            rough = term.rough
            inner = kernels.Matern(nu=2.5, **shape) if rough else kernels.RBF(**shape)
        inner = Columns(inner, slice(first + term.sized, term.columns.stop))
        if term.sized:
            inner = kernels.Product(Columns(linear, slice(first, first + 1)), inner)
        factor = kernels.ConstantKernel(variance, term.variance.bounds)
        product = kernels.Product(factor, inner)
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
    z = (theta - covariance.modes) / covariance.spreads
    return float(-likelihood + 0.5 * z @ z), -gradient + z / covariance.spreads
