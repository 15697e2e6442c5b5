"""The Hill unit against its closed forms."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from storage.points import sobol_points
from taichi_nmm import GAINS, PUBLISHED_GAINS, Settings, Worlds, terrain
from taichi_nmm.initial import initial_rows
from taichi_nmm.kernel.layout import MUSCLES_PER_LEG, Const, Muscle, WalkerRows, Work
from taichi_nmm.kernel.muscle_table import (
    MUSCLE_DATA,
    SLACK_LENGTH_M,
    muscle_table,
    unit_lengths,
)
from taichi_nmm.result import MUSCLES
from taichi_nmm.walkers import blends, check_batch, constant_rows
from tests.parity.interpreter import AllLanes, interpreted_walker

W, C, N, K, REFERENCE = 0.56, 0.05, 1.5, 5.0, 0.04  # Geyer & Herr 2010
ACTIVATIONS = np.array([0.05, 0.5, 1.0])
RESTING_RAD = np.deg2rad([-10.0, 15.0, 0.0])  # hip, knee, ankle
AT_REST = 1e-13  # that no row of a fibre changes by in a millisecond
WALKERS = 256  # at Sobol points
SEED = 2016  # of these points
SAMPLED_TICKS = 20  # a state is recorded so often
CONVERGED = 8  # iterations
TOLERANCE = 1e-6  # of a speed over vmax
SLOWEST, FASTEST = -1.0, 3.0

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def muscle():
    return interpreted_walker().muscle


def inverse_force_velocity(f):
    """The closed inverse of both branches."""
    if f < 1:
        return (f - 1) / (1 + K * f)
    return ((N - 1) + (f - N)) / ((N - 1) - 7.56 * K * (f - N))


def force_velocity(v):
    """Hill's curve as published, and the line beyond v = 1; lengthening positive."""
    with np.errstate(divide="ignore"):
        shortening = (1 + v) / (1 - K * v)
        lengthening = N + (N - 1) * (v - 1) / (1 + 7.56 * K * v)
    return np.where(
        v < 0, shortening, np.where(v < 1, lengthening, N + 100.0 * (v - 1))
    )


def quotient(muscle, v):
    """The force factor of the range that each speed lies in."""
    a, b, c = muscle.force_velocity(v < 0.0, v >= 1.0)
    return np.asarray((a + b * v) / (1.0 + c * v))


def test_force_length_velocity_and_metabolic_rate_are_the_published_curves(muscle):
    length = np.linspace(0.2, 1.9, 200)
    expected = np.exp(np.log(C) * np.abs((length - 1) / W) ** 3)
    assert np.allclose(muscle.force_length(length), expected, rtol=1e-12)
    assert np.isclose(muscle.force_length(np.array([1 + W]))[0], C)
    v = np.linspace(-1.0, 0.999, 400)
    assert np.allclose(quotient(muscle, v), force_velocity(v), rtol=1e-12)
    ends = quotient(muscle, np.array([-1.0, 0.0, 1.0, 1.5]))
    assert np.allclose(ends, [0.0, 1.0, N, N + 50.0])
    just_below = quotient(muscle, np.array([0.0, 1.0]) - 1e-12)
    assert np.allclose(just_below, [1.0, N])
    rate = muscle.metabolic_rate(np.linspace(-1.0, 1.0, 401))
    assert (rate > 0).all()
    assert rate[200] == pytest.approx(0.07, abs=1e-12)  # 0.01 + 0.06, and 0.23 - 0.16


