"""The model that MuJoCo gets: what is in it, and that its file opens by itself."""

import mujoco
import numpy as np
import pytest

from taichi_nmm import terrain
from taichi_nmm.body import GRAVITY_MPS2, SEGMENT_NAMES, Bodies
from taichi_nmm.initial import SPEED_MPS
from taichi_nmm.kernel.contact_planes import PLANES, PLANES_PER_SOLE, SOLE_RADIUS_M
from taichi_nmm.mujoco_engine.engine import start_state
from taichi_nmm.mujoco_engine.ground import boxes
from taichi_nmm.mujoco_engine.mjcf import JOINTS, STOPS, walk_model, write_mjcf
from taichi_nmm.settings import MujocoSettings, Settings
from taichi_nmm.world import WorldRanges

GROUND = terrain.rough(4, flat_start_m=0.0)
FRICTION = 0.7
BODY = Bodies.disturbed([3])
SETTINGS = Settings(
    engine="mujoco", physics_step_s=0.5e-3, mujoco=MujocoSettings(0.005, damping_ratio=0.7)
)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> mujoco.MjModel:
    """As MuJoCo's own viewer reads it."""
    path = tmp_path_factory.mktemp("mjcf") / "walker.xml"
    write_mjcf(path, BODY, FRICTION, boxes(GROUND), SETTINGS, start_state(GROUND))
    return mujoco.MjModel.from_xml_path(str(path))


def test_the_body_is_the_one_asked_for(model: mujoco.MjModel) -> None:
    assert [model.body(n).name for n in range(1, 8)] == list(SEGMENT_NAMES)
    np.testing.assert_array_equal(model.body_mass[1:], BODY.mass_kg[0])
    np.testing.assert_array_equal(model.body_inertia[1:, 1], BODY.inertia_kgm2[0])
    assert model.nq == model.nv == 9
    assert model.opt.gravity.tolist() == [0.0, 0.0, -GRAVITY_MPS2]
    assert not model.dof_damping.any() and not model.dof_armature.any()


def test_six_motors_turn_six_joints(model: mujoco.MjModel) -> None:
    assert model.nu == 6
    assert [model.actuator(n).name for n in range(6)] == list(JOINTS)
    for n, name in enumerate(JOINTS):
        assert model.joint(int(model.actuator_trnid[n, 0])).name == name
    np.testing.assert_array_equal(model.actuator_gear[:, 0], 1.0)
    np.testing.assert_array_equal(model.actuator_gainprm[:, 0], 1.0)
    assert not model.actuator_ctrllimited.any() and not model.actuator_forcelimited.any()


def test_joints_are_limited_where_the_walkers_are(model: mujoco.MjModel) -> None:
    assert model.jnt_limited.tolist() == [0, 0, 0] + [1] * 6
    for name in JOINTS:
        stop = STOPS[name.split("_")[0]]
        assert model.joint(name).range.tolist() == [stop.low_rad, stop.high_rad]


def test_contacts_are_as_asked(model: mujoco.MjModel) -> None:
    assert model.opt.timestep == SETTINGS.physics_step_s
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    np.testing.assert_array_equal(model.geom_solref, np.tile([0.005, 0.7], (model.ngeom, 1)))
    np.testing.assert_array_equal(model.geom_friction[:, 0], FRICTION)
    # Feet meet the ground, and nothing else meets anything.
    assert model.ngeom == len(boxes(GROUND)) + 4
    spheres = model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    assert spheres.sum() == 4
    collide = model.geom_contype[:, None] & model.geom_conaffinity
    assert (collide[spheres][:, ~spheres] == 1).all()
    assert not collide[spheres][:, spheres].any() and not collide[~spheres][:, ~spheres].any()


def test_the_contacts_of_a_walk_are_those_of_the_file(model: mujoco.MjModel) -> None:
    """Each sole meets its own planes, by the same numbers, and nothing meets anything else."""
    walked = walk_model(BODY, SETTINGS, FRICTION)
    assert walked.npair == PLANES
    assert not (walked.geom_contype[:, None] & walked.geom_conaffinity).any()
    pairs = np.column_stack([walked.pair_geom1, walked.pair_geom2])
    assert {frozenset(walked.geom(geom).name for geom in pair) for pair in pairs} == {
        frozenset((f"plane_{plane}", f"sole_{plane // PLANES_PER_SOLE}")) for plane in range(PLANES)
    }
    np.testing.assert_array_equal(walked.pair_friction[:, :2], FRICTION)
    for name in ("dim", "solref", "solimp", "margin", "gap"):
        numbers = getattr(walked, f"pair_{name}")
        of_file = getattr(model, "geom_condim" if name == "dim" else f"geom_{name}")[0]
        expected = np.broadcast_to(of_file, numbers.shape)
        np.testing.assert_array_equal(numbers, expected, err_msg=name)


def test_the_key_frame_is_the_start_of_every_walk(model: mujoco.MjModel) -> None:
    """Soles on or over the ground, one foot touching, the hip at its speed."""
    assert model.nkey == 1 and model.key(0).name == "start"
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    spheres = model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    centres = data.geom_xpos[spheres]
    gaps = centres[:, 2] - SOLE_RADIUS_M - GROUND.height(centres[:, 0])
    assert abs(gaps.min()) < 1e-3
    assert data.qvel[0] == SPEED_MPS
    assert np.abs(data.qpos[3:]).max() < 1.0
    # The viewer looks there, not at kilometres of ground.
    assert model.stat.extent < 5.0
    assert np.abs(model.stat.center - [data.qpos[0], 0.0, data.qpos[1]]).max() < 1.0


def test_a_walker_is_advanced_as_its_file_is(model: mujoco.MjModel) -> None:
    """The first steps without torque, from the key frame and by the engine's own model."""
    from taichi_nmm.kernel import backend
    from taichi_nmm.mujoco_engine.engine import Herd
    from taichi_nmm.parameters import PUBLISHED_GAINS
    from taichi_nmm.walkers import check_batch

    backend.start(SETTINGS.on_processor())
    worlds = WorldRanges(friction=(FRICTION, FRICTION)).draw([0])
    herd = Herd(check_batch(PUBLISHED_GAINS, BODY, GROUND, worlds=worlds), SETTINGS)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(200):
        mujoco.mj_step(model, data)
        moved = herd.step(np.zeros((1, 6)))
    np.testing.assert_allclose(moved[0, :9], data.qpos, rtol=0, atol=1e-6)
