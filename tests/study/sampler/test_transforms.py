"""Costs on other scales."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from study.sampler.transforms import transformed

CLIFF = np.array([-1.0, 0.0, 2.0, 1e6, 2.0])


@pytest.mark.parametrize("transform", ["none", "rank", "log"])
def test_the_order_is_kept(transform: str) -> None:
    values = transformed(CLIFF, transform)
    assert np.array_equal(
        np.sign(np.subtract.outer(values, values)), np.sign(np.subtract.outer(CLIFF, CLIFF))
    )


def test_ranks_do_not_know_the_height_of_a_cliff() -> None:
    lower = CLIFF.copy()
    lower[3] = 3.0
    assert_allclose(transformed(CLIFF, "rank"), transformed(lower, "rank"))
    assert transformed(CLIFF, "log").max() < 20.0


@pytest.mark.parametrize("transform", ["none", "rank", "log"])
def test_equal_costs_stay_equal_and_finite(transform: str) -> None:
    values = transformed(np.full(4, 3.0), transform)
    assert np.isfinite(values).all()
    assert np.ptp(values) == 0.0


def test_the_unit_of_cost_does_not_matter_to_ranks_and_logarithms() -> None:
    for transform in ("rank", "log"):
        scaled = transformed(1e3 * CLIFF - 7.0, transform)
        assert_allclose(scaled, transformed(CLIFF, transform))
