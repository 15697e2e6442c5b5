"""The process against scikit-learn, and what it learns."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn.gaussian_process import GaussianProcessRegressor

from study.gaussian_process import BLOCK, ScoreProcess


def trials(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    score = rng.uniform(-1, 4, count)
    return score, 5.0 + 2.0 * np.sin(score) + 0.3 * rng.standard_normal(count)


@pytest.mark.parametrize("count", [1, 2, 7, 60])
def test_posterior_is_scikit_learns(count: int) -> None:
    score, cost = trials(count)
    process = ScoreProcess.fit(score, cost, seed=1)
    oracle = GaussianProcessRegressor(
        kernel=process.regressor.kernel_, alpha=0.0, optimizer=None, normalize_y=True
    ).fit(score[:, None], cost)
    candidates = np.linspace(-3, 8, 2 * BLOCK + 17)
    mean, sd = process.predict(candidates)
    expected_mean, expected_sd = oracle.predict(candidates[:, None], return_std=True)
    assert_allclose(mean, expected_mean, rtol=1e-8)
    assert_allclose(sd**2, expected_sd**2, rtol=1e-8)


def test_the_spread_of_equal_scores_is_learned_as_noise() -> None:
    rng = np.random.default_rng(2)
    score = np.repeat([0.0, 1.0, 2.0], 30)
    cost = 10.0 * score + 1.5 * rng.standard_normal(90)
    mean, sd = ScoreProcess.fit(score, cost, seed=1).predict(np.array([0.0, 1.0, 2.0]))
    assert_allclose(mean, [0, 10, 20], atol=1.0)
    assert_allclose(sd, 1.5, rtol=0.25)


def test_equal_costs_are_no_accident() -> None:
    mean, sd = ScoreProcess.fit(np.array([0.0, 1.0]), np.array([3.0, 3.0]), seed=1).predict(
        np.array([0.5])
    )
    assert_allclose(mean, 3.0)
    assert np.isfinite(sd).all()


def test_the_unit_of_cost_does_not_matter() -> None:
    score, cost = trials(20)
    candidates = np.linspace(-1, 4, 50)
    mean, sd = ScoreProcess.fit(score, cost, seed=1).predict(candidates)
    scaled_mean, scaled_sd = ScoreProcess.fit(score, 1e6 * cost - 7e6, seed=1).predict(candidates)
    assert_allclose(scaled_mean, 1e6 * mean - 7e6, rtol=1e-4)
    assert_allclose(scaled_sd, 1e6 * sd, rtol=1e-4)
