"""The paper's two costs, by hand."""

from typing import Any

import numpy as np
import pytest

from taichi_nmm import smooth_cost, walking_cost
from taichi_nmm.result import COMPLETED, DIVERGED, FELL, RESULT_DTYPE

WALK = {"end_reason": COMPLETED, "distance_m": 120.0, "mean_speed_mps": 1.2}


@pytest.mark.parametrize(("cost", "values", "expected"), [
    (smooth_cost, {"duration_s": 100.0, "distance_m": 130.0, "mean_speed_mps": 1.3},
     1 / 101 + 0.3 / 131),
    # The speed's error is a deviation, and a backward fall has no pole.
    (smooth_cost, {"duration_s": 9.0, "distance_m": 9.0, "mean_speed_mps": 1.0}, 0.133),
    (smooth_cost, {"duration_s": 9.0, "distance_m": 9.0, "mean_speed_mps": 1.6}, 0.133),
    (smooth_cost, {"duration_s": 1.0, "distance_m": -1.0, "mean_speed_mps": -1.0}, 0.823),
    (walking_cost, {"end_reason": FELL, "distance_m": 42.0, "mean_speed_mps": 1.3}, 258.0),
    (walking_cost, {"end_reason": DIVERGED, "distance_m": 42.0, "mean_speed_mps": 1.3}, 258.0),
    (walking_cost, {"end_reason": FELL, "distance_m": -1.0}, 300.0),
    (walking_cost, {**WALK, "cost_of_transport_jpkgpm": 5.0}, 15.0),
    (walking_cost, {"end_reason": COMPLETED}, 130.0),  # stood still
])  # fmt: skip
def test_costs(cost: Any, values: dict[str, float], expected: float) -> None:
    rows = np.zeros(1, RESULT_DTYPE)
    for name, value in values.items():
        rows[name] = value
    assert cost(rows)[0] == pytest.approx(expected)
    assert cost(rows[:0]).shape == (0,)
