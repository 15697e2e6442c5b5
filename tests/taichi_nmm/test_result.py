"""The paper's two costs, by hand."""

import numpy as np
import pytest

from taichi_nmm import smooth_cost, walking_cost
from taichi_nmm.result import (
    COLUMNS,
    END_REASONS,
    NEEDED_BY,
    RESULT_DTYPE,
    known_numbers,
    unknown,
)
from tests.cases import cases


@cases("costs.toml", "cost", "ended", "values", "expected")
def test_costs(cost, ended, values, expected):
    rows = np.zeros(1, RESULT_DTYPE)
    rows["end_reason"] = END_REASONS.index(ended)
    for name, value in values.items():
        rows[name] = value
    found = {"smooth": smooth_cost, "walking": walking_cost}[cost]
    assert found(rows)[0] == pytest.approx(expected)
    assert found(rows[:0]).shape == (0,)


def test_what_was_not_measured_is_unknown_and_never_zero():
    """Of a walker that fell before a scored step, or got nowhere; who measured is not doubted."""
    rows = np.zeros(3, RESULT_DTYPE)
    rows["duration_s"], rows["step_duration_mean_s"] = (0.4, 5.0, 5.0), (0.0, 0.6, 0.6)
    rows["mean_speed_mps"], rows["step_count"] = (-0.25, 1.2, 1.2), (0, 1, 8)
    rows["step_length_mean_m"] = (0.0, 0.7, 0.7)
    # Only the left leg of the second walker stepped.
    rows["step_length_asymmetry"] = (
        0.0,
        1.0,
        0.02,
    )
    rows["trunk_mean_rad"], rows["human_deviation"] = 0.0, (9.0, 2.0, 1.0)
    measured = (
        "knee_peak_swing_rad",
        "human_deviation",
        "cost_of_transport_powered_jpkgpm",
        "hip_torque_peak_nm",
        "step_duration_mean_s",
    )
    for name in measured:
        assert unknown(name, rows).tolist() == [True, False, False]
    assert unknown("step_length_asymmetry", rows).tolist() == [True, True, False]
    for name in ("phi_printed", "step_count", "trunk_mean_rad", "mean_speed_mps"):
        assert not unknown(name, rows).any()  # zeros that are true
    known = known_numbers(rows[0])
    assert known["knee_peak_swing_rad"] is None and known["phi_printed"] == 0.0
    rows["mean_speed_mps"][2] = np.nan
    assert known_numbers(rows[2])["mean_speed_mps"] is None
    assert (
        set(COLUMNS["means"]["steps"])
        <= set(NEEDED_BY)
        <= set(RESULT_DTYPE.names or ())
    )
