"""Kernels against scikit-learn's, their priors, and what they make of features."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import approx_fprime

from study.sampler.gp import Covariance, condition, learn, misfit, new_covariance
from study.sampler.transforms import Points
from tests.study.sampler import reference

LAYOUT = (2, 3, 3)  # features, coordinates, parameters
X = np.random.default_rng(0).standard_normal((12, 5))


def covariance_of(form: str, layout: tuple[int, int, int] = LAYOUT) -> Covariance:
    return new_covariance(reference.FORMS[form], *layout)


def between(covariance: Covariance, theta: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return covariance.towards(theta, a, np.float64)(b)


@pytest.mark.parametrize("form", reference.FORMS)
def test_kernels_are_scikit_learns(form: str) -> None:
    ours = covariance_of(form)
    theta = ours.start + np.linspace(-1.0, 1.0, len(ours.start))
    theirs = reference.of_covariance(ours, theta)
    assert_allclose(theta, theirs.theta)
    assert_allclose(ours.bounds, theirs.bounds)
    noise = np.exp(theta[-1])
    assert_allclose(ours.gram(theta, X)[0] + noise * np.eye(12), theirs(X), atol=1e-12)
    assert_allclose(between(ours, theta, X, X[:5]), theirs(X, X[:5]), atol=1e-12)
    assert_allclose(ours.variance(theta, X) + noise * np.ones(12), theirs.diag(X))
    half = ours.towards(theta, X, np.float32)(X[:5])
    assert half.dtype == np.float32
    assert_allclose(half, theirs(X, X[:5]), atol=1e-5)


@pytest.mark.parametrize("form", reference.FORMS)
def test_a_pull_weighs_the_derivatives_of_all_entries(form: str) -> None:
    ours = covariance_of(form)
    weights = np.random.default_rng(1).standard_normal((12, 12))

    def weighed(theta: np.ndarray) -> float:
        return float(np.sum(weights * ours.gram(theta, X)[0]))

    _, pull = ours.gram(ours.start, X)
    slopes = approx_fprime(ours.start, weighed, 1e-6)
    assert_allclose(pull(weights), slopes[:-1], atol=1e-4)
    assert slopes[-1] == 0  # the noise is not in this part
    assert_allclose(pull(np.tril(weights)) + pull(np.triu(weights, 1)), pull(weights))


@pytest.mark.parametrize(
    ("form", "same_features", "same_parameters"),
    [
        ("rbf", 1, 0),
        ("rbf_ard", 1, 0),
        ("euclidean", 0, 1),
        ("nearness", 0, 1),
        ("additive", 1, 1),
    ],
)
def test_kernels_see_their_columns(form: str, same_features: int, same_parameters: int) -> None:
    built = covariance_of(form)
    a, far = np.zeros((1, 5)), 1e3
    other_parameters, other_features = a.copy(), a.copy()
    other_parameters[:, 2:], other_features[:, :2] = far, far
    assert_allclose(between(built, built.start, a, other_parameters), same_features, atol=1e-9)
    assert_allclose(between(built, built.start, a, other_features), same_parameters, atol=1e-9)


def test_the_additive_one_is_its_formula() -> None:
    """v phi^T phi' + s^2 exp(-sum_j (phi_j - phi'_j)^2 / 2 l_j^2) + t^2 exp(-|u - u'|^2 / 2L^2)."""
    v, s2, l1, l2, t2, nearness = constants = np.array([0.2, 1.3, 0.7, 2.0, 0.4, 0.9])
    theta = np.append(np.log(constants), 0.0)
    phi, u = X[:, :2], X[:, 2:]
    difference = (phi[:, None] - phi[None]) / [l1, l2]
    away = ((u[:, None] - u[None]) ** 2).sum(axis=-1) / nearness**2
    likeness = s2 * np.exp(-0.5 * (difference**2).sum(axis=-1))
    expected = v * phi @ phi.T + likeness + t2 * np.exp(-0.5 * away)
    assert_allclose(covariance_of("additive").gram(theta, X)[0], expected, rtol=1e-10)


def test_a_shared_length_scale_and_one_a_feature() -> None:
    counts = {"rbf": 3, "rbf_ard": 4, "euclidean": 5, "nearness": 3, "additive": 7}
    assert {form: len(covariance_of(form).start) for form in counts} == counts


def test_parameters_have_the_dimension_scaled_prior() -> None:
    for d in (1, 16, 100):
        mu, sigma = np.sqrt(2) + np.log(d) / 2, np.sqrt(3)  # Hvarfner et al. 2024
        for form, place in (("euclidean", 1), ("nearness", 1), ("additive", 4)):
            prior = covariance_of(form, (1, d, d)).constants[place]
            assert_allclose(prior.mode, mu - sigma**2)
            assert_allclose(prior.sd, sigma)


def test_the_posterior_density_is_maximised() -> None:
    """No constant can be moved either way for a better likelihood times prior."""
    covariance = covariance_of("rbf_ard")
    y = np.sin(X[:, 0])
    y = (y - y.mean()) / y.std()
    theta = learn(covariance, X, y)
    low, high = covariance.bounds.T
    for place in range(len(theta)):
        for step in (-0.1, 0.1):
            moved = theta.copy()
            moved[place] += step
            there = misfit(covariance, X, y, np.clip(moved, low, high))[0]
            assert there >= misfit(covariance, X, y, theta)[0] - 1e-3


def test_the_prior_decides_where_there_is_one_trial() -> None:
    covariance = covariance_of("euclidean")
    theta = learn(covariance, X[:1], np.array([2.0]))
    for found, prior in zip(theta[1:4], covariance.constants[1:4], strict=True):
        assert_allclose(found, prior.mode, atol=1e-3)


def test_slopes_carry_beyond_the_trials() -> None:
    x = np.hstack([np.linspace(-1, 1, 25)[:, None], np.full((25, 1), 0.5)])
    beyond = Points(np.array([[6.0]]), np.array([[0.5]]))

    def predicted(form: str) -> float:
        covariance = covariance_of(form, (1, 1, 1))
        y = 3.0 * x[:, 0]
        fitted = condition(covariance, learn(covariance, x, y), x, y, noisy=False, fast=False)
        return float(fitted.predict(beyond)[0][0])

    assert abs(predicted("additive") - 18.0) < abs(predicted("rbf_ard") - 18.0)
    assert abs(predicted("additive") - 18.0) < 4.0
