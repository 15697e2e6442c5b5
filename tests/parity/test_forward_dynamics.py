"""Accelerations of the linkage in the air against MuJoCo, and the laws of free flight.

The equations conserve momentum exactly; an integrator conserves it to its own order, because
momentum is not linear in the state. So the equations are checked instant by instant, to rounding,
and a flight is checked by how its drift falls with the step.
"""

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_nmm import InputError, forward_dynamics
from taichi_nmm.body import GRAVITY_MPS2, Bodies
from taichi_nmm.mujoco_engine.mjcf import RELATIVE, compile_model, linkage
from tests.parity import numpy_dynamics

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
States = tuple[Array, Array, Array, Bodies]  # q, qdot [n, 9], joint torques [n, 6] and n bodies

STATES = 1000
LARGEST_RATE_PS = 10.0  # m/s and rad/s; walking stays below
LARGEST_TORQUE_NM = 300.0
LARGEST_ERROR = 1e-9  # of each single acceleration; rounding leaves about 1e-10

FLYING = 16
FLIGHT_S = 0.5
STEPS_S = (2e-3, 1e-3)
RK4_ORDER_AT_LEAST = 3.5  # 4 less what the second step's higher-order terms take
GENTLE = 0.1  # of the random rates: at 1 ms the integrator's error is then below rounding
ROUNDING = 1e-12  # relative, over the 2,000 evaluations of a flight


def random_states(count: int) -> States:
    """Any angles, fast rates, strong torques; every second body is disturbed."""
    rng = np.random.default_rng(20161)
    nominal, disturbed = vars(Bodies.nominal(count)), vars(Bodies.disturbed(range(count)))
    odd = (np.arange(count) % 2 == 1)[:, None]
    return (
        rng.uniform(-np.pi, np.pi, (count, 9)),
        rng.uniform(-LARGEST_RATE_PS, LARGEST_RATE_PS, (count, 9)),
        rng.uniform(-LARGEST_TORQUE_NM, LARGEST_TORQUE_NM, (count, 6)),
        Bodies(**{name: np.where(odd, disturbed[name], nominal[name]) for name in nominal}),
    )


def by_mujoco(q: Array, qdot: Array, joint_torque: Array, bodies: Bodies) -> Array:
    """Accelerations [n, 9] by `mj_forward`, in our coordinates; one body a state."""
    accelerations = []
    for row in range(len(q)):
        model = compile_model(linkage(bodies, row))
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = RELATIVE @ q[row], RELATIVE @ qdot[row]
        data.qfrc_applied[3:] = joint_torque[row]
        mujoco.mj_forward(model, data)
        accelerations.append(np.linalg.solve(RELATIVE, data.qacc))
    return np.array(accelerations)


@pytest.fixture(scope="module")
def states() -> States:
    return random_states(STATES)


@pytest.fixture(scope="module")
def expected(states: States) -> Array:
    return by_mujoco(*states)


def relative_error(found: Array, expected: Array) -> float:
    return float(np.max(np.abs(found - expected) / np.abs(expected)))


def test_accelerations_also_of_dense_equations_are_mujocos(states: States, expected: Array) -> None:
    found = forward_dynamics(*states)
    assert found.shape == (STATES, 9) and found.dtype == np.float64
    assert relative_error(found, expected) <= LARGEST_ERROR
    assert relative_error(numpy_dynamics.forward_dynamics(*states), expected) <= LARGEST_ERROR


def test_bodies_matter_and_the_rest_of_the_batch_does_not(states: States, expected: Array) -> None:
    found = forward_dynamics(*states[:3])
    nominal, disturbed = slice(0, None, 2), slice(1, None, 2)
    assert relative_error(found[nominal], expected[nominal]) <= LARGEST_ERROR
    assert relative_error(found[disturbed], expected[disturbed]) > 0.01
    body = Bodies.disturbed([7])
    one = forward_dynamics(*states[:3], body)
    np.testing.assert_array_equal(one, forward_dynamics(*states[:3], body.take([0] * STATES)))
    q, qdot, torque, bodies = states
    for count in (1, 3, 17):  # a state does not depend on its batch
        few = forward_dynamics(q[:count], qdot[:count], torque[:count], bodies.take(range(count)))
        np.testing.assert_array_equal(few, forward_dynamics(*states)[:count])


