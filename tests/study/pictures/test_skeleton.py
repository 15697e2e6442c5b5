"""Joints and muscles are drawn where the pose has them."""

import numpy as np
import pytest

from study.pictures.stick_figure import leg, muscle_outlines, trunk
from taichi_nmm.result import MUSCLES


def test_standing_upright_is_drawn_upright() -> None:
    q = np.array([2.0, 1.0, 0, 0, 0, 0, 0, 0, 0])
    joints = leg(q, 0)
    shoulder, head = trunk(q)
    np.testing.assert_allclose(joints.knee, [2.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(joints.ankle, [2.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(joints.heel, [1.96, 0.0], atol=1e-12)
    np.testing.assert_allclose(joints.ball, [2.16, 0.0], atol=1e-12)
    np.testing.assert_allclose(shoulder, [2.0, 1.5])
    assert head[1] > shoulder[1]


@pytest.mark.parametrize(
    ("column", "angle", "point", "moves"),
    [(3, 0.3, "knee", (-1, 1)), (4, 0.3, "ankle", (-1, 1)), (5, 0.3, "ball", (-1, -1))],
)
def test_positive_angles_turn_clockwise(
    column: int, angle: float, point: str, moves: tuple[int, int]
) -> None:
    q = np.zeros(9)
    before = getattr(leg(q, 0), point)
    q[column] = angle
    assert tuple(np.sign(getattr(leg(q, 0), point) - before)) == moves


def test_muscles_lie_along_their_bones() -> None:
    outlines = dict(zip(MUSCLES, muscle_outlines(np.array([0, 1.0, *[0.0] * 7]), 1), strict=True))
    assert outlines["TA"][:, 0].max() > 0 > outlines["SOL"][:, 0].min()
    assert outlines["VAS"][:, 0].max() > 0 > outlines["HAM"][:, 0].min()
    assert outlines["HFL"][:, 1].min() > 0.8 and outlines["SOL"][:, 1].max() < 0.5
    assert all(np.isfinite(outline).all() for outline in outlines.values())
