"""The paper's two costs, by hand."""

import numpy as np
import pytest

from taichi_nmm import smooth_cost, walking_cost
from taichi_nmm.result import COMPLETED, DIVERGED, FELL, RESULT_DTYPE


def row(**values: float) -> np.ndarray:  # type: ignore[type-arg]
    rows = np.zeros(1, RESULT_DTYPE)
    for name, value in values.items():
        rows[name] = value
    return rows


def test_smooth_cost_of_a_perfect_walk() -> None:
    rows = row(duration_s=100.0, distance_m=130.0, mean_speed_mps=1.3)
    assert smooth_cost(rows)[0] == pytest.approx(1 / 101 + 0.3 / 131)


def test_smooth_cost_takes_the_speed_error_as_a_deviation() -> None:
    slow = smooth_cost(row(duration_s=9.0, distance_m=9.0, mean_speed_mps=1.0))[0]
    fast = smooth_cost(row(duration_s=9.0, distance_m=9.0, mean_speed_mps=1.6))[0]
    assert slow == pytest.approx(fast) == pytest.approx(0.1 + 0.03 + 0.003)


def test_a_backward_fall_has_no_pole() -> None:
    rows = row(duration_s=1.0, distance_m=-1.0, mean_speed_mps=-1.0)
    assert smooth_cost(rows)[0] == pytest.approx(0.5 + 0.3 + 0.023)
    assert walking_cost(rows[:0]).shape == (0,)


@pytest.mark.parametrize("reason", [FELL, DIVERGED])
def test_walking_cost_of_a_fall(reason: int) -> None:
    rows = row(end_reason=reason, distance_m=42.0, mean_speed_mps=1.3)
    assert walking_cost(rows)[0] == 258.0


def test_walking_cost_of_a_walk_and_of_standing_still() -> None:
    walk = row(
        end_reason=COMPLETED, distance_m=120.0, mean_speed_mps=1.2, cost_of_transport_jpkgpm=5.0
    )
    assert walking_cost(walk)[0] == pytest.approx(15.0)
    assert walking_cost(row(end_reason=COMPLETED))[0] == pytest.approx(130.0)
