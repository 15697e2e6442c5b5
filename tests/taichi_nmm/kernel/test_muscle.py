"""The Hill unit against its closed forms."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from taichi_nmm.result import MUSCLES
from tests.parity.interpreter import interpreted_walker

W, C, N, K, REFERENCE = 0.56, 0.05, 1.5, 5.0, 0.04  # Geyer & Herr 2010
SOLVER_TOLERANCE = 1e-9


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
    assert np.allclose(muscle.force_length(length), expected, rtol=1e-12)
    assert np.isclose(muscle.force_length(np.array([1 + W]))[0], C)


def test_force_velocity_value_slope_and_joins(muscle: Any) -> None:
    v = np.linspace(-1.5, 0.999, 400)
    factor, slope = muscle.force_velocity(v)
    assert np.allclose(factor, [force_velocity(x) for x in v], rtol=1e-12)
    step = 1e-6
    up, down = muscle.force_velocity(v + step)[0], muscle.force_velocity(v - step)[0]
    away = np.abs(v) > 1e-5
    assert np.allclose(slope[away], ((up - down) / (2 * step))[away], rtol=1e-4)
    ends = muscle.force_velocity(np.array([-1.0, 0.0, 1.0, 1.5]))[0]
    assert np.allclose(ends, [0.0, 1.0, N, N + 50.0])


def isometric(muscle: Any, m: int, angles: NDArray[np.float64], activation: float) -> Any:
    """Contract muscle m at fixed joint angles (hip, knee, ankle) until it rests."""
    rows = interpreted_rows(angles)
    fibres, work = rows
    data = muscle.muscle_table()[m]
    from taichi_nmm.kernel.layout import Muscle

    unit = unit_length(data, angles)
    fibres[Muscle.activation + m] = fibres[Muscle.stimulation + m] = activation
    fibres[Muscle.length + m] = (unit - data[muscle.T_SLACK]) / data[muscle.T_OPTIMAL]
    lane = np.arange(1)
    for _ in range(3000):
        muscle.contract(lane, 0, m, data, 1e-3, 1 - np.exp(-0.1), fibres, work)
    return unit, data, fibres[Muscle.length + m, 0], fibres[Muscle.force + m, 0]


def interpreted_rows(angles: NDArray[np.float64]) -> tuple[Any, Any]:
    from taichi_nmm.kernel.layout import Muscle, Work

    fibres, work = np.zeros((Muscle.count, 1)), np.zeros((Work.count, 1))
    work[Work.joint : Work.joint + 3, 0] = angles
    work[Work.sine_joint : Work.sine_joint + 2, 0] = np.sin(angles[1:])
    work[Work.cosine_joint : Work.cosine_joint + 2, 0] = np.cos(angles[1:])
    return fibres, work


def unit_length(data: NDArray[np.float64], angles: NDArray[np.float64]) -> float:
    from taichi_nmm.kernel import muscle as real

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
    unit, data, length, force = isometric(muscle, m, angles, activation)
    optimal, slack = data[muscle.T_OPTIMAL], data[muscle.T_SLACK]

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
    """With the tendon's force held (a step of no length) the speed is fv^-1(F / (A fl)).

    Four safeguarded iterations a step, each starting where the last ended, as within a walk.
    """
    length, activation, optimal, slack = 0.9, 1.0, 0.04, 0.26
    unit = length * optimal + slack * (1 + REFERENCE * np.sqrt(tendon_force))
    capacity = activation * np.exp(np.log(C) * abs((length - 1) / W) ** 3)
    args = [np.array([x]) for x in (length, unit, optimal, slack, 0.0, capacity)]
    v = np.zeros(1)
    for _ in range(5):
        v = muscle.fibre_velocity(v, *args)
    assert v[0] == pytest.approx(inverse_force_velocity(tendon_force / capacity), abs=1e-9)
    assert abs(muscle.imbalance(v, *args)[0][0]) < SOLVER_TOLERANCE


def test_imbalance_is_strictly_decreasing(muscle: Any) -> None:
    v = np.linspace(-3.0, 3.0, 2001)
    value, rate = muscle.imbalance(v, 0.9, 0.31, 0.04, 0.26, 6e-3, 0.3)
    assert (np.diff(value) < 0).all() and (rate < 0).all()


def test_signed_arms_and_lengths_follow_the_table(muscle: Any) -> None:
    """The signed arm is minus the slope of the unit's length over rho (rho scales length only)."""
    from taichi_nmm.kernel import muscle as real

    table = real.muscle_table()
    step = 1e-6
    joints = {"knee": 1, "ankle": 2}
    arms = {"knee": (real.T_KNEE_ARM_COSINE,) * 2, "ankle": (real.T_ANKLE_ARM_COSINE,) * 2}
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
            cosine = arms[joint][0]
            arm = row[cosine] * np.cos(angles[index]) + row[cosine + 1] * np.sin(angles[index])
            assert slope == pytest.approx(-attachment.pennation * arm, abs=1e-8)


def test_metabolic_rate_is_continuous_and_positive(muscle: Any) -> None:
    v = np.linspace(-1.0, 1.0, 401)
    rate = muscle.metabolic_rate(v)
    assert (rate > 0).all()
    assert rate[200] == pytest.approx(0.07, abs=1e-12)  # 0.01 + 0.06, and 0.23 - 0.16
