"""The marginal likelihood, its gradient and the constants it leads to: those of scikit-learn."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import approx_fprime

from study.sampler.gp import (
    FEATURE_NOISE,
    LIKELIHOOD_TRIALS,
    SLOPE,
    Covariance,
    Term,
    learn,
    misfit,
    new_covariance,
)
from tests.study.sampler import reference

LAYOUT = (3, 4, 4)


def trials(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows [n, 7] and costs [n], in standard units."""
    rng = np.random.default_rng(seed)
    x = np.hstack([rng.standard_normal((count, 3)), rng.uniform(size=(count, 4))])
    noise = rng.standard_normal(count)
    y = np.sin(x[:, 0]) + (x[:, 3:] - 0.4).sum(axis=1) ** 2 + 0.3 * noise
    return x, (y - y.mean()) / y.std()


def anywhere(covariance: Covariance, seed: int) -> np.ndarray:
    """Constants within their bounds, as the priors have them, [t]."""
    drawn = np.random.default_rng(seed).normal(covariance.modes, covariance.spreads)
    return np.clip(drawn, *covariance.bounds.T)


@pytest.mark.parametrize("form", reference.FORMS)
def test_the_misfit_and_its_gradient_are_scikit_learns(form: str) -> None:
    covariance = new_covariance(reference.FORMS[form], *LAYOUT)
    for seed, count in enumerate((1, 2, 9, 40, 120)):
        x, y = trials(count, seed) if count > 1 else (trials(2, seed)[0][:1], np.zeros(1))
        for draw in range(3):
            theta = anywhere(covariance, draw)
            expected, slopes = reference.misfit(covariance, x, y, theta)
            found, gradient = misfit(covariance, x, y, theta)
            assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
            assert_allclose(gradient, slopes, rtol=1e-6, atol=1e-6 * np.abs(slopes).max())


@pytest.mark.parametrize("form", reference.FORMS)
def test_the_gradient_is_that_of_the_misfit(form: str) -> None:
    covariance = new_covariance(reference.FORMS[form], *LAYOUT)
    x, y = trials(25, 0)
    theta = covariance.start
    slopes = approx_fprime(theta, lambda at: misfit(covariance, x, y, at)[0], 1e-6)
    assert_allclose(misfit(covariance, x, y, theta)[1], slopes, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("count", [2, 8, 30, 31, LIKELIHOOD_TRIALS])
@pytest.mark.parametrize("form", reference.FORMS)
def test_the_constants_are_those_that_scikit_learn_finds(form: str, count: int) -> None:
    covariance = new_covariance(reference.FORMS[form], *LAYOUT)
    x, y = trials(count, seed=count)
    assert_allclose(learn(covariance, x, y), reference.learned(covariance, x, y), atol=1e-6)


def test_without_a_cholesky_factor_the_misfit_is_infinite() -> None:
    covariance = Covariance((Term(0, 1, SLOPE, ()),), FEATURE_NOISE)
    x = np.array([[1.0], [1.0], [3.0]]) * 1e12
    theta = np.array([0.0, np.log(1e-4)])
    found, gradient = misfit(covariance, x, np.ones(3), theta)
    assert found == np.inf
    assert_allclose(gradient, 0.0)
