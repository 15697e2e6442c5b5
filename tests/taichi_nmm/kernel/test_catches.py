"""Catches of the feet: when and how strong, equal work at the ball, and momentum in free flight."""

import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_nmm import PUBLISHED_GAINS, Settings, Worlds, initial, simulate
from taichi_nmm.body import BALL_OFFSET_M, SHANK_LENGTH_M, THIGH_LENGTH_M, Bodies
from taichi_nmm.kernel.layout import COORDINATES, Const, Signal, Work
from taichi_nmm.mujoco_engine import engine as mujoco_engine
from tests.parity import numpy_dynamics
from tests.parity.interpreter import interpreted

LARGEST_NS, SLOTS, WALKERS = 8.0, 3, 400
FLIGHT_S, SEED = 0.6, 6  # both legs catch within
LEVERS_M = np.array([THIGH_LENGTH_M, SHANK_LENGTH_M, BALL_OFFSET_M])
Array = NDArray[np.float64]


def share(seed, slot, number):
    """The documented hash, in Python's whole numbers: 0 to 1."""
    word = slot * 0x85EBCA6B + seed * 0x7FEB352D + number * 0x9E3779B9 & 0xFFFFFFFF
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B), (16, 1)):
        word = (word ^ word >> shift) * factor & 0xFFFFFFFF
    return (word >> 8) / 2**24


def pulls(seed, largest_ns, ticks):
    """Force on the balls at each tick, N, [t, leg]."""
    force = np.zeros((ticks + 1000, 2))
    for slot in range(ticks // 1000 + 1):
        for leg in range(2):
            number = Signal.count + 1 + 2 * leg
            first = 1000 * slot + int(share(seed, slot, number) * 981)
            pull = share(seed, slot, number + 1) * largest_ns / 0.02
            force[first : first + 20, leg] = -pull
    return force[:ticks]


def test_each_leg_is_held_once_a_slot_by_the_documented_hash_with_equal_work_at_the_ball():
    (dynamics,) = interpreted("dynamics")
    rng = np.random.default_rng(5)
    q, qdot = rng.uniform(-1.0, 1.0, (2, WALKERS, COORDINATES))
    seeds = rng.integers(2**24, size=WALKERS)
    ticks = 1000 * SLOTS
    const = Const.of(np.zeros((Const.count, WALKERS)))
    work = Work.of(np.zeros((Work.count, WALKERS)))
    const.noise_seed[:] = seeds
    const.catch_ns[1:] = LARGEST_NS
    work.sine[:] = np.sin(q[:, 2:]).T
    work.cosine[:] = np.cos(q[:, 2:]).T
    turn = numpy_dynamics.clockwise_quarter_turn(numpy_dynamics.unit_vectors(q))[
        :, 1:, 0
    ]
    relative = (LEVERS_M * (turn * qdot[:, 3:]).reshape(WALKERS, 2, 3)).sum(axis=2)
    speed = qdot[:, :1] + relative  # of the balls, forward
    # Forces are [n, t, leg].
    forces = np.array([pulls(int(seed), LARGEST_NS, ticks) for seed in seeds])
    forces[0] = 0.0
    with np.errstate(over="ignore"):
        for tick in range(ticks):
            work.momentum[:] = 0.0
            dynamics.catch_feet(np.arange(WALKERS), tick, 1.0, const, work)
            power = (work.momentum.T * qdot).sum(axis=1)
            np.testing.assert_allclose(
                power, (forces[:, tick] * speed).sum(axis=1), atol=1e-9
            )
            np.testing.assert_allclose(
                work.momentum[0], forces[:, tick].sum(axis=1), atol=1e-9
            )
    held = forces[1:].reshape(WALKERS - 1, SLOTS, 1000, 2)
    assert ((held != 0.0).sum(axis=2) == 20).all()  # wholly within its slot
    impulse, first = (
        -held.sum(axis=2).ravel() * 1e-3,
        (held != 0.0).argmax(axis=2).ravel(),
    )
    for values, high in ((impulse, LARGEST_NS), (first, 981)):  # both uniform
        counts = np.histogram(values, 10, (0, high))[0]
        assert np.abs(counts - values.size / 10).max() < 5 * np.sqrt(values.size / 10)
    assert abs(np.corrcoef(impulse, first)[0, 1]) < 5 / np.sqrt(impulse.size)


@pytest.mark.parametrize("engine", ["taichi", "mujoco"])
def test_a_catch_in_the_air_takes_its_impulse_and_its_moment(engine, monkeypatch):
    """Of the walker's momenta, on both engines: muscles and stops are inner forces."""
    monkeypatch.setattr(initial, "PENETRATION_M", -50.0)  # that high over the ground
    if engine == "mujoco":
        monkeypatch.setattr(mujoco_engine, "PENETRATION_M", 0.0)
    worlds = vars(Worlds.nominal()) | {"noise_seed": [SEED], "catch_ns": [4.0]}
    flown = simulate(
        PUBLISHED_GAINS,
        duration_s=FLIGHT_S,
        worlds=Worlds(**worlds),
        record=[0],
        settings=Settings(engine=engine, arch="cpu", precision="float64"),
        record_rate_hz=1000,
    ).trajectories[0]
    assert len(flown.q) == round(FLIGHT_S * 1000) and not flown.ground_force_n.any()
    state = (flown.q, flown.qdot, Bodies.nominal())
    body = Bodies.nominal()
    force = pulls(SEED, 4.0, len(flown.q))
    assert (force != 0.0).sum(axis=0).tolist() == [20, 20]
    com_z = (numpy_dynamics.com_positions(flown.q, body)[:, :, 1] * body.mass_kg).sum(
        axis=1
    )
    limbs = numpy_dynamics.unit_vectors(flown.q)[:, 1:, 1].reshape(-1, 2, 3)
    above = (
        flown.q[:, 1:2]
        + (LEVERS_M * limbs).sum(axis=2)
        - com_z[:, None] / body.mass_kg.sum()
    )
    for momentum, rate in (
        (numpy_dynamics.momentum(*state)[:, 0], force),
        (numpy_dynamics.angular_momentum(*state), force * above),
    ):
        taken = np.cumsum(rate.sum(axis=1)) * 1e-3
        error = np.abs(momentum - momentum[0] - taken).max()
        assert error < 0.02 * np.abs(taken).max()  # the integrator's, at 1 ms