GOOD = {"q": np.zeros((2, 9)), "qdot": np.zeros((2, 9)), "joint_torque": np.zeros((2, 6))}


@pytest.mark.parametrize(("name", "value"), [
    ("q", np.zeros((2, 8))), ("qdot", np.zeros((3, 9))), ("joint_torque", np.zeros((2, 5))),
    ("bodies", Bodies.nominal(3)), ("q", np.full((2, 9), np.nan)),
])  # fmt: skip
def test_what_cannot_be_used_is_named(name: str, value: object) -> None:
    with pytest.raises(InputError, match=rf"^{name}\b"):
        forward_dynamics(**GOOD | {name: value})  # type: ignore[arg-type]


def accelerate(q: Array, qdot: Array, bodies: Bodies) -> Array:
    return forward_dynamics(q, qdot, np.zeros((len(q), 6)), bodies)


def runge_kutta_step(q: Array, v: Array, bodies: Bodies, h: float) -> tuple[Array, Array]:
    """The classical fourth-order step of q' = v, v' = accelerate(q, v)."""
    a1 = accelerate(q, v, bodies)
    v2 = v + 0.5 * h * a1
    a2 = accelerate(q + 0.5 * h * v, v2, bodies)
    v3 = v + 0.5 * h * a2
    a3 = accelerate(q + 0.5 * h * v2, v3, bodies)
    v4 = v + h * a3
    a4 = accelerate(q + h * v3, v4, bodies)
    return q + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def fly(h: float, rate: float) -> dict[str, Array]:
    """Conserved quantities over a flight, less what gravity adds, [t, n] and [t, n, 2]."""
    q, v, _, bodies = random_states(FLYING)
    v *= rate
    weight_n = GRAVITY_MPS2 * np.sum(bodies.mass_kg, axis=1)
    samples = []
    for step in range(round(FLIGHT_S / h) + 1):
        momentum = numpy_dynamics.momentum(q, v, bodies)
        momentum[:, 1] += weight_n * step * h
        spin = numpy_dynamics.angular_momentum(q, v, bodies)
        samples.append((numpy_dynamics.energy(q, v, bodies), momentum, spin))
        q, v = runge_kutta_step(q, v, bodies, h)
    energy, momentum, spin = (np.array(column) for column in zip(*samples, strict=True))
    return {"energy": energy, "momentum": momentum, "angular momentum": spin}


def drift(samples: Array) -> Array:
    """Largest departure from the first sample, for each walker."""
    return np.asarray(np.max(np.abs(samples - samples[0]), axis=0))


def test_drift_falls_at_the_order_of_the_integrator() -> None:
    coarse, fine = (fly(h, rate=1.0) for h in STEPS_S)
    assert len(coarse) == 3
    for name in coarse:
        fall = np.max(drift(coarse[name])) / np.max(drift(fine[name]))
        assert np.log2(fall) >= RK4_ORDER_AT_LEAST, name


def test_a_gentle_flight_conserves_to_rounding() -> None:
    energy, momentum, spin = fly(STEPS_S[-1], GENTLE).values()
    assert np.max(drift(energy) / np.abs(energy[0])) <= ROUNDING
    assert np.max(drift(momentum)) <= ROUNDING * np.max(np.linalg.norm(momentum[0], axis=1))
    assert np.max(drift(spin)) <= ROUNDING * np.max(np.abs(spin[0]))


def test_no_torque_between_segments_moves_the_whole(states: States) -> None:
    """At any instant: sum of m a is the weight, and no moment acts about the centre of mass."""
    q, qdot, _, bodies = states
    qddot = forward_dynamics(*states)
    acceleration = numpy_dynamics.com_accelerations(q, qdot, qddot, bodies)
    force = bodies.mass_kg[..., None] * acceleration
    net = np.sum(force, axis=1)
    net[:, 1] += GRAVITY_MPS2 * np.sum(bodies.mass_kg, axis=1)
    spin = bodies.inertia_kgm2 * qddot[:, 2:]
    moment = numpy_dynamics.moment_about_com(q, acceleration, bodies) + np.sum(spin, axis=1)
    scale = np.sum(np.abs(force), axis=(1, 2))  # arms are about a metre: of force and moment alike
    assert np.max(np.abs(net) / scale[:, None]) <= ROUNDING
    assert np.max(np.abs(moment) / scale) <= ROUNDING
