"""Accelerations of the simulator's own functions against MuJoCo's C engine, float64."""

import numpy as np
import pytest
from numpy.typing import NDArray

import taichi_nmm
from taichi_nmm.body import Bodies
from taichi_nmm.errors import InputError
from tests.parity import mujoco_dynamics, numpy_dynamics
from tests.parity.states import States, random_states

pytestmark = pytest.mark.slow

STATES = 1000
LARGEST_ERROR = 1e-9  # of each single acceleration; rounding leaves about 1e-10


@pytest.fixture(scope="module")
def states() -> States:
    return random_states(STATES)


@pytest.fixture(scope="module")
def expected(states: States) -> NDArray[np.float64]:
    return mujoco_dynamics.forward_dynamics(
        states.q, states.qdot, states.joint_torque, states.bodies
    )


def simulated(states: States) -> NDArray[np.float64]:
    return taichi_nmm.forward_dynamics(states.q, states.qdot, states.joint_torque, states.bodies)


def relative_error(found: NDArray[np.float64], expected: NDArray[np.float64]) -> float:
    return float(np.max(np.abs(found - expected) / np.abs(expected)))


def test_agrees_with_mujoco(states: States, expected: NDArray[np.float64]) -> None:
    found = simulated(states)
    assert found.shape == (STATES, 9)
    assert found.dtype == np.float64
    assert relative_error(found, expected) <= LARGEST_ERROR


def test_dense_numpy_dynamics_agree_with_mujoco(
    states: States, expected: NDArray[np.float64]
) -> None:
    found = numpy_dynamics.forward_dynamics(
        states.q, states.qdot, states.joint_torque, states.bodies
    )
    assert relative_error(found, expected) <= LARGEST_ERROR


def test_bodies_matter(states: States, expected: NDArray[np.float64]) -> None:
    found = taichi_nmm.forward_dynamics(states.q, states.qdot, states.joint_torque)
    nominal, disturbed = slice(0, None, 2), slice(1, None, 2)
    assert relative_error(found[nominal], expected[nominal]) <= LARGEST_ERROR
    assert relative_error(found[disturbed], expected[disturbed]) > 0.01


def test_one_body_serves_every_state(states: States) -> None:
    body = Bodies.disturbed([7])
    one = taichi_nmm.forward_dynamics(states.q, states.qdot, states.joint_torque, body)
    each = taichi_nmm.forward_dynamics(
        states.q, states.qdot, states.joint_torque, body.take([0] * STATES)
    )
    np.testing.assert_array_equal(one, each)


@pytest.mark.parametrize("count", [1, 3, 17])
def test_a_state_does_not_depend_on_its_batch(states: States, count: int) -> None:
    few = taichi_nmm.forward_dynamics(
        states.q[:count],
        states.qdot[:count],
        states.joint_torque[:count],
        states.bodies.take(range(count)),
    )
    np.testing.assert_array_equal(few, simulated(states)[:count])


@pytest.mark.parametrize(
    ("shapes", "field"),
    [
        (((2, 8), (2, 9), (2, 6)), "q"),
        (((2, 9), (3, 9), (2, 6)), "qdot"),
        (((2, 9), (2, 9), (2, 5)), "joint_torque"),
    ],
)
def test_wrong_shapes_are_named(shapes: tuple[tuple[int, int], ...], field: str) -> None:
    q, qdot, joint_torque = (np.zeros(shape) for shape in shapes)
    with pytest.raises(InputError, match=rf"\b{field}\b"):
        taichi_nmm.forward_dynamics(q, qdot, joint_torque)


def test_wrong_number_of_bodies_is_named() -> None:
    with pytest.raises(InputError, match="bodies"):
        taichi_nmm.forward_dynamics(
            np.zeros((2, 9)), np.zeros((2, 9)), np.zeros((2, 6)), Bodies.nominal(3)
        )


def test_nan_is_named() -> None:
    q = np.zeros((2, 9))
    q[1, 4] = np.nan
    with pytest.raises(InputError, match=r"\bq\b"):
        taichi_nmm.forward_dynamics(q, np.zeros((2, 9)), np.zeros((2, 6)))
