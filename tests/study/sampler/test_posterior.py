"""The posterior against scikit-learn's, exact and fast, and what fitting learns."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from study.sampler.acquisition import along_feature
from study.sampler.gp import (
    BLOCK,
    LIKELIHOOD_TRIALS,
    Covariance,
    Posterior,
    condition,
    learn,
    new_covariance,
)
from study.sampler.transforms import Points
from tests.study.sampler import reference

LAYOUT = (3, 4, 4)
EXACT = 1e-8
FAST = 1e-4  # of the prior's scale


def covariance_of(form: str, layout: tuple[int, int, int] = LAYOUT) -> Covariance:
    return new_covariance(reference.FORMS[form], *layout)


def some_points(count: int, seed: int) -> Points:
    rng = np.random.default_rng(seed)
    return Points(rng.standard_normal((count, 3)), rng.uniform(size=(count, 4)))


def costs(points: Points, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(len(points))
    smooth = np.sin(points.features[:, 0]) + (points.coordinates - 0.4).sum(axis=1) ** 2
    return 50.0 + 20.0 * smooth + noise


def fitted(covariance: Covariance, count: int, *, fast: bool, noisy: bool = True) -> Posterior:
    points = some_points(count, seed=1)
    x, y = points.matrix(), costs(points)
    return condition(covariance, learn(covariance, x, y), x, y, noisy=noisy, fast=fast)


def oracle(posterior: Posterior, candidates: Points) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance by scikit-learn, of the same kernel on the same trials."""
    mean, sd = reference.of_posterior(posterior).predict(candidates.matrix(), return_std=True)
    mean, sd = posterior.cost_mean + posterior.cost_sd * mean, posterior.cost_sd * sd
    return mean, sd**2


def prior_variance(posterior: Posterior, x: np.ndarray) -> np.ndarray:
    """Before any trial, noise included."""
    return (
        posterior.cost_sd**2
        * (posterior.covariance.variance(posterior.theta, x) + posterior.noise)
        * np.ones(len(x))
    )


@pytest.mark.parametrize("form", reference.FORMS)
def test_the_exact_posterior_is_scikit_learns(form: str) -> None:
    posterior = fitted(covariance_of(form), 40, fast=False)
    candidates = some_points(2 * BLOCK + 17, seed=2)
    expected_mean, expected_variance = oracle(posterior, candidates)
    found_mean, found_variance = posterior.predict(candidates)
    assert_allclose(found_mean, expected_mean, rtol=EXACT)
    assert_allclose(found_variance, expected_variance, rtol=EXACT)
    assert_allclose(posterior.mean(candidates), expected_mean, rtol=EXACT)


@pytest.mark.parametrize("form", reference.FORMS)
def test_the_fast_posterior_is_nearly_scikit_learns(form: str) -> None:
    posterior = fitted(covariance_of(form), 100, fast=True)
    candidates = some_points(2 * BLOCK + 17, seed=2)
    expected_mean, expected_variance = oracle(posterior, candidates)
    found_mean, found_variance = posterior.predict(candidates)
    prior = prior_variance(posterior, candidates.matrix())
    assert np.all(np.abs(found_mean - expected_mean) < FAST * np.sqrt(prior))
    assert np.all(np.abs(found_variance - expected_variance) < FAST * prior)


@pytest.mark.parametrize("count", [1, 2, 7, 1000])
def test_any_number_of_trials_will_do(count: int) -> None:
    posterior = fitted(covariance_of("euclidean"), count, fast=False)
    candidates = some_points(50, seed=2)
    mean, variance = oracle(posterior, candidates)
    assert_allclose(posterior.predict(candidates)[0], mean, rtol=EXACT)
    assert_allclose(posterior.predict(candidates)[1], variance, rtol=EXACT)


def along_a_feature(count: int, *, fast: bool) -> Posterior:
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 4, (count, 1))
    y = 5.0 + 2.0 * np.sin(x[:, 0]) + 0.3 * rng.standard_normal(count)
    covariance = covariance_of("rbf", (1, 0, 2))
    return condition(covariance, learn(covariance, x, y), x, y, noisy=True, fast=fast)


@pytest.mark.parametrize(("fast", "tolerance"), [(False, EXACT), (True, FAST)])
@pytest.mark.parametrize("values", [30, 20_000])
def test_along_one_feature(fast: bool, tolerance: float, values: int) -> None:
    posterior = along_a_feature(60, fast=fast)
    feature = np.random.default_rng(1).choice(np.linspace(-3, 8, values), 20_000)[:, None]
    candidates = Points(feature, np.empty((len(feature), 0)))
    expected_mean, expected_variance = oracle(posterior, candidates)
    mean, variance = (
        along_feature(
            posterior, candidates, lambda points, which=which: posterior.predict(points)[which]
        )
        for which in range(2)
    )
    prior = prior_variance(posterior, feature)
    assert np.max(np.abs(mean - expected_mean) / np.sqrt(prior)) < tolerance
    assert np.max(np.abs(variance - expected_variance) / prior) < tolerance


def test_believing_adds_trials_and_keeps_constants() -> None:
    posterior = fitted(covariance_of("rbf"), 20, fast=False)
    more = some_points(3, seed=5)
    believed = posterior.believing(more)
    candidates = some_points(200, seed=6)
    mean, variance = posterior.predict(candidates)
    assert_allclose(believed.theta, posterior.theta)
    assert_allclose(believed.predict(candidates)[0], mean, rtol=1e-6)
    assert np.all(believed.predict(candidates)[1] <= variance * (1 + 1e-9))
    assert believed.predict(more)[1].sum() < posterior.predict(more)[1].sum()


def test_the_spread_of_equal_features_is_learned_as_noise() -> None:
    x = np.repeat([[0.0], [1.0], [2.0]], 30, axis=0)
    y = 10.0 * x[:, 0] + 1.5 * np.random.default_rng(2).standard_normal(90)
    covariance = covariance_of("rbf", (1, 0, 1))
    posterior = condition(covariance, learn(covariance, x, y), x, y, noisy=True, fast=False)
    mean, variance = posterior.predict(Points(x[::30], np.empty((3, 0))))
    assert_allclose(mean, [0, 10, 20], atol=1.0)
    assert_allclose(np.sqrt(variance), 1.5, rtol=0.25)


def test_equal_costs_are_no_accident() -> None:
    points = some_points(2, seed=0)
    covariance = covariance_of("additive")
    x, y = points.matrix(), np.array([3.0, 3.0])
    mean, variance = condition(
        covariance, learn(covariance, x, y), x, y, noisy=True, fast=True
    ).predict(points)
    assert_allclose(mean, 3.0)
    assert np.isfinite(variance).all()


def test_the_unit_of_cost_does_not_matter() -> None:
    points, candidates = some_points(20, seed=1), some_points(50, seed=2)
    x, y, covariance = points.matrix(), costs(points), covariance_of("additive")
    ours, scaled = (
        condition(covariance, learn(covariance, x, c), x, c, noisy=True, fast=False).predict(
            candidates
        )
        for c in (y, 1e6 * y - 7e6)
    )
    assert_allclose(scaled[0], 1e6 * ours[0] - 7e6, rtol=1e-3)
    assert_allclose(scaled[1], 1e12 * ours[1], rtol=1e-2)


def test_constants_are_learned_from_a_part_of_many_trials() -> None:
    points = some_points(2 * LIKELIHOOD_TRIALS, seed=1)
    x, y = points.matrix(), costs(points)
    covariance = covariance_of("rbf")
    assert_allclose(learn(covariance, x, y), learn(covariance, x, y))
    assert np.isfinite(learn(covariance, x, y)).all()
