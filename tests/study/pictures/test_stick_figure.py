"""Joints and muscles are drawn where the pose has them; the shown part of a walk."""

from dataclasses import replace

import numpy as np
import pytest

from storage.inputs.errors import InputError
from study.pictures import stick_figure
from study.pictures.scene import motion_of
from study.pictures.stick_figure import finite, leg, muscle_outlines
from study.pictures.strip import SHOWN_M, Shown, last_stretch
from taichi_nmm.result import MUSCLES, Trajectory
from taichi_nmm.terrain import flat
from tests.study.synthetic_gait import GLIMPSE, SPEED_MPS, WALK

TURNS = [(3, "knee", (-1, 1)), (4, "ankle", (-1, 1)), (5, "ball", (-1, -1))]


def test_standing_upright_is_drawn_upright() -> None:
    q = np.array([2.0, 1.0, 0, 0, 0, 0, 0, 0, 0])
    shoulder, head = stick_figure.trunk(q)
    expected = [[2.0, 1.0], [2.0, 0.5], [2.0, 0.0], [1.96, 0.0], [2.16, 0.0]]
    np.testing.assert_allclose(leg(q, 0).chain(), expected, atol=1e-12)
    np.testing.assert_allclose(shoulder, [2.0, 1.5])
    assert head[1] > shoulder[1]


@pytest.mark.parametrize(("column", "point", "moves"), TURNS)
def test_positive_angles_turn_clockwise(
    column: int, point: str, moves: tuple[int, int]
) -> None:
    q = np.zeros(9)
    before = getattr(leg(q, 0), point)
    q[column] = 0.3
    assert tuple(np.sign(getattr(leg(q, 0), point) - before)) == moves


def test_muscles_lie_along_their_bones() -> None:
    standing = np.array([0, 1.0, 0, 0, 0, 0, 0, 0, 0])
    outlines = dict(zip(MUSCLES, muscle_outlines(standing, 1), strict=True))
    assert outlines["TA"][:, 0].max() > 0 > outlines["SOL"][:, 0].min()
    assert outlines["VAS"][:, 0].max() > 0 > outlines["HAM"][:, 0].min()
    assert outlines["HFL"][:, 1].min() > 0.8 and outlines["SOL"][:, 1].max() < 0.5
    assert all(np.isfinite(outline).all() for outline in outlines.values())


def poses_of(walk: Trajectory) -> np.ndarray:
    return last_stretch(Shown("", "", walk), flat(), "black").poses_s


def test_the_end_of_the_walk_is_shown() -> None:
    poses_s = poses_of(WALK)
    assert poses_s[-1] == WALK.time_s[-1]
    assert np.ptp(poses_s) == pytest.approx(SHOWN_M / SPEED_MPS, abs=0.03)
    assert poses_of(GLIMPSE).tolist() == [GLIMPSE.time_s[0], GLIMPSE.time_s[-1]]
    assert np.ptp(motion_of(WALK, flat(), 2.0, 20).time_s) == pytest.approx(2.0)
    assert motion_of(GLIMPSE, flat(), 2.0, 20).time_s[0] == GLIMPSE.time_s[0]
    q = WALK.q.copy()
    q[700:, 3] = np.nan
    shown = finite(replace(WALK, q=q))
    assert len(shown.time_s) == len(shown.q) == len(shown.activation) == 700
    with pytest.raises(InputError, match="no finite sample"):
        finite(replace(WALK, q=np.full_like(q, np.nan)))
