"""Planes under the soles, and the ground of a file, against the height table itself."""

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_nmm import Bodies, Settings, Worlds, terrain
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.contact_planes import PLANES, SOLE_RADIUS_M
from taichi_nmm.kernel.layout import CONTACTS
from taichi_nmm.mujoco_engine.engine import ContactPlanes, start_state
from taichi_nmm.mujoco_engine.mjcf import mjcf_text, walk_model
from taichi_nmm.simulator import LONGEST_WALK_S
from taichi_nmm.terrain import GRID_END_M, GRID_START_M, GRID_X_M, KINDS

Array = NDArray[np.float64]

MUJOCO = Settings(engine="mujoco", arch="cpu")
POSES = 300  # of each ground
SPACING_M = 1e-5  # of the points of the ground that are looked at
AROUND_M = 0.03
# of these grounds, its length along a metre: the points on it are so far apart
STEEPEST = 5.0
FASTEST_MPS = 2.4  # see `terrain.GRID_END_M`
FILE = "0, 0\n1, 0.5\n1.31, 0.2\n7, 0.21\n40, -3\n"
ABOVE_M = 1000.0
AWAY_M = 1e4  # where the walker is, while rays are cast


def grounds_of(kind, folder):
    """Grounds of a kind, the steepest of the experiments among them; a file's is written."""
    (folder / "table.csv").write_text(FILE)
    return {
        "flat": [terrain.flat()],
        "rough": [
            terrain.rough(1),
            terrain.rough(2, amplitude_m=0.3, flat_start_m=0.0),
        ],
        "blocks": [terrain.blocks(2), terrain.blocks(3, amplitude_m=0.2, riser_m=0.05)],
        "ramp": [terrain.ramp(), terrain.ramp(direction="down")],
        "stairs": [
            terrain.stairs(rise_m=0.05),
            terrain.stairs(direction="down", rise_m=0.15),
            terrain.stairs(rise_m=0.2, run_m=0.1),
        ],
        "file": [terrain.from_file(folder / "table.csv")],
    }[kind]


@pytest.fixture(scope="module", autouse=True)
def engine():
    backend.start(MUJOCO.on_processor())


@pytest.fixture(scope="module")
def model():
    return walk_model(Bodies.nominal(), MUJOCO, 0.9)