@cache
def isometric(m, own):
    """Contract muscle m at fixed joint angles until it rests: walkers of ACTIVATIONS together."""
    walker = interpreted_walker()
    lanes = np.arange(len(ACTIVATIONS))
    muscle = walker.muscle
    fibres, work = interpreted_rows(RESTING_RAD, len(lanes))
    data = list(MUSCLE_DATA.values())[m]
    worlds = Worlds.nominal(len(lanes))
    if own:  # a fibre 10 % shorter, a tendon 2 % longer
        fibre, slack = 0.9 * data.optimal_length_m, 1.02 * data.slack_length_m
        data = replace(data, optimal_length_m=fibre, slack_length_m=slack)
        every = np.ones((3, 14))
        worlds = replace(worlds, optimal_length=0.9 * every, slack_length=1.02 * every)
    batch = check_batch(np.tile(PUBLISHED_GAINS, (len(lanes), 1)), worlds=worlds)
    const = Const.of(constant_rows(batch, Settings()).T)
    unit = unit_lengths(*RESTING_RAD)[m]
    for i in (m, m + MUSCLES_PER_LEG):
        fibres.activation[i] = fibres.stimulation[i] = ACTIVATIONS
        fibres.length[i] = (unit - data.slack_length_m) / data.optimal_length_m
    constants = muscle.constants(muscle_table(1e-3), m)
    walker.joints.stretch_tendons(lanes, work)
    relaxed = work[:].copy()
    for _ in range(3000):
        before = fibres[:].copy()
        muscle.activate(lanes, m, constants, 1 - np.exp(-0.1), own, fibres, const, work)
        for _ in range(muscle.ITERATIONS):
            muscle.balance(lanes, m, constants, own, fibres, const, work)
        muscle.contract(lanes, m, constants, own, fibres, const, work)
        work[:] = relaxed
        if np.abs(fibres[:] - before).max() < AT_REST:
            break
    return data, unit, fibres.length[m], fibres.force[m]


def interpreted_rows(angles, walkers=1):
    """Rows of muscles, and of `Work` with both legs at these joint angles."""
    fibres = Muscle.of(np.zeros((Muscle.count, walkers)))
    work = Work.of(np.zeros((Work.count, walkers)))
    both = np.tile(angles, 2)[:, None]
    work.joint[:] = both
    work.sine_joint[:] = np.sin(both)[[1, 2, 4, 5]]
    work.cosine_joint[:] = np.cos(both)[[1, 2, 4, 5]]
    return fibres, work


@pytest.mark.slow
@pytest.mark.parametrize("m", range(len(MUSCLES)), ids=MUSCLES)
@pytest.mark.parametrize("walker", range(len(ACTIVATIONS)), ids=ACTIVATIONS.astype(str))
@pytest.mark.parametrize("own", [False, True])
def test_isometric_force_solves_the_static_balance(m, walker, own):
    data, unit, lengths, forces = isometric(m, own)
    activation, length, force = ACTIVATIONS[walker], lengths[walker], forces[walker]
    optimal, slack = data.optimal_length_m, data.slack_length_m

    def balance(x):
        tendon = max((unit - x * optimal) / slack - 1, 0.0) / REFERENCE
        buffer = max((1 - W) - x, 0.0) / (W / 2)
        passive = max((x - 1) / W, 0.0)
        active = activation * np.exp(np.log(C) * abs((x - 1) / W) ** 3)
        return float(tendon**2 + buffer**2 - active - passive**2)

    at_rest = brentq(balance, 0.05, (unit / optimal), xtol=1e-14)
    assert abs(length - at_rest) < 1e-6
    tendon = max((unit - at_rest * optimal) / slack - 1, 0.0) / REFERENCE
    assert force == pytest.approx(tendon**2, abs=1e-6)


def fibre_speed(muscle, problem, iterations):
    """What the iterations of an interpreted module `muscle` find."""
    _start, *springs, _capacity = problem
    v, *fibre = muscle.speed_range(*problem)
    for _ in range(iterations):
        v = muscle.nearer(v, *fibre, *springs)
    return np.asarray(v)


@pytest.mark.parametrize("tendon_force", [0.2, 0.6, 0.95, 1.1, 1.3])
def test_quick_release_moves_at_inverse_force_velocity(muscle, tendon_force):
    """With the tendon's force held (a step of no length) the speed is fv^-1(F / (A fl))."""
    length, activation = 0.9, 1.0
    capacity = activation * np.exp(np.log(C) * abs((length - 1) / W) ** 3)
    problem = [
        np.array([x]) for x in (0.0, np.sqrt(tendon_force), 0.0, 0.0, 0.0, capacity)
    ]
    v = fibre_speed(muscle, problem, muscle.ITERATIONS)
    assert v[0] == pytest.approx(
        inverse_force_velocity(tendon_force / capacity), abs=1e-9
    )


