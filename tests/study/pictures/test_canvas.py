"""The drawing surface of films."""

import numpy as np
import pytest

from study.pictures.scene import Canvas, capsule


def test_shapes_are_drawn_to_scale() -> None:
    canvas = Canvas((200, 100), left_m=10.0, bottom_m=-1.0, width_m=4.0)
    canvas.polygon(np.array([[11.0, -0.5], [13.0, -0.5], [13.0, 0.5], [11.0, 0.5]]), "#000000")
    canvas.finish()
    black = np.asarray(canvas.picture)[..., 0] < 128
    assert black.sum() == pytest.approx(100 * 50, rel=0.03)
    assert black[26:74, 51:149].all() and not black[:24].any() and not black[:, :49].any()
    assert canvas.place(11.0, 0.5) == pytest.approx((50.0, 25.0))


def test_a_capsule_has_its_width_and_round_ends() -> None:
    outline = capsule(np.array([0.0, 0.0]), np.array([0.0, 2.0]), 0.5)
    np.testing.assert_allclose(outline.min(axis=0), [-0.25, -0.25], atol=1e-12)
    np.testing.assert_allclose(outline.max(axis=0), [0.25, 2.25], atol=1e-12)
