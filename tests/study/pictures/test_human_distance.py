"""How far a gait is from people: nothing for the mean of people itself, known numbers beside it."""

from dataclasses import replace

import numpy as np
import pytest

from study.pictures.gait_cycle import PANELS, PERCENT, Strides, human_distances

NAMES = tuple(PANELS)
COUNT = 4


def strides(shifts: dict[str, float], deviations: float = 0.0) -> Strides:
    """Strides whose mean is that of people, shifted by so much and by so many deviations."""
    curves = {}
    for name in NAMES:
        mean, sd = PANELS[name].human.at(PERCENT)
        curves[name] = np.tile(mean + shifts.get(name, 0.0) + deviations * sd, (COUNT, 1))
    return Strides(
        **curves,
        activation=np.zeros((7, COUNT, len(PERCENT))),
        take_off_percent=np.zeros(0),
        duration_s=np.ones(COUNT),
    )


def test_the_mean_of_people_is_at_no_distance() -> None:
    for distance in human_distances(strides({})).values():
        assert distance.rmse == 0.0 and distance.deviations == 0.0


def test_a_shift_is_its_own_distance() -> None:
    found = human_distances(strides({"hip_flexion_deg": 6.0, "vertical_bw": -0.1}))
    assert found["hip_flexion_deg"].rmse == pytest.approx(6.0)
    assert found["vertical_bw"].rmse == pytest.approx(0.1)
    assert 0.8 < found["hip_flexion_deg"].deviations < 0.95  # people: 6.5 to 7.2 deg
    assert found["knee_flexion_deg"].rmse == 0.0


def test_one_deviation_of_people_is_one() -> None:
    found = human_distances(strides({}, deviations=1.0))
    for name in ("hip_flexion_deg", "knee_flexion_deg", "dorsiflexion_deg"):
        assert found[name].deviations == pytest.approx(1.0)
    assert 0.0 < found["vertical_bw"].deviations < 1.0  # less than the tables' accuracy in the air


def test_too_few_strides_have_no_distance() -> None:
    few = strides({})
    assert human_distances(replace(few, duration_s=few.duration_s[:2])) == {}
