"""Boxes of a ground: rays from above meet the height table."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from taichi_nmm import terrain
from taichi_nmm.body import Bodies
from taichi_nmm.errors import InputError
from taichi_nmm.mujoco_engine.engine import start_state
from taichi_nmm.mujoco_engine.ground import boxes
from taichi_nmm.mujoco_engine.mjcf import write_mjcf
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import GRID_NODES, GRID_X_M, KINDS, Terrain
from tests.taichi_nmm.mujoco_engine.grounds import grounds_of

TOLERANCE_M = 1e-6
MUJOCO = Settings(engine="mujoco")
ABOVE_M = 1000.0
AWAY_M = 1e4  # where the walker is, while rays are cast


def errors_m(model: mujoco.MjModel, data: mujoco.MjData, ground: Terrain, x_m: np.ndarray) -> float:
    """The largest, between rays from above and the table."""
    data.qpos[1] = AWAY_M
    mujoco.mj_forward(model, data)
    hit, down, found = np.zeros(1, np.int32), np.array([0.0, 0.0, -1.0]), []
    for x in x_m:
        start = np.array([x, 0.0, ABOVE_M])
        found.append(ABOVE_M - mujoco.mj_ray(model, data, start, down, None, 1, -1, hit, None))
    return float(np.max(np.abs(np.array(found) - ground.height(x_m))))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_rays_meet_the_height_table(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    x_m = np.concatenate([rng.uniform(-6, 302, 150), rng.choice(GRID_X_M, 50) + 1e-9, [-20.0]])
    file = tmp_path / "walker.xml"
    for ground in grounds_of(kind, tmp_path):
        write_mjcf(file, Bodies.nominal(), 0.9, boxes(ground), MUJOCO, start_state(ground))
        model = mujoco.MjModel.from_xml_path(str(file))
        assert errors_m(model, mujoco.MjData(model), ground, x_m) <= TOLERANCE_M, ground.name


def test_a_straight_piece_is_one_box() -> None:
    assert len(boxes(terrain.flat())) == 1
    ramp = terrain.ramp()
    slopes = np.diff(ramp.height_m)
    assert len(boxes(ramp)) == 2 + np.count_nonzero(np.abs(np.diff(slopes)) > 1e-10)


def test_a_ground_that_is_too_jagged_is_refused() -> None:
    height = np.where(np.arange(GRID_NODES) % 2, 1.0, 0.0)
    with pytest.raises(InputError, match=r"^terrain: 'saw' .* smoother ground than at x = ") as no:
        boxes(Terrain("saw", height))
    assert "\n" not in str(no.value)
