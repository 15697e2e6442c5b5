"""The Hill unit against its closed forms."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from taichi_nmm.result import MUSCLES
from tests.parity.interpreter import interpreted_walker
from tests.taichi_nmm.kernel import convergence

W, C, N, K, REFERENCE = 0.56, 0.05, 1.5, 5.0, 0.04  # Geyer & Herr 2010


@pytest.fixture(scope="module")
def muscle() -> Any:
    return interpreted_walker().muscle


def force_velocity(v: float) -> float:
    """Hill's curve as published; lengthening positive."""
    if v < 0:
        return (1 + v) / (1 - K * v)
    return N + (N - 1) * (v - 1) / (1 + 7.56 * K * v)


def inverse_force_velocity(f: float) -> float:
    """The closed inverse of both branches."""
    if f < 1:
        return (f - 1) / (1 + K * f)
    return ((N - 1) + (f - N)) / ((N - 1) - 7.56 * K * (f - N))


def test_force_length_is_a_bell(muscle: Any) -> None:
    length = np.linspace(0.2, 1.9, 200)
    expected = np.exp(np.log(C) * np.abs((length - 1) / W) ** 3)
    assert np.allclose(muscle.force_length(length[None, :]), expected, rtol=1e-12)
    assert np.isclose(muscle.force_length(np.array([[1 + W]]))[0, 0], C)


def quotient(muscle: Any, v: NDArray[np.float64]) -> NDArray[np.float64]:
    """The force factor of the range that each speed lies in."""
    a, b, c = muscle.force_velocity(v < 0.0, v >= 1.0)
    return np.asarray((a + b * v) / (1.0 + c * v))


def test_force_velocity_is_the_published_curve_and_joins(muscle: Any) -> None:
    v = np.linspace(-1.0, 0.999, 400)
    assert np.allclose(quotient(muscle, v), [force_velocity(x) for x in v], rtol=1e-12)
    ends = quotient(muscle, np.array([-1.0, 0.0, 1.0, 1.5]))
    assert np.allclose(ends, [0.0, 1.0, N, N + 50.0])
    just_below = quotient(muscle, np.array([0.0, 1.0]) - 1e-12)
    assert np.allclose(just_below, [1.0, N])


def isometric(muscle: Any, m: int, angles: NDArray[np.float64], activation: float) -> Any:
    """Contract muscle m at fixed joint angles (hip, knee, ankle) until it rests."""
    rows = interpreted_rows(angles)
    fibres, work = rows
    from taichi_nmm.kernel.layout import MUSCLES_PER_LEG, Muscle
    from taichi_nmm.kernel.muscle_table import T_OPTIMAL, T_SLACK, muscle_table

    data = muscle_table()[m]
    unit = unit_length(data, angles)
    for i in (m, m + MUSCLES_PER_LEG):
        fibres[Muscle.activation + i] = fibres[Muscle.stimulation + i] = activation
        fibres[Muscle.length + i] = (unit - data[T_SLACK]) / data[T_OPTIMAL]
    lane, constants = np.arange(1), muscle.constants(muscle_table(), m, 1)
    for _ in range(3000):
        muscle.contract(lane, m, 1, constants, 1e-3, 1 - np.exp(-0.1), fibres, work)
    return unit, fibres[Muscle.length + m, 0], fibres[Muscle.force + m, 0]


def interpreted_rows(angles: NDArray[np.float64]) -> tuple[Any, Any]:
    from taichi_nmm.kernel.layout import Muscle, Work

    fibres, work = np.zeros((Muscle.count, 1)), np.zeros((Work.count, 1))
    work[Work.joint : Work.joint + 6, 0] = np.tile(angles, 2)
    work[Work.sine_joint : Work.sine_joint + 4, 0] = np.tile(np.sin(angles[1:]), 2)
    work[Work.cosine_joint : Work.cosine_joint + 4, 0] = np.tile(np.cos(angles[1:]), 2)
    return fibres, work


def data_lengths(m: int) -> tuple[float, float]:
    """Optimal fibre and tendon slack length of muscle m, m."""
    from taichi_nmm.kernel.muscle_table import T_OPTIMAL, T_SLACK, muscle_table

    return float(muscle_table()[m, T_OPTIMAL]), float(muscle_table()[m, T_SLACK])


def unit_length(data: NDArray[np.float64], angles: NDArray[np.float64]) -> float:
    from taichi_nmm.kernel import muscle_table as real

    hip, knee, ankle = angles
    return float(
        data[real.T_LENGTH]
        + data[real.T_HIP_SLOPE] * hip
        + data[real.T_KNEE_SINE] * np.sin(knee)
        + data[real.T_KNEE_COSINE] * np.cos(knee)
        + data[real.T_ANKLE_SINE] * np.sin(ankle)
        + data[real.T_ANKLE_COSINE] * np.cos(ankle)
    )


