"""Accelerations of the linkage in the air against MuJoCo, and momentum to rounding."""

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_nmm import Settings, forward_dynamics
from taichi_nmm.body import GRAVITY_MPS2, Bodies
from taichi_nmm.mujoco_engine.mjcf import RELATIVE, compile_model, linkage
from tests.cases import refused
from tests.parity import numpy_dynamics

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
# q, qdot [n, 9], joint torques [n, 6] and n bodies.

STATES = 1000
LARGEST_RATE_PS = 10.0  # m/s and rad/s; walking stays below
LARGEST_TORQUE_NM = 300.0
LARGEST_ERROR = 1e-9  # of each single acceleration; rounding leaves about 1e-10

ROUNDING = 1e-12  # relative


def random_states(count):
    """Any angles, fast rates, strong torques; every second body is disturbed."""
    rng = np.random.default_rng(20161)
    nominal, disturbed = (
        vars(Bodies.nominal(count)),
        vars(Bodies.disturbed(range(count))),
    )
    odd = (np.arange(count) % 2 == 1)[:, None]
    return (
        rng.uniform(-np.pi, np.pi, (count, 9)),
        rng.uniform(-LARGEST_RATE_PS, LARGEST_RATE_PS, (count, 9)),
        rng.uniform(-LARGEST_TORQUE_NM, LARGEST_TORQUE_NM, (count, 6)),
        Bodies(
            **{name: np.where(odd, disturbed[name], nominal[name]) for name in nominal}
        ),
    )


def by_mujoco(q, qdot, joint_torque, bodies):
    """Accelerations [n, 9] by `mj_forward`, in our coordinates; one body a state."""
    accelerations = []
    for row in range(len(q)):
        model = compile_model(linkage(bodies, row, Settings(engine="mujoco"), 1.0))
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = RELATIVE @ q[row], RELATIVE @ qdot[row]
        data.qfrc_applied[3:] = joint_torque[row]
        mujoco.mj_forward(model, data)
        accelerations.append(np.linalg.solve(RELATIVE, data.qacc))
    return np.array(accelerations)


@pytest.fixture(scope="module")
def states():
    return random_states(STATES)


@pytest.fixture(scope="module")
def expected(states):
    return by_mujoco(*states)


def relative_error(found, expected):
    return float(np.max(np.abs(found - expected) / np.abs(expected)))


def test_accelerations_are_mujocos(states, expected):
    found = forward_dynamics(*states)
    assert found.shape == (STATES, 9) and found.dtype == np.float64
    assert relative_error(found, expected) <= LARGEST_ERROR


def test_bodies_matter_and_the_rest_of_the_batch_does_not(states, expected):
    found = forward_dynamics(*states[:3])
    nominal, disturbed = slice(0, None, 2), slice(1, None, 2)
    assert relative_error(found[nominal], expected[nominal]) <= LARGEST_ERROR
    assert relative_error(found[disturbed], expected[disturbed]) > 0.01
    body = Bodies.disturbed([7])
    one = forward_dynamics(*states[:3], body)
    np.testing.assert_array_equal(
        one, forward_dynamics(*states[:3], body.take([0] * STATES))
    )
    q, qdot, torque, bodies = states
    for count in (1, 3, 17):  # a state does not depend on its batch
        few = forward_dynamics(
            q[:count], qdot[:count], torque[:count], bodies.take(range(count))
        )
        np.testing.assert_array_equal(few, forward_dynamics(*states)[:count])


GOOD = {
    "q": np.zeros((2, 9)),
    "qdot": np.zeros((2, 9)),
    "joint_torque": np.zeros((2, 6)),
}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("q", np.zeros((2, 8))),
        ("qdot", np.zeros((3, 9))),
        ("joint_torque", np.zeros((2, 5))),
        ("bodies", Bodies.nominal(3)),
        ("q", np.full((2, 9), np.nan)),
        # Numbers whose accelerations are none, and angles of which a sine is noise.
        ("qdot", np.full((2, 9), 1e200)),
        ("joint_torque", np.full((2, 6), -1e308)),
        ("q", np.full((2, 9), 1e8)),
    ],
)
def test_what_cannot_be_used_is_named(name, value):
    with refused(rf"^{name}\b"):
        forward_dynamics(**GOOD | {name: value})


def test_no_torque_between_segments_moves_the_whole(states):
    """At any instant: sum of m a is the weight, and no moment acts about the centre of mass."""
    q, qdot, _, bodies = states
    qddot = forward_dynamics(*states)
    acceleration = numpy_dynamics.com_accelerations(q, qdot, qddot, bodies)
    force = bodies.mass_kg[..., None] * acceleration
    net = np.sum(force, axis=1)
    net[:, 1] += GRAVITY_MPS2 * np.sum(bodies.mass_kg, axis=1)
    spin = bodies.inertia_kgm2 * qddot[:, 2:]
    moment = numpy_dynamics.moment_about_com(q, acceleration, bodies) + np.sum(
        spin, axis=1
    )
    # Arms are about a metre, so the scale is one of force and of moment.
    scale = np.sum(np.abs(force), axis=(1, 2))
    assert np.max(np.abs(net) / scale[:, None]) <= ROUNDING
    assert np.max(np.abs(moment) / scale) <= ROUNDING
