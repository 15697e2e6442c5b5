"""The published ranges are whole, and are those of walking."""

import numpy as np
import pytest

from study.pictures.gait_cycle import (
    DORSIFLEXION_DEG,
    EMG_ON_PERCENT,
    FORWARD_FORCE_BW,
    HIP_FLEXION_DEG,
    KNEE_FLEXION_DEG,
    PERCENT,
    VERTICAL_FORCE_BW,
    HumanRange,
)
from taichi_nmm.result import MUSCLES


@pytest.mark.parametrize(
    "human",
    [HIP_FLEXION_DEG, KNEE_FLEXION_DEG, DORSIFLEXION_DEG, VERTICAL_FORCE_BW, FORWARD_FORCE_BW],
)
def test_a_human_range_covers_the_stride_and_closes(human: HumanRange) -> None:
    percent = [row[0] for row in human.rows]
    mean, sd = human.at(PERCENT)
    assert percent[0] == 0 and percent[-1] == 100 and np.all(np.diff(percent) > 0)
    assert np.all(np.isfinite(mean)) and np.all(sd >= 0)
    assert mean[0] == pytest.approx(mean[-1], abs=0.05)


def test_human_ranges_have_the_landmarks_of_walking() -> None:
    knee, ankle = KNEE_FLEXION_DEG.at(PERCENT)[0], DORSIFLEXION_DEG.at(PERCENT)[0]
    up, forward = VERTICAL_FORCE_BW.at(PERCENT)[0], FORWARD_FORCE_BW.at(PERCENT)[0]
    assert 60 < knee.max() < 70 and 68 < PERCENT[knee.argmax()] < 76
    assert -25 < ankle.min() < -15 and 58 < PERCENT[ankle.argmin()] < 68
    # Over a stride each leg carries half the weight and gives back what it braked.
    assert up.mean() == pytest.approx(0.5, abs=0.03)
    assert forward.mean() == pytest.approx(0.0, abs=0.01)


def test_every_muscle_has_its_phases() -> None:
    assert set(EMG_ON_PERCENT) == set(MUSCLES)
    assert all(0 <= on < off <= 100 for phases in EMG_ON_PERCENT.values() for on, off in phases)
