"""The frames of a film, and their drawing surface."""

from dataclasses import replace

import numpy as np
import pytest

from study.pictures.scene import LARGE, SMALL, Canvas, Film, capsule, frames
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import flat
from tests.study import synthetic_gait

WALK = synthetic_gait.walk()


def test_shapes_are_drawn_to_scale_and_a_capsule_has_round_ends() -> None:
    canvas = Canvas((200, 100), left_m=10.0, bottom_m=-1.0, width_m=4.0)
    canvas.polygon(np.array([[11.0, -0.5], [13.0, -0.5], [13.0, 0.5], [11.0, 0.5]]), "#000000")
    canvas.finish()
    black = np.asarray(canvas.picture)[..., 0] < 128
    assert black.sum() == pytest.approx(100 * 50, rel=0.03)
    assert black[26:74, 51:149].all() and not black[:24].any() and not black[:, :49].any()
    assert canvas.place(11.0, 0.5) == pytest.approx((50.0, 25.0))
    outline = capsule(np.array([0.0, 0.0]), np.array([0.0, 2.0]), 0.5)
    np.testing.assert_allclose(outline.min(axis=0), [-0.25, -0.25], atol=1e-12)
    np.testing.assert_allclose(outline.max(axis=0), [0.25, 2.25], atol=1e-12)


def picture(film: Film, title: str = "", walk: Trajectory = WALK) -> np.ndarray:
    """The last frame of a film, [height, width, 3]."""
    *_, last = frames(walk, flat(), 0.2, title, film)
    width, height = film.size_px
    return np.frombuffer(last, np.uint8).reshape(height, width, 3)


@pytest.mark.parametrize("film", [LARGE, SMALL])
def test_the_walker_stands_on_the_ground_in_the_middle_of_the_frame(film: Film) -> None:
    frame = picture(film)
    width, height = film.size_px
    ground = np.all(frame == (0xCF, 0xC8, 0xBC), axis=-1)
    assert ground[int(0.9 * height), int(0.03 * width)] and not ground[: int(0.8 * height)].any()
    shown = np.any(frame[int(0.3 * height) : int(0.8 * height), : int(0.88 * width)] < 250, axis=-1)
    columns = np.flatnonzero(shown.any(axis=0)) / width
    assert 0.25 < columns.min() < 0.45 < columns.max() < 0.65


def test_active_muscles_are_darker() -> None:
    def darkness(activation: float) -> float:
        walk = replace(WALK, activation=np.full_like(WALK.activation, activation))
        return 255.0 - float(picture(SMALL, walk=walk).mean())

    assert darkness(0.0) < darkness(0.5) < darkness(1.0)
    corner = np.s_[:40, :200]
    assert (picture(SMALL, "dog")[corner] != picture(SMALL, "random")[corner]).any()
