"""Kernels as scikit-learn wants them, their priors, and what they make of features."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import approx_fprime
from sklearn.base import clone
from sklearn.gaussian_process import GaussianProcessRegressor

from study.sampler.composites import Slice
from study.sampler.gaussian_process import condition, learn
from study.sampler.kernels import Layout, feature_only, new_term
from study.sampler.options import KERNELS
from study.sampler.parts import RBF
from study.sampler.points import Points

LAYOUT = Layout(features=2, coordinates=3, parameters=3)
FORMS = [(k, m) for k in KERNELS if k != "alternate" for m in ("constant", "linear")]
X = np.random.default_rng(0).standard_normal((12, 5))


@pytest.mark.parametrize(("kernel", "mean"), FORMS)
def test_gradients_are_those_of_the_kernel(kernel: str, mean: str) -> None:
    built = new_term(kernel, mean, LAYOUT).kernel
    _, gradient = built(X, eval_gradient=True)
    assert gradient.shape == (12, 12, len(built.theta))

    def entry(theta: np.ndarray) -> float:
        return float(built.clone_with_theta(theta)(X)[2, 7])

    assert_allclose(gradient[2, 7], approx_fprime(built.theta, entry, 1e-6), atol=1e-5)


@pytest.mark.parametrize(("kernel", "mean"), FORMS)
def test_every_constant_has_a_prior(kernel: str, mean: str) -> None:
    term = new_term(kernel, mean, LAYOUT)
    assert len(term.priors) == len(term.kernel.theta) == len(term.kernel.bounds)


@pytest.mark.parametrize(
    ("kernel", "same_features", "same_parameters"),
    [("rbf", 1, 0), ("rbf_ard", 1, 0), ("matern_ard", 1, 0), ("euclidean", 0, 1), ("sum", 1, 1)],
)
def test_kernels_see_their_columns(kernel: str, same_features: int, same_parameters: int) -> None:
    built = new_term(kernel, "constant", LAYOUT).kernel
    a, far = np.zeros((1, 5)), 1e3
    other_parameters, other_features = a.copy(), a.copy()
    other_parameters[:, 2:], other_features[:, :2] = far, far
    assert_allclose(built(a, other_parameters), same_features, atol=1e-9)
    assert_allclose(built(a, other_features), same_parameters, atol=1e-9)


def test_a_product_needs_both() -> None:
    built = new_term("product", "constant", LAYOUT).kernel
    a, b = np.zeros((1, 5)), np.zeros((1, 5))
    b[:, 0] = 1e3
    assert_allclose(built(a, b), 0.0, atol=1e-9)


def test_a_shared_length_scale_and_one_a_feature() -> None:
    assert len(new_term("rbf", "constant", LAYOUT).kernel.theta) == 3
    assert len(new_term("rbf_ard", "constant", LAYOUT).kernel.theta) == 4
    assert len(new_term("euclidean", "constant", LAYOUT).kernel.theta) == 5
    assert feature_only("matern_ard") and not feature_only("sum")


def test_parameters_have_the_dimension_scaled_prior() -> None:
    for d in (1, 16, 100):
        prior = new_term("euclidean", "constant", Layout(0, d, d)).priors[1]
        mu, sigma = np.sqrt(2) + np.log(d) / 2, np.sqrt(3)  # Hvarfner et al. 2024
        assert_allclose(prior.mode, mu - sigma**2)
        assert_allclose(prior.sd, sigma)


def test_a_slice_is_a_kernel_of_scikit_learn() -> None:
    kernel = Slice(RBF(2.0), 1, 3)
    assert clone(kernel) == kernel
    assert_allclose(kernel(X), RBF(2.0)(X[:, 1:3]))
    assert_allclose(kernel.diag(X), 1.0)
    assert kernel.is_stationary()
    assert repr(kernel) == "RBF(length_scale=2)[1:3]"


def test_the_posterior_density_is_maximised() -> None:
    """No constant can be moved either way for a better likelihood times prior."""
    term = new_term("rbf_ard", "constant", LAYOUT)
    y = np.sin(X[:, 0])
    y = (y - y.mean()) / y.std()
    theta = learn(term, X, y)
    regressor = GaussianProcessRegressor(term.kernel, optimizer=None).fit(X, y)

    def density(at: np.ndarray) -> float:
        z = [(t - p.mode) / p.sd for t, p in zip(at, term.priors, strict=True)]
        return float(regressor.log_marginal_likelihood(at) - 0.5 * np.sum(np.square(z)))

    low, high = term.kernel.bounds.T
    for place in range(len(theta)):
        for step in (-0.1, 0.1):
            moved = theta.copy()
            moved[place] += step
            assert density(np.clip(moved, low, high)) <= density(theta) + 1e-3


def test_the_prior_decides_where_there_is_one_trial() -> None:
    term = new_term("euclidean", "constant", LAYOUT)
    theta = learn(term, X[:1], np.array([2.0]))
    for found, prior in zip(theta[1:4], term.priors[1:4], strict=True):
        assert_allclose(found, prior.mode, atol=1e-3)


def test_a_linear_mean_carries_beyond_the_trials() -> None:
    x = np.linspace(-1, 1, 25)[:, None]
    beyond = Points(np.array([[6.0]]), np.empty((1, 0)))

    def predicted(mean: str) -> float:
        term = new_term("rbf", mean, Layout(1, 0, 1))
        y = 3.0 * x[:, 0]
        fitted = condition(term, learn(term, x, y), x, y, noisy=False, fast=False)
        return float(fitted.predict(beyond)[0][0])

    assert abs(predicted("linear") - 18.0) < abs(predicted("constant") - 18.0)
    assert abs(predicted("linear") - 18.0) < 4.0