@pytest.mark.slow
@pytest.mark.parametrize("m", range(len(MUSCLES)), ids=MUSCLES)
@pytest.mark.parametrize("activation", [0.05, 0.5, 1.0])
def test_isometric_force_solves_the_static_balance(muscle: Any, m: int, activation: float) -> None:
    angles = np.deg2rad([-10.0, 15.0, 0.0])
    unit, length, force = isometric(muscle, m, angles, activation)
    optimal, slack = data_lengths(m)

    def balance(x: float) -> float:
        tendon = max((unit - x * optimal) / slack - 1, 0.0) / REFERENCE
        buffer = max((1 - W) - x, 0.0) / (W / 2)
        passive = max((x - 1) / W, 0.0)
        active = activation * np.exp(np.log(C) * abs((x - 1) / W) ** 3)
        return float(tendon**2 + buffer**2 - active - passive**2)

    at_rest = brentq(balance, 0.05, (unit / optimal), xtol=1e-14)
    assert abs(length - at_rest) < 1e-6
    tendon = max((unit - at_rest * optimal) / slack - 1, 0.0) / REFERENCE
    assert force == pytest.approx(tendon**2, abs=1e-6)


@pytest.mark.parametrize("tendon_force", [0.2, 0.6, 0.95, 1.1, 1.3])
def test_quick_release_moves_at_the_inverse_of_the_force_velocity_curve(
    muscle: Any, tendon_force: float
) -> None:
    """With the tendon's force held (a step of no length) the speed is fv^-1(F / (A fl))."""
    length, activation = 0.9, 1.0
    capacity = activation * np.exp(np.log(C) * abs((length - 1) / W) ** 3)
    problem = [np.array([x]) for x in (0.0, np.sqrt(tendon_force), 0.0, 0.0, 0.0, capacity)]
    v = muscle.fibre_velocity(*problem)
    assert v[0] == pytest.approx(inverse_force_velocity(tendon_force / capacity), abs=1e-9)


def test_tension_and_its_derivatives(muscle: Any) -> None:
    """A tendon that goes slack and a buffer that lets go within the range."""
    v = np.linspace(-1.0, 3.0, 2001)
    lines = (0.1, 0.08, 0.02, 0.04)
    force, fall, bend = muscle.tension(v, *lines)
    assert (np.diff(force) <= 0).all() and (fall >= 0).all()
    assert np.isclose(force[0], 0.18**2 + 0.06**2) and force[-1] == 0.0
    step = v[1] - v[0]
    assert np.allclose(fall[1:-1], (force[:-2] - force[2:]) / (2 * step), atol=1e-4)
    smooth = np.abs(v[:, None] - [0.5, 1.25]).min(axis=1) > 2 * step
    second = (force[2:] - 2 * force[1:-1] + force[:-2]) / step**2
    assert np.allclose(2 * bend[1:-1][smooth[1:-1]], second[smooth[1:-1]], atol=1e-6)


@pytest.mark.slow
def test_fibre_speed_converges_on_walking_states() -> None:
    """Within 1e-6 of the balance as published, but for a few muscles that were just slack."""
    from taichi_nmm.kernel.muscle import ITERATIONS

    problem = convergence.walking_states(300)
    assert len(problem[0]) > 40_000
    assert np.isclose(convergence.exact_speed(problem), 0.0).mean() < 0.01  # they move
    error = convergence.errors(problem, ITERATIONS)
    assert np.mean(error > convergence.TOLERANCE) < 1e-4
    assert error.max() < 0.05
    assert convergence.errors(problem, convergence.CONVERGED).max() < convergence.TOLERANCE


def test_signed_arms_and_lengths_follow_the_table(muscle: Any) -> None:
    """The signed arm is minus the slope of the unit's length over rho (rho scales length only)."""
    from taichi_nmm.kernel import muscle_table as real

    table = real.muscle_table()
    step = 1e-6
    joints = {"knee": 1, "ankle": 2}
    torques = {"knee": real.T_KNEE_TORQUE_COSINE, "ankle": real.T_ANKLE_TORQUE_COSINE}
    for row, (_name, data) in zip(table, real.MUSCLE_DATA.items(), strict=True):
        for joint, index in joints.items():
            attachment = getattr(data, joint)
            if attachment is None:
                continue
            angles = np.deg2rad([-10.0, 25.0, 5.0])
            up, down = angles.copy(), angles.copy()
            up[index] += step
            down[index] -= step
            slope = (unit_length(row, up) - unit_length(row, down)) / (2 * step)
            cosine, angle = torques[joint], angles[index]
            torque = row[cosine] * np.cos(angle) + row[cosine + 1] * np.sin(angle)
            arm = torque / data.fmax_n
            assert slope == pytest.approx(-attachment.pennation * arm, abs=1e-8)


def test_metabolic_rate_is_continuous_and_positive(muscle: Any) -> None:
    v = np.linspace(-1.0, 1.0, 401)
    rate = muscle.metabolic_rate(v[None, :])[0]
    assert (rate > 0).all()
    assert rate[200] == pytest.approx(0.07, abs=1e-12)  # 0.01 + 0.06, and 0.23 - 0.16
