"""Free flight without torque: what mechanics says must stay, stays.

The equations conserve momentum exactly; an integrator conserves it to its own order, because
momentum is not linear in the state. So the equations are checked instant by instant, to rounding,
and a flight is checked by how its drift falls with the step.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

import taichi_nmm
from taichi_nmm.body import GRAVITY_MPS2, Bodies
from tests.parity import numpy_dynamics
from tests.parity.states import random_states

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]

WALKERS = 16
FLIGHT_S = 0.5
STEPS_S = (2e-3, 1e-3)
RK4_ORDER_AT_LEAST = 3.5  # 4 less what the second step's higher-order terms take
GENTLE = 0.1  # of the random rates: at 1 ms the integrator's error is then below rounding
ROUNDING = 1e-12  # relative, over the 2,000 evaluations of a flight


@dataclass(frozen=True)
class Flight:
    """Conserved quantities over a flight, less what gravity adds; [t, n] and [t, n, 2]."""

    energy_j: Array
    momentum_ns: Array
    angular_momentum_nms: Array


def accelerate(q: Array, qdot: Array, bodies: Bodies) -> Array:
    return taichi_nmm.forward_dynamics(q, qdot, np.zeros((len(q), 6)), bodies)


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


def fly(h: float, rate: float) -> Flight:
    """Fly the random bodies for `FLIGHT_S` at `rate` times their random rates."""
    start = random_states(WALKERS)
    q, v, bodies = start.q, rate * start.qdot, start.bodies
    weight_n = GRAVITY_MPS2 * np.sum(bodies.mass_kg, axis=1)
    samples = []
    for step in range(round(FLIGHT_S / h) + 1):
        momentum = numpy_dynamics.momentum(q, v, bodies)
        momentum[:, 1] += weight_n * step * h
        energy = numpy_dynamics.energy(q, v, bodies)
        samples.append((energy, momentum, numpy_dynamics.angular_momentum(q, v, bodies)))
        q, v = runge_kutta_step(q, v, bodies, h)
    return Flight(*(np.array(column) for column in zip(*samples, strict=True)))


def drift(samples: Array) -> Array:
    """Largest departure from the first sample, for each walker."""
    departure: Array = np.max(np.abs(samples - samples[0]), axis=0)
    return departure


@pytest.fixture(scope="module")
def fast() -> dict[float, Flight]:
    return {h: fly(h, rate=1.0) for h in STEPS_S}


@pytest.fixture(scope="module")
def gentle() -> Flight:
    return fly(STEPS_S[-1], GENTLE)


@pytest.mark.parametrize("name", ["energy_j", "momentum_ns", "angular_momentum_nms"])
def test_drift_falls_at_the_order_of_the_integrator(fast: dict[float, Flight], name: str) -> None:
    coarse, fine = (drift(getattr(fast[h], name)) for h in STEPS_S)
    order = np.log2(np.max(coarse) / np.max(fine))
    assert order >= RK4_ORDER_AT_LEAST


def test_energy_of_a_gentle_flight_stays_to_rounding(gentle: Flight) -> None:
    assert np.max(drift(gentle.energy_j) / np.abs(gentle.energy_j[0])) <= ROUNDING


def test_momentum_of_a_gentle_flight_stays_to_rounding(gentle: Flight) -> None:
    scale = np.max(np.linalg.norm(gentle.momentum_ns[0], axis=1))
    assert np.max(drift(gentle.momentum_ns)) <= ROUNDING * scale


def test_angular_momentum_of_a_gentle_flight_stays_to_rounding(gentle: Flight) -> None:
    scale = np.max(np.abs(gentle.angular_momentum_nms[0]))
    assert np.max(drift(gentle.angular_momentum_nms)) <= ROUNDING * scale


def test_no_torque_between_segments_moves_the_whole() -> None:
    """At any instant: sum of m a is the weight, and no moment acts about the centre of mass."""
    states = random_states(1000)
    bodies = states.bodies
    qddot = taichi_nmm.forward_dynamics(states.q, states.qdot, states.joint_torque, bodies)
    acceleration = numpy_dynamics.com_accelerations(states.q, states.qdot, qddot, bodies)
    force = bodies.mass_kg[..., None] * acceleration
    net = np.sum(force, axis=1)
    net[:, 1] += GRAVITY_MPS2 * np.sum(bodies.mass_kg, axis=1)
    spin = bodies.inertia_kgm2 * qddot[:, 2:]
    moment = numpy_dynamics.moment_about_com(states.q, acceleration, bodies) + np.sum(spin, axis=1)
    scale = np.sum(np.abs(force), axis=(1, 2))  # arms are about a metre: of force and moment alike
    assert np.max(np.abs(net) / scale[:, None]) <= ROUNDING
    assert np.max(np.abs(moment) / scale) <= ROUNDING
