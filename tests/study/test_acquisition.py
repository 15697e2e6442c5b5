"""Expected improvement against its integral, and ties."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.stats import norm

from study.acquisition import argmax_random_tie, expected_improvement


@pytest.mark.parametrize("mean", [-2.0, 0.0, 1.3, 4.0])
@pytest.mark.parametrize("sd", [0.1, 1.0, 3.0])
def test_expected_improvement_is_its_integral(mean: float, sd: float) -> None:
    best = 0.5
    expected, _ = quad(
        lambda cost: (best - cost) * norm.pdf(cost, mean, sd), mean - 12 * sd, best, epsabs=1e-13
    )
    found = expected_improvement(np.array([mean]), np.array([sd]), best)
    assert_allclose(found, max(expected, 0.0), rtol=1e-6, atol=1e-12)


def test_without_doubt_the_improvement_is_the_gain() -> None:
    found = expected_improvement(np.array([1.0, 3.0]), np.zeros(2), best=2.0)
    assert_allclose(found, [1.0, 0.0])


def test_far_away_there_is_no_improvement_and_no_warning() -> None:
    assert expected_improvement(np.array([1e9]), np.array([1.0]), best=0.0)[0] == 0.0


def test_the_largest_value_wins() -> None:
    assert argmax_random_tie(np.array([0.1, 0.5, 0.3]), np.random.default_rng(0)) == 1


@pytest.mark.parametrize("value", [2.0, 0.0])
def test_equal_values_are_drawn_evenly(value: float) -> None:
    values = np.array([value, -1.0, value * (1 + 1e-12), value])
    rng = np.random.default_rng(0)
    counts = np.bincount([argmax_random_tie(values, rng) for _ in range(3000)], minlength=4)
    assert counts[1] == 0
    assert_allclose(counts[[0, 2, 3]], 1000, atol=120)
