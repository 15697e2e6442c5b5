"""The log of expected improvement against its integral and its definition, and ties."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.stats import norm

from study.sampler.acquisition import _exact_log_h, argmax_random_tie, log_expected_improvement


def expected_improvement(mean: np.ndarray, sd: np.ndarray, best: float) -> np.ndarray:
    """As Jones, Schonlau, Welch 1998 have it, eq. 15; it underflows."""
    z = (best - mean) / sd
    return np.asarray((best - mean) * norm.cdf(z) + sd * norm.pdf(z))


@pytest.mark.parametrize("mean", [-2.0, 0.0, 1.3, 4.0])
@pytest.mark.parametrize("sd", [0.5, 1.0, 3.0])
def test_expected_improvement_is_its_integral(mean: float, sd: float) -> None:
    best = 0.5
    expected, _ = quad(
        lambda cost: (best - cost) * norm.pdf(cost, mean, sd), mean - 12 * sd, best, epsabs=1e-15
    )
    found = np.exp(log_expected_improvement(np.array([mean]), np.array([sd]), best))
    assert_allclose(found, expected, rtol=1e-6, atol=1e-13)


def test_the_largest_value_wins() -> None:
    assert argmax_random_tie(np.array([0.1, 0.5, 0.3]), np.random.default_rng(0)) == 1


@pytest.mark.parametrize("value", [2.0, 0.0])
def test_equal_values_are_drawn_evenly(value: float) -> None:
    values = np.array([value, -1.0, value * (1 + 1e-12), value])
    rng = np.random.default_rng(0)
    counts = np.bincount([argmax_random_tie(values, rng) for _ in range(3000)], minlength=4)
    assert counts[1] == 0
    assert_allclose(counts[[0, 2, 3]], 1000, atol=120)


@pytest.mark.parametrize("sd", [0.1, 1.0, 3.0])
def test_log_improvement_is_the_logarithm(sd: float) -> None:
    mean = np.linspace(-3.0, 3.0, 61) * sd * 5
    spread = np.full_like(mean, sd)
    improvement = expected_improvement(mean, spread, 0.5)
    found = log_expected_improvement(mean, spread, 0.5)
    clear = improvement > 1e-9 * sd  # below, the plain one loses digits
    assert clear.sum() > 20
    assert_allclose(found[clear], np.log(improvement[clear]), rtol=1e-6, atol=1e-6)


def test_log_improvement_is_finite_and_falls_where_the_plain_one_underflows() -> None:
    mean = np.concatenate([np.linspace(0, 50, 400), np.logspace(1.71, 9, 400)])
    found = log_expected_improvement(mean, np.ones_like(mean), best=0.0)
    assert np.isfinite(found).all()
    assert np.all(np.diff(found) < 0)
    assert expected_improvement(mean[-1:], np.ones(1), best=0.0)[0] == 0.0


def test_log_improvement_between_nodes_is_what_it_is_at_them() -> None:
    z = np.random.default_rng(0).uniform(-50.0, 20.0, 100_000)
    found = log_expected_improvement(-z, np.ones_like(z), best=0.0)
    assert_allclose(found, _exact_log_h(z), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("z", [-1.5, -8.0, -30.0, -900.0, -1100.0, -2e6])
def test_log_improvement_has_the_tail_of_its_series(z: float) -> None:
    found = log_expected_improvement(np.array([-z]), np.ones(1), best=0.0)[0]
    if z > -30:
        exact, _ = quad(lambda t: (z - t) * norm.pdf(t), z - 12, z, epsabs=0, epsrel=1e-12)
        assert_allclose(found, np.log(exact), rtol=1e-8)
    else:  # phi(z) / z^2 (1 - 3/z^2 + ...)
        assert_allclose(found, norm.logpdf(z) - 2 * np.log(-z) + np.log1p(-3 / z**2), rtol=1e-7)


def test_without_doubt_the_log_improvement_is_that_of_the_gain() -> None:
    with np.errstate(all="raise"):
        found = log_expected_improvement(np.array([1.0, 3.0]), np.zeros(2), best=2.0)
    assert found.tolist() == [0.0, -np.inf]


def test_infinite_values_can_win_or_lose() -> None:
    rng = np.random.default_rng(0)
    assert argmax_random_tie(np.array([-np.inf, 3.0]), rng) == 1
    assert {argmax_random_tie(np.full(3, -np.inf), rng) for _ in range(40)} == {0, 1, 2}