def centres(model, qpos):
    """Of the soles, x and z, as MuJoCo has them, [CONTACTS, 2]."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return np.array(
        [data.geom(f"sole_{sole}").xpos[[0, 2]] for sole in range(CONTACTS)]
    )


def posed(model, ground, sole, x_m, gap_m, pose):
    """qpos of a pose in which the centre of a sole is at x, so far above the ground under it."""
    qpos = np.concatenate([[0.0, 0.0], pose])
    x, z = centres(model, qpos)[sole]
    qpos[:2] = x_m - x, ground.height(x_m) + gap_m - z
    return qpos


def planes_under(ground, qpos):
    """Points and normals of the planes, x and z, [n, PLANES, 2] each."""
    rows = np.atleast_2d(qpos)
    position, quaternion = ContactPlanes((ground,), np.zeros(len(rows), int)).under(
        rows
    )
    assert not position[..., 1].any() and not quaternion[..., [1, 3]].any()
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=-1), 1.0, rtol=1e-12)
    angle = 2.0 * np.arctan2(quaternion[..., 2], quaternion[..., 0])
    return position[..., [0, 2]], np.stack([np.sin(angle), np.cos(angle)], axis=-1)


def valleys(ground, centre):
    """Distances that are local minima, of points of the ground around a place, in order."""
    x = centre[0] + np.arange(-AROUND_M, AROUND_M, SPACING_M)
    x = np.union1d(x, GRID_X_M[np.abs(GRID_X_M - centre[0]) < AROUND_M])
    distance = np.hypot(x - centre[0], ground.height(x) - centre[1])
    lowest = (distance[1:-1] < distance[:-2]) & (distance[1:-1] <= distance[2:])
    return np.sort(distance[1:-1][lowest])


def places(ground, rng):
    """Where soles are looked at: anywhere, and around where the slope changes."""
    corners = GRID_X_M[1:-1][np.abs(np.diff(ground.height_m, 2)) > 1e-4]
    x_m = rng.uniform(GRID_START_M - 1.0, GRID_END_M + 1.0, POSES)
    if len(corners):
        x_m[::2] = rng.choice(corners, len(x_m[::2])) + rng.uniform(
            -0.01, 0.01, len(x_m[::2])
        )
    return x_m


def assert_near(distances, seen):
    """Equal but for the ground between the sampled points."""
    assert len(distances) == len(seen)
    between = np.hypot(distances, 0.5 * STEEPEST * SPACING_M) - distances
    assert (np.abs(distances - seen) <= between + 1e-9).all(), (distances, seen)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_soles_touch_the_nearest_points(kind, model, tmp_path):
    """Above the ground a plane is as far as the nearest point, a second one as the next valley."""
    rng = np.random.default_rng(3)
    hollows = 0
    for ground in grounds_of(kind, tmp_path):
        soles, poses = [], []
        for x_m in places(ground, rng):
            sole, pose = rng.integers(CONTACTS), rng.normal(scale=0.5, size=7)
            soles.append(sole)
            poses.append(posed(model, ground, sole, x_m, rng.uniform(0, 0.015), pose))
        planes = zip(*planes_under(ground, poses), strict=True)
        for sole, qpos, both in zip(soles, poses, planes, strict=True):
            centre = centres(model, qpos)[sole]
            points, normals = (values[2 * sole : 2 * sole + 2] for values in both)
            distances = np.sum((centre - points) * normals, axis=1)
            on_planes = points + distances[:, None] * normals
            np.testing.assert_allclose(on_planes, [centre] * 2, atol=1e-9)
            nearest = valleys(ground, centre)
            touched = distances[distances < SOLE_RADIUS_M]
            assert_near(touched, nearest[nearest < SOLE_RADIUS_M])
            hollows += len(touched) > 1
    assert hollows > 0 or kind in ("flat", "ramp")  # a ramp's slope changes by little


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_sole_in_the_ground_is_led_out(kind, model, tmp_path):
    rng = np.random.default_rng(4)
    for ground in grounds_of(kind, tmp_path):
        poses = [
            posed(model, ground, 2, x_m, -rng.uniform(0, 0.02), np.zeros(7))
            for x_m in places(ground, rng)
        ]
        for qpos, *plane in zip(poses, *planes_under(ground, poses), strict=True):
            centre = centres(model, qpos)[2]
            point, normal = (values[4] for values in plane)
            depth = (point - centre) @ normal
            assert_near(np.array([depth]), valleys(ground, centre)[:1])
            assert normal[1] > 0.0


def contacts(model, ground, qpos):
    """MuJoCo's own contacts of a pose: depths [c], and normals x and z, [c, 2]."""
    data = mujoco.MjData(model)
    position, quaternion = ContactPlanes((ground,), np.zeros(1, int)).under(qpos[None])
    data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = (
        qpos,
        position[0],
        quaternion[0],
    )
    mujoco.mj_forward(model, data)
    return -data.contact.dist, data.contact.frame[:, [0, 2]]


@pytest.mark.parametrize("past_m", [-0.003, -1e-9, 0.0, 1e-9, 0.003, 0.008])
def test_a_foot_does_not_catch_where_two_pieces_meet(model, past_m):
    """The ground is almost level, so contact normals are almost vertical everywhere."""
    ground = terrain.rough(1, amplitude_m=0.0005, flat_start_m=0.0)
    for knot_m in range(3, 8):
        qpos = posed(
            model, ground, 0, knot_m + past_m, SOLE_RADIUS_M - 0.004, np.zeros(7)
        )
        depths, normals = contacts(model, ground, qpos)
        assert depths[0] == pytest.approx(0.004, abs=1e-6)
        assert len(normals) and np.abs(normals[:, 0]).max() <= 0.01


def test_a_foot_at_a_riser_touches_it_and_the_tread(model):
    ground = terrain.stairs(rise_m=0.2, run_m=1.0)
    rises = np.diff(ground.height_m)
    foot_m = GRID_X_M[np.flatnonzero(rises > 0.1)[0]]
    pose = np.zeros(7)
    pose[3] = -1.0  # the left knee: that leg is out of the way
    qpos = posed(model, ground, 3, foot_m - 0.004, SOLE_RADIUS_M - 0.001, pose)
    depths, normals = contacts(model, ground, qpos)
    slope = np.array([-0.2, 0.05]) / np.hypot(0.2, 0.05)
    upright = [normal for normal in normals if abs(normal[0]) < 1e-12]
    leaning = normals[np.abs(normals - slope).max(axis=1) < 1e-12]
    assert len(upright) and len(leaning) == 1 and len(upright) + 1 == len(normals)
    assert (depths > 0).all()


