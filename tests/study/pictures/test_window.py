"""Which part of a walk is shown."""

from dataclasses import replace

import numpy as np
import pytest

from study.pictures.stick_figure import finite, last_metres, last_seconds
from taichi_nmm.errors import InputError
from tests.study import synthetic_gait
from tests.study.synthetic_gait import SPEED_MPS

WALK = synthetic_gait.walk()
GLIMPSE = synthetic_gait.walk(0.3)


def test_the_end_of_the_walk_is_shown() -> None:
    start_s, end_s = last_metres(WALK, 2.6)
    assert end_s == WALK.time_s[-1]
    assert end_s - start_s == pytest.approx(2.6 / SPEED_MPS, abs=0.03)
    assert last_metres(GLIMPSE, 100.0) == (GLIMPSE.time_s[0], GLIMPSE.time_s[-1])
    assert last_seconds(WALK, 2.0) == (WALK.time_s[-1] - 2.0, WALK.time_s[-1])


def test_a_walker_that_diverged_is_shown_until_it_did() -> None:
    q = WALK.q.copy()
    q[700:, 3] = np.nan
    shown = finite(replace(WALK, q=q))
    assert len(shown.time_s) == len(shown.q) == len(shown.activation) == 700
    with pytest.raises(InputError, match="no finite sample"):
        finite(replace(WALK, q=np.full_like(q, np.nan)))
