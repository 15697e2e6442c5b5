"""The gait cycle: published ranges, strides of a known walk, the distance from people, the file."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from study.pictures import gait_cycle as cycle
from study.pictures import write_gait_cycle
from study.pictures.gait_cycle import (
    OF_PEOPLE,
    PERCENT,
    human_distances,
    strides_of,
    subtitle,
)
from study.pictures.style import PNG_DPI
from taichi_nmm.result import COLUMNS, MUSCLES
from tests.study.synthetic_gait import BODY_WEIGHT_N, GLIMPSE, STRIDE_S, WALK

PEOPLE = {name: np.array(panel.at(PERCENT)) for name, panel in OF_PEOPLE.items()}
"""Mean and standard deviation over the stride, [2, p]."""

MEAN = {name: mean for name, (mean, _) in PEOPLE.items()}


@pytest.mark.parametrize("name", OF_PEOPLE)
def test_a_human_range_covers_the_stride_and_closes(name):
    percent = [row[0] for row in OF_PEOPLE[name].rows]
    mean, sd = PEOPLE[name]
    assert percent[0] == 0 and percent[-1] == 100 and np.all(np.diff(percent) > 0)
    assert np.all(np.isfinite(mean)) and np.all(sd >= 0)
    assert mean[0] == pytest.approx(mean[-1], abs=0.05)


def test_human_ranges_have_the_landmarks_of_walking():
    knee, ankle = MEAN["knee_flexion_deg"], MEAN["dorsiflexion_deg"]
    assert 60 < knee.max() < 70 and 68 < PERCENT[knee.argmax()] < 76
    assert -25 < ankle.min() < -15 and 58 < PERCENT[ankle.argmin()] < 68
    # Over a stride each leg carries half the weight and gives back what it braked.
    assert MEAN["vertical_bw"].mean() == pytest.approx(0.5, abs=0.03)
    assert MEAN["forward_bw"].mean() == pytest.approx(0.0, abs=0.01)
    assert set(cycle.PANELS) == {*OF_PEOPLE, *MUSCLES}
    for muscle in MUSCLES:
        spans = cycle.PANELS[muscle].on_percent
        assert spans and all(0 <= on < off <= 100 for on, off in spans)


@pytest.mark.parametrize("side", [0, 1])
def test_strides_are_cut_at_heel_strikes_in_clinical_signs(side):
    strides = strides_of(WALK, BODY_WEIGHT_N, side)
    assert len(strides) == 3 and strides.enough
    np.testing.assert_allclose(strides.duration_s, STRIDE_S)
    inner = slice(5, -5)  # the synthetic walk has a corner at the strike
    tolerances = {
        "hip_flexion_deg": 0.2,
        "knee_flexion_deg": 0.5,
        "dorsiflexion_deg": 0.3,
    }
    for name, tolerance in tolerances.items():
        found, expected = (
            strides.curves[name][:, inner],
            np.tile(MEAN[name][inner], (3, 1)),
        )
        np.testing.assert_allclose(found, expected, atol=tolerance)
    np.testing.assert_allclose(strides.take_off_percent, 60.0)


def test_forces_are_in_body_weights_and_belong_to_the_middle_of_their_interval():
    strides = strides_of(WALK, BODY_WEIGHT_N)
    half_interval = 100.0 * 0.005 / STRIDE_S
    later = np.minimum(PERCENT + half_interval, 100.0)
    expected, _ = OF_PEOPLE["vertical_bw"].at(later)
    mean = strides.mean("vertical_bw")
    np.testing.assert_allclose(mean[5:-5], expected[5:-5], atol=0.01)
    forward = strides.curves["forward_bw"]
    assert forward.min() < -0.1 and forward.max() > 0.15
    assert "3 strides" in subtitle(strides)


def test_of_too_few_strides_nothing_is_known():
    strides = strides_of(GLIMPSE, BODY_WEIGHT_N)
    assert len(strides) == 0 and not strides.enough
    assert subtitle(strides).startswith("0 whole strides after settling: too few")
    assert human_distances(strides) == {} and strides.toe_off_percent is None
    assert np.isnan(strides.band("SOL")).all()


def test_the_numbers_of_people_in_a_result_are_those_of_their_curves():
    """Peaks of the curves, and the ankle at the strike and as the foot leaves the ground."""
    knee, ankle = (
        np.radians(PEOPLE[name]) for name in ("knee_flexion_deg", "dorsiflexion_deg")
    )
    up, forward = PEOPLE["vertical_bw"], PEOPLE["forward_bw"]
    down = -1.0, 1.0  # the sign of a mean, not of its deviation
    expected = [
        knee[:, knee[0].argmax()],
        knee[:, knee[0, PERCENT < 40.0].argmax()],
        ankle[:, PERCENT == 0.0].T[0] * down,
        ankle[:, PERCENT == 62.0].T[0] * down,
        up[:, up[0].argmax()],
        forward[:, forward[0].argmin()] * down,
        forward[:, forward[0].argmax()],
    ]
    for (name, numbers), (mean, sd) in zip(
        COLUMNS["human"].items(), expected, strict=True
    ):
        accuracy = 0.05 if name.endswith("bw") else np.radians(3.0)  # of the tables
        np.testing.assert_allclose(numbers, [mean, max(sd, accuracy)], atol=6e-4)


def shifted(shift=0.0, deviations=0.0):
    """Four strides whose mean is that of people, shifted, and by so many deviations."""
    curves = {
        name: np.tile(mean + shift + deviations * sd, (4, 1))
        for name, (mean, sd) in PEOPLE.items()
    }
    return cycle.Strides(
        curves=curves, take_off_percent=np.zeros(0), duration_s=np.ones(4)
    )


def test_a_shift_is_its_own_distance():
    assert set(human_distances(shifted()).values()) == {cycle.Distance(0.0, 0.0)}
    found = human_distances(shifted(6.0))
    assert [each.rmse for each in found.values()] == pytest.approx([6.0] * 5)
    assert 0.8 < found["hip_flexion_deg"].deviations < 0.95  # people: 6.5 to 7.2 deg
    found = human_distances(shifted(deviations=1.0))
    angles = [found[name].deviations for name in found if name.endswith("_deg")]
    assert angles == pytest.approx([1.0, 1.0, 1.0])
    # Less than the tables' accuracy in the air:
    assert 0.0 < found["vertical_bw"].deviations < 1.0
    few = shifted()
    assert human_distances(replace(few, duration_s=few.duration_s[:2])) == {}


@pytest.mark.slow
@pytest.mark.parametrize("trajectory", [WALK, GLIMPSE], ids=["walk", "glimpse"])
def test_a_gait_cycle_is_drawn(tmp_path, trajectory):
    file = tmp_path / "cycle.png"
    picture = imread(write_gait_cycle(file, trajectory, BODY_WEIGHT_N, "a title"))
    width_in, height_in = cycle.SIZE_IN
    size_px = (round(height_in * PNG_DPI), round(width_in * PNG_DPI))
    assert picture.shape[:2] == size_px and picture[..., :3].std() > 0.03