def walking_states(ticks):
    """Arguments of `speed_range` met in `ticks` on flat ground, of all muscles that are up."""
    walker = interpreted_walker()
    muscle = walker.muscle
    muscle.ITERATIONS = CONVERGED
    find_range = muscle.speed_range
    met = []
    recorded = []

    def recording(*arguments):
        met.append(np.array(np.broadcast_arrays(*arguments)))
        return find_range(*arguments)

    muscle.speed_range = recording
    flat = terrain.flat()
    step_s = 1e-3
    batch = check_batch(sobol_points(SEED, 0, WALKERS, GAINS))
    rows = WalkerRows.of(np.tile(initial_rows(flat)[:, None], WALKERS))
    const = Const.of(constant_rows(batch, Settings()).T)
    work = Work.of(np.zeros((Work.count, WALKERS)))
    for tick in range(ticks):
        with np.errstate(all="ignore"):
            walker.step(
                tick,
                1,
                step_s,
                *blends(step_s),
                0,
                AllLanes(WALKERS),
                batch.terrain_index,
                flat.height_m[None, :],
                muscle_table(step_s),
                rows.state,
                rows.fibres,
                rows.delay,
                rows.events,
                rows.sums,
                const,
                work,
            )
        if tick % SAMPLED_TICKS == SAMPLED_TICKS - 1:
            up = rows.state.active > 0.5
            recorded += [arguments[:, up] for arguments in met]
        met.clear()
    return list(np.concatenate(recorded, axis=1))


def exact_speed(problem):
    """The balance by bisection of the equation as published."""
    _start, strain, strain_rate, squeeze, squeeze_rate, capacity = problem
    low, high = np.full_like(strain, SLOWEST), np.full_like(strain, FASTEST)
    for _ in range(60):
        v = 0.5 * (low + high)
        tendon = np.maximum(strain - strain_rate * v, 0.0)
        buffer = np.maximum(squeeze - squeeze_rate * v, 0.0)
        pulls = tendon**2 + buffer**2 > capacity * force_velocity(v)
        low, high = np.where(pulls, v, low), np.where(pulls, high, v)
    return 0.5 * (low + high)


def errors(problem, iterations):
    """Of the speed that so many iterations find, by the walker's own source."""
    with np.errstate(all="ignore"):
        found = fibre_speed(interpreted_walker().muscle, problem, iterations)
        return np.abs(found - exact_speed(problem))


@pytest.mark.slow
def test_fibre_speed_converges_on_walking_states():
    """Within 1e-6 of the balance as published, but for a few muscles that were just slack."""
    problem = walking_states(300)
    assert len(problem[0]) > 40_000
    assert np.isclose(exact_speed(problem), 0.0).mean() < 0.01  # they move
    error = errors(problem, interpreted_walker().muscle.ITERATIONS)
    assert np.mean(error > TOLERANCE) < 1e-4
    assert error.max() < 0.05
    assert errors(problem, CONVERGED).max() < TOLERANCE


@pytest.mark.parametrize("joint", range(3), ids=["hip", "knee", "ankle"])
def test_torques_do_the_work_of_the_lengths(joint):
    """A torque is minus the length's slope times Fmax over rho (rho scales length only)."""
    joints = interpreted_walker().joints
    step = 1e-6
    angles = np.deg2rad([-10.0, 25.0, 5.0])
    turn = step * np.eye(3)[joint]
    slopes = (unit_lengths(*(angles + turn)) - unit_lengths(*(angles - turn))) / (
        2 * step
    )
    for m, (data, slope) in enumerate(zip(MUSCLE_DATA.values(), slopes, strict=True)):
        fibres, work = interpreted_rows(angles)
        fibres.force[m] = 1.0
        joints.turn_joints(np.arange(1), fibres, work)
        attachment = (data.hip, data.knee, data.ankle)[joint]
        pennation = 1.0 if attachment is None else attachment.pennation
        torque_nm = work.joint_torque[joint, 0]
        assert torque_nm == pytest.approx(-slope * data.fmax_n / pennation, abs=1e-4)
        assert (attachment is None) == (torque_nm == 0.0)
    assert not work.joint_torque[3:].any()  # the other leg's


def test_strains_follow_the_lengths():
    """Of each tendon over its reference, at fibre length 0."""
    angles = np.deg2rad([-10.0, 25.0, 5.0])
    _fibres, work = interpreted_rows(angles)
    interpreted_walker().joints.stretch_tendons(np.arange(1), work)
    expected = (unit_lengths(*angles) / SLACK_LENGTH_M - 1.0) / REFERENCE
    assert np.allclose(work.strain[:, 0], np.tile(expected, 2), rtol=1e-12)
