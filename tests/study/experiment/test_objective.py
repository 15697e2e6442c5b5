"""What became of a trial: its cost, whether it walked, and what is said of it."""

import numpy as np
import pytest

import taichi_nmm
from study.experiment.trials import attributes, costs, fell, finite, outcome_text, walked
from taichi_nmm.parameters import PUBLISHED_GAINS
from taichi_nmm.result import COMPLETED, DIVERGED, FELL, RESULT_DTYPE
from tests.study import fake_walker


def test_who_stands_or_falls_has_not_walked() -> None:
    rows = np.zeros(4, RESULT_DTYPE)
    rows["end_reason"] = COMPLETED, COMPLETED, FELL, DIVERGED
    rows["mean_speed_mps"] = 0.3, 0.29, 1.3, 1.3
    assert walked(rows).tolist() == [True, False, False, False]


def test_a_walker_that_diverged_has_a_finite_cost() -> None:
    rows = np.zeros(2, RESULT_DTYPE)
    rows["end_reason"] = DIVERGED
    rows["duration_s"] = 1.0
    rows["distance_m"] = rows["mean_speed_mps"] = np.nan, np.inf
    clean = finite(rows)
    assert np.isnan(rows["distance_m"][0])  # the caller's rows are as they were
    for cost in ("smooth", "walking"):
        values = costs(clean, cost)
        assert np.isfinite(values).all()
        assert values[0] == values[1]


def test_who_did_not_last_to_the_end_fell() -> None:
    rows = np.zeros(3, RESULT_DTYPE)
    rows["end_reason"] = COMPLETED, FELL, DIVERGED
    assert fell(rows).tolist() == [False, True, True]


def test_the_cost_is_the_configured_one() -> None:
    rows = fake_walker.simulate(PUBLISHED_GAINS).rows
    np.testing.assert_array_equal(costs(rows, "smooth"), taichi_nmm.smooth_cost(rows))
    np.testing.assert_array_equal(costs(rows, "walking"), taichi_nmm.walking_cost(rows))
    assert costs(rows, "smooth") != costs(rows, "walking")


def test_attributes_are_plain_values_and_make_a_sentence() -> None:
    rows = fake_walker.simulate(PUBLISHED_GAINS, duration_s=8.0).rows
    found = attributes(rows)
    assert {name: type(value) for name, value in found.items()} == {
        "duration_s": float, "distance_m": float, "mean_speed_mps": float, "end_reason": str,
        "walked": bool, "phi_printed": float, "phi_corrected": float, "survived_fraction": float,
    }  # fmt: skip
    assert found["distance_m"] == pytest.approx(found["duration_s"] * found["mean_speed_mps"])
    known = {"duration_s": 8.0, "distance_m": 10.0, "mean_speed_mps": 1.25}
    assert outcome_text(known | {"end_reason": "completed"}) == "walked 8.0 s, 10.0 m at 1.25 m/s"
    assert outcome_text(known | {"end_reason": "fell"}) == "fell after 8.0 s, 10.0 m at 1.25 m/s"
