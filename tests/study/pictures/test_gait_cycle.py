"""The gait cycle: published ranges, strides of a known walk, the distance from people, the file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from study.pictures import gait_cycle as cycle
from study.pictures import write_gait_cycle
from study.pictures.gait_cycle import (
    PANELS,
    PERCENT,
    human_distances,
    strides_of,
    subtitle,
)
from study.pictures.style import PNG_DPI
from taichi_nmm.result import COLUMNS, MUSCLES, Trajectory
from tests.study.synthetic_gait import BODY_WEIGHT_N, GLIMPSE, STRIDE_S, WALK

COUNT = 4


@pytest.mark.parametrize("human", PANELS.values(), ids=list(PANELS))
def test_a_human_range_covers_the_stride_and_closes(human: cycle.Panel) -> None:
    percent = [row[0] for row in human.rows]
    mean, sd = human.at(PERCENT)
    assert percent[0] == 0 and percent[-1] == 100 and np.all(np.diff(percent) > 0)
    assert np.all(np.isfinite(mean)) and np.all(sd >= 0)
    assert mean[0] == pytest.approx(mean[-1], abs=0.05)


def test_human_ranges_have_the_landmarks_of_walking() -> None:
    _, knee, ankle, up, forward = (panel.at(PERCENT)[0] for panel in PANELS.values())
    assert 60 < knee.max() < 70 and 68 < PERCENT[knee.argmax()] < 76
    assert -25 < ankle.min() < -15 and 58 < PERCENT[ankle.argmin()] < 68
    # Over a stride each leg carries half the weight and gives back what it braked.
    assert up.mean() == pytest.approx(0.5, abs=0.03)
    assert forward.mean() == pytest.approx(0.0, abs=0.01)
    assert set(cycle.EMG_ON_PERCENT) == set(MUSCLES)
    spans = [span for phases in cycle.EMG_ON_PERCENT.values() for span in phases]
    assert all(0 <= on < off <= 100 for on, off in spans)


@pytest.mark.parametrize("side", [0, 1])
def test_strides_are_cut_at_heel_strikes_in_clinical_signs(side: int) -> None:
    strides = strides_of(WALK, BODY_WEIGHT_N, side)
    assert len(strides) == 3 and strides.enough
    np.testing.assert_allclose(strides.duration_s, STRIDE_S)
    inner = slice(5, -5)  # the synthetic walk has a corner at the strike
    for curves, human, tolerance in (
        (strides.hip_flexion_deg, PANELS["hip_flexion_deg"], 0.2),
        (strides.knee_flexion_deg, PANELS["knee_flexion_deg"], 0.5),
        (strides.dorsiflexion_deg, PANELS["dorsiflexion_deg"], 0.3),
    ):
        expected = human.at(PERCENT)[0]
        np.testing.assert_allclose(
            curves[:, inner], [expected[inner]] * 3, atol=tolerance
        )
    np.testing.assert_allclose(strides.take_off_percent, 60.0)


def test_forces_are_in_body_weights_and_belong_to_the_middle_of_their_interval() -> (
    None
):
    strides = strides_of(WALK, BODY_WEIGHT_N)
    half_interval = 100.0 * 0.005 / STRIDE_S
    expected = PANELS["vertical_bw"].at(np.minimum(PERCENT + half_interval, 100.0))[0]
    np.testing.assert_allclose(
        strides.vertical_bw.mean(axis=0)[5:-5], expected[5:-5], atol=0.01
    )
    assert strides.forward_bw.min() < -0.1 and strides.forward_bw.max() > 0.15
    strides = strides_of(GLIMPSE, BODY_WEIGHT_N)
    assert len(strides) == 0 and not strides.enough
    assert subtitle(strides).startswith("0 whole strides after settling: too few")
    assert "3 strides" in subtitle(strides_of(WALK, BODY_WEIGHT_N))


def test_the_numbers_of_people_in_a_result_are_those_of_their_curves() -> None:
    """Peaks of the curves, and the ankle at the strike and as the foot leaves the ground."""
    knee, ankle, up, forward = (
        np.array(PANELS[name].at(PERCENT))
        for name in (
            "knee_flexion_deg",
            "dorsiflexion_deg",
            "vertical_bw",
            "forward_bw",
        )
    )
    stance = knee[:, PERCENT < 40.0]
    expected = [
        *(np.radians(curve[:, curve[0].argmax()]) for curve in (knee, stance)),
        *(
            np.radians(ankle[:, percent == PERCENT].T[0]) * (-1.0, 1.0)
            for percent in (0.0, 62.0)
        ),
        up[:, up[0].argmax()],
        *(
            sign * forward[:, (sign * forward[0]).argmax()] * (1.0, sign)
            for sign in (-1.0, 1.0)
        ),
    ]
    least = np.radians(3.0), 0.05  # the tables' accuracy
    for (name, numbers), (mean, sd) in zip(
        COLUMNS["human"].items(), expected, strict=True
    ):
        np.testing.assert_allclose(
            numbers, [mean, max(sd, least[name.endswith("bw")])], atol=6e-4
        )


def shifted(shifts: dict[str, float], deviations: float = 0.0) -> cycle.Strides:
    """Strides whose mean is that of people, shifted by so much and by so many deviations."""
    curves = {}
    for name, panel in PANELS.items():
        mean, sd = panel.at(PERCENT)
        curves[name] = np.tile(
            mean + shifts.get(name, 0.0) + deviations * sd, (COUNT, 1)
        )
    curves["activation"] = np.zeros((7, COUNT, len(PERCENT)))
    return cycle.Strides(
        **curves, take_off_percent=np.zeros(0), duration_s=np.ones(COUNT)
    )


def test_a_shift_is_its_own_distance() -> None:
    found = human_distances(shifted({"hip_flexion_deg": 6.0, "vertical_bw": -0.1}))
    assert found["hip_flexion_deg"].rmse == pytest.approx(6.0)
    assert found["vertical_bw"].rmse == pytest.approx(0.1)
    assert 0.8 < found["hip_flexion_deg"].deviations < 0.95  # people: 6.5 to 7.2 deg
    assert found["knee_flexion_deg"].rmse == found["knee_flexion_deg"].deviations == 0.0
    found = human_distances(shifted({}, deviations=1.0))
    angles = [found[name].deviations for name in PANELS if name.endswith("_deg")]
    assert angles == pytest.approx([1.0, 1.0, 1.0])
    assert (
        0.0 < found["vertical_bw"].deviations < 1.0
    )  # less than the tables' accuracy in the air
    few = shifted({})
    assert human_distances(replace(few, duration_s=few.duration_s[:2])) == {}


@pytest.mark.slow
@pytest.mark.parametrize("trajectory", [WALK, GLIMPSE], ids=["walk", "glimpse"])
def test_a_gait_cycle_is_drawn(tmp_path: Path, trajectory: Trajectory) -> None:
    path = write_gait_cycle(
        tmp_path / "cycle.png", trajectory, BODY_WEIGHT_N, "a title"
    )
    picture = imread(path)
    assert picture.shape[:2] == tuple(
        round(inches * PNG_DPI) for inches in cycle.SIZE_IN[::-1]
    )
    assert picture[..., :3].std() > 0.03
