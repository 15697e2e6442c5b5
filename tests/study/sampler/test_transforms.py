"""Costs on another scale."""

import numpy as np
from numpy.testing import assert_allclose

from study.sampler.transforms import log_excess

CLIFF = np.array([-1.0, 0.0, 2.0, 1e6, 2.0])


def test_it_is_the_logarithm_of_the_excess_in_typical_units() -> None:
    assert_allclose(
        log_excess(CLIFF), np.log1p((CLIFF + 1.0) / 3.0)
    )  # 3: the median of 1, 3, 3, 1e6


def test_the_order_is_kept() -> None:
    values = log_excess(CLIFF)
    assert np.array_equal(
        np.sign(np.subtract.outer(values, values)), np.sign(np.subtract.outer(CLIFF, CLIFF))
    )


def test_a_cliff_is_not_high() -> None:
    assert log_excess(CLIFF).max() < 20.0


def test_equal_costs_stay_equal_and_finite() -> None:
    assert_allclose(log_excess(np.full(4, 3.0)), 0.0)


def test_the_unit_of_cost_does_not_matter() -> None:
    assert_allclose(log_excess(1e3 * CLIFF - 7.0), log_excess(CLIFF))
