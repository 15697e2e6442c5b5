"""A walk whose every number is known, cut into strides."""

import numpy as np

from study.pictures.gait_cycle import (
    DORSIFLEXION_DEG,
    HIP_FLEXION_DEG,
    KNEE_FLEXION_DEG,
    PERCENT,
    VERTICAL_FORCE_BW,
    left_strides,
    subtitle,
)
from tests.study import synthetic_gait
from tests.study.synthetic_gait import BODY_WEIGHT_N, STRIDE_S

WALK = synthetic_gait.walk()
GLIMPSE = synthetic_gait.walk(0.3)


def test_strides_are_cut_at_left_heel_strikes_in_clinical_signs() -> None:
    strides = left_strides(WALK, BODY_WEIGHT_N)
    assert len(strides) == 3 and strides.enough
    np.testing.assert_allclose(strides.duration_s, STRIDE_S)
    inner = slice(5, -5)  # the synthetic walk has a corner at the strike
    for curves, human, tolerance in (
        (strides.hip_flexion_deg, HIP_FLEXION_DEG, 0.2),
        (strides.knee_flexion_deg, KNEE_FLEXION_DEG, 0.5),
        (strides.dorsiflexion_deg, DORSIFLEXION_DEG, 0.3),
    ):
        expected = human.at(PERCENT)[0]
        np.testing.assert_allclose(curves[:, inner], [expected[inner]] * 3, atol=tolerance)
    np.testing.assert_allclose(strides.take_off_percent, 60.0)


def test_forces_are_in_body_weights_and_belong_to_the_middle_of_their_interval() -> None:
    strides = left_strides(WALK, BODY_WEIGHT_N)
    half_interval = 100.0 * 0.005 / STRIDE_S
    expected = VERTICAL_FORCE_BW.at(np.minimum(PERCENT + half_interval, 100.0))[0]
    np.testing.assert_allclose(strides.vertical_bw.mean(axis=0)[5:-5], expected[5:-5], atol=0.01)
    assert strides.forward_bw.min() < -0.1 and strides.forward_bw.max() > 0.15


def test_too_few_strides_are_said_in_words() -> None:
    strides = left_strides(GLIMPSE, BODY_WEIGHT_N)
    assert len(strides) == 0 and not strides.enough
    assert subtitle(strides).startswith("0 whole strides after settling: too few")
    assert "3 strides" in subtitle(left_strides(WALK, BODY_WEIGHT_N))