def test_the_ground_goes_on_as_far_as_anybody_walks(model):
    """Outside of the table it is level, as in this simulator."""
    ground = terrain.ramp()
    far_m = FASTEST_MPS * LONGEST_WALK_S
    for x_m, end in ((GRID_START_M - far_m, 0), (GRID_END_M + far_m, -1)):
        qpos = posed(model, ground, 1, x_m, 0.009, np.zeros(7))
        points, normals = (values[0, 2:4] for values in planes_under(ground, qpos))
        assert (
            points[0, 1] == ground.height_m[end] and points[1, 1] < points[0, 1] - 0.9
        )
        np.testing.assert_array_equal(normals, [[0.0, 1.0]] * 2)


def test_planes_are_a_walkers_own():
    """Alone, among others, and beside one that has become no number: the same bits."""
    rng = np.random.default_rng(5)
    grounds = (terrain.rough(3, flat_start_m=0.0), terrain.blocks(4, flat_start_m=0.0))
    qpos, index = rng.normal(size=(9, 9)), np.arange(9) % 2
    together = ContactPlanes(grounds, index)
    expected = [values.copy() for values in together.under(qpos)]
    alone = [ContactPlanes(grounds, index[[n]]).under(qpos[[n]]) for n in range(9)]
    spoilt = qpos.copy()
    spoilt[4], spoilt[5] = np.nan, np.inf
    still = np.array([n not in (4, 5) for n in range(9)])
    for part in (0, 1):
        np.testing.assert_array_equal(
            expected[part], np.concatenate([one[part] for one in alone])
        )
        np.testing.assert_array_equal(
            together.under(spoilt)[part][still], expected[part][still]
        )
    together.keep(still)
    for part in (0, 1):
        np.testing.assert_array_equal(
            together.under(qpos[still])[part], expected[part][still]
        )


def test_bits_do_not_depend_on_the_controllers_precision():
    qpos = np.random.default_rng(6).normal(size=(2, 9))
    planes = ContactPlanes((terrain.rough(3, flat_start_m=0.0),), np.zeros(2, int))
    single = [values.copy() for values in planes.under(qpos)]
    backend.start(
        Settings(engine="mujoco", arch="cpu", precision="float64").on_processor()
    )
    for one, other in zip(single, planes.under(qpos), strict=True):
        np.testing.assert_array_equal(one, other)
    assert single[0].shape == (2, PLANES, 3)


# A file: rays from above meet the height table.


def largest_error_m(model, ground, x_m):
    """Between rays from above and the table."""
    data = mujoco.MjData(model)
    data.qpos[1] = AWAY_M
    mujoco.mj_forward(model, data)
    hit, down, found = np.zeros(1, np.int32), np.array([0.0, 0.0, -1.0]), []
    for x in x_m:
        start = np.array([x, 0.0, ABOVE_M])
        found.append(
            ABOVE_M - mujoco.mj_ray(model, data, start, down, None, 1, -1, hit, None)
        )
    return float(np.max(np.abs(np.array(found) - ground.height(x_m))))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_rays_meet_the_height_table(kind, tmp_path):
    rng = np.random.default_rng(0)
    x_m = np.concatenate(
        [rng.uniform(-5, 300, 150), rng.choice(GRID_X_M[:-1], 50) + 1e-9]
    )
    file = tmp_path / "walker.xml"
    for ground in grounds_of(kind, tmp_path):
        text = mjcf_text(
            Bodies.nominal(), Worlds.nominal(), ground, MUJOCO, start_state(ground)
        )
        file.write_text(text)
        model = mujoco.MjModel.from_xml_path(str(file))
        single = 1e-7 * np.ptp(ground.height_m)  # MuJoCo keeps heights in float32
        assert largest_error_m(model, ground, x_m) <= 1e-6 + single, ground.name
