"""Boxes of a ground: rays from above meet the height table, wherever a walker may come."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from taichi_nmm import terrain
from taichi_nmm.body import Bodies
from taichi_nmm.errors import InputError
from taichi_nmm.mujoco_engine.engine import VIEW_M, carried
from taichi_nmm.mujoco_engine.ground import boxes
from taichi_nmm.mujoco_engine.mjcf import compiled, walker_xml
from taichi_nmm.parameters import K_T
from taichi_nmm.settings import Settings
from taichi_nmm.simulator import LONGEST_WALK_S
from taichi_nmm.terrain import GRID_NODES, GRID_X_M, KINDS, Terrain
from taichi_nmm.walkers import check_batch

TOLERANCE_M = 1e-6
MUJOCO = Settings(engine="mujoco")
ABOVE_M = 1000.0
AWAY_M = 1e4  # where the walker is, while rays are cast
FASTEST_MPS = 2.4  # see `terrain.GRID_END_M`
TABLE = "0, 0\n1, 0.5\n1.31, 0.2\n7, 0.21\n40, -3\n"


def ground_of(kind: str, folder: Path) -> list[Terrain]:
    """Grounds of a kind, those with the steepest pieces that experiments have among them."""
    file = folder / "table.csv"
    file.write_text(TABLE)
    return {
        "flat": [terrain.flat()],
        "rough": [terrain.rough(1), terrain.rough(2, amplitude_m=0.3, flat_start_m=0.0)],
        "blocks": [terrain.blocks(2), terrain.blocks(3, amplitude_m=0.2, riser_m=0.05)],
        "ramp": [terrain.ramp(), terrain.ramp(direction="down")],
        "stairs": [
            terrain.stairs(rise_m=0.05),
            terrain.stairs(direction="down", rise_m=0.15),
            terrain.stairs(rise_m=0.2, run_m=0.1),
        ],
        "file": [terrain.from_file(file)],
    }[kind]


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
    for ground in ground_of(kind, tmp_path):
        model = compiled(walker_xml(Bodies.nominal(), boxes(ground), MUJOCO, 0.9))
        assert errors_m(model, mujoco.MjData(model), ground, x_m) <= TOLERANCE_M, ground.name


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_boxes_around_a_walker_are_always_there(kind: str, tmp_path: Path) -> None:
    """Forwards, backwards, and beyond the table."""
    rng = np.random.default_rng(1)
    for ground in ground_of(kind, tmp_path):
        batch = check_batch(K_T, terrains=ground)
        walker = carried(batch, 0, MUJOCO)
        for hip_m in (0.0, *rng.uniform(-8, 302, 30), 299.0, -5.0):
            walker.look_around(hip_m)
            x_m = hip_m + rng.uniform(-VIEW_M, VIEW_M, 12)
            assert (
                errors_m(walker.model, mujoco.MjData(walker.model), ground, x_m) <= TOLERANCE_M
            ), ground.name


def test_the_ground_goes_on_as_far_as_anybody_walks() -> None:
    """Outside of the table it is level, as in this simulator."""
    ground = terrain.ramp()
    batch = check_batch(K_T, terrains=ground)
    walker = carried(batch, 0, MUJOCO)
    far_m = GRID_X_M[0] + FASTEST_MPS * LONGEST_WALK_S
    walker.look_around(far_m)
    x_m = far_m + np.linspace(-1.0, 1.0, 5)
    assert errors_m(walker.model, mujoco.MjData(walker.model), ground, x_m) <= TOLERANCE_M


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


@pytest.mark.xfail(strict=True, reason="a sphere past the end of a box touches its edge")
def test_a_foot_in_soft_ground_does_not_catch_where_two_pieces_meet() -> None:
    """All but level: what pushes a sphere out of it is all but vertical, wherever it lies."""
    ground = terrain.rough(1, amplitude_m=0.0005, flat_start_m=0.0)
    walker = carried(check_batch(K_T, terrains=ground), 0, MUJOCO)
    model, data = walker.model, mujoco.MjData(walker.model)
    data.qpos[:], data.qvel[:] = np.split(walker.start, 2)
    mujoco.mj_forward(model, data)
    spheres = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)
    lowest = spheres[np.argmin(data.geom_xpos[spheres, 2])]
    seam_m = boxes(ground).start_m[2]
    data.qpos[0] += seam_m + 0.003 - data.geom_xpos[lowest, 0]
    data.qpos[1] -= 0.004
    mujoco.mj_forward(model, data)
    normals = np.array([contact.frame[:3] for contact in data.contact])
    assert len(normals)
    assert np.abs(normals[:, 0]).max() <= 0.01
