"""A push and a slip at an instant of a walk: its impulse, its moment, and the cone of friction."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_nmm import (
    PUBLISHED_GAINS,
    Push,
    Settings,
    Slip,
    WorldRanges,
    Worlds,
    initial,
    simulate,
)
from taichi_nmm.body import HAT, Bodies
from taichi_nmm.kernel.layout import COORDINATES, Const, Work
from taichi_nmm.mujoco_engine import engine as mujoco_engine
from tests.cases import refused
from tests.parity import numpy_dynamics
from tests.parity.interpreter import interpreted

FORCE_N, WALKERS = 300.0, 50
PUSH = Push(time_s=0.2, duration_s=0.1, force_n=FORCE_N)
SLIP = Slip(time_s=0.3, duration_s=0.5, friction=0.1)
CPU = Settings(arch="cpu", threads=1)
DOUBLE = replace(CPU, precision="float64")


def walk(worlds=None, settings=CPU, duration_s=1.0, **words):
    return simulate(
        PUBLISHED_GAINS,
        duration_s=duration_s,
        worlds=worlds,
        record=[0],
        record_rate_hz=1000,
        settings=settings,
        **words,
    )


def test_a_push_does_its_work_at_the_trunks_centre_of_mass_between_its_ticks():
    (dynamics,) = interpreted("dynamics")
    rng = np.random.default_rng(5)
    q, qdot = rng.uniform(-1.0, 1.0, (2, WALKERS, COORDINATES))
    const = Const.of(np.zeros((Const.count, WALKERS)))
    work = Work.of(np.zeros((Work.count, WALKERS)))
    const.hat_weight[:], const.a_hat[:] = HAT.mass_kg * 9.81, -HAT.mass_kg * HAT.com_m
    const.push_n[:] = FORCE_N
    const.push_begin[:], const.push_end[:] = 3.0, 5.0
    const.push_end[0] = 0.0  # none
    const.slip_begin[:], const.slip_end[:], const.slip_friction[:] = 4.0, 6.0, 0.1
    work.sine[:], work.cosine[:] = np.sin(q[:, 2:]).T, np.cos(q[:, 2:]).T
    # Clockwise positive: a trunk that stands turns its top forwards.
    speed = qdot[:, 0] + HAT.com_m * np.cos(q[:, 2]) * qdot[:, 2]
    for tick in range(8):
        work.momentum[:], work.grip[:] = 0.0, 0.9
        dynamics.push_trunk(np.arange(WALKERS), tick, 1.0, const, work)
        force = np.full(WALKERS, FORCE_N if tick in (3, 4) else 0.0)
        force[0] = 0.0
        power = (work.momentum.T * qdot).sum(axis=1)
        np.testing.assert_allclose(power, force * speed, atol=1e-9)
        np.testing.assert_allclose(work.momentum[0], force, atol=1e-12)
        assert np.all(work.grip == (0.1 if tick in (4, 5) else 0.9))


@pytest.mark.parametrize("engine", ["taichi", "mujoco"])
def test_in_the_air_the_walker_gains_the_impulse_and_its_moment(engine, monkeypatch):
    """On both engines: muscles and stops are inner forces."""
    monkeypatch.setattr(initial, "PENETRATION_M", -50.0)  # that high over the ground
    if engine == "mujoco":
        monkeypatch.setattr(mujoco_engine, "PENETRATION_M", 0.0)
    settings = Settings(engine=engine, arch="cpu", precision="float64")
    worlds = WorldRanges(push=PUSH).draw([1])
    flown = walk(worlds, settings, duration_s=0.5).trajectories[0]
    assert not flown.ground_force_n.any()
    body = Bodies.nominal()
    state = (flown.q, flown.qdot, body)
    impulse_ns = FORCE_N * PUSH.duration_s
    gained = numpy_dynamics.momentum(*state)[:, 0]
    assert gained[-1] - gained[0] == pytest.approx(impulse_ns, rel=0.01)
    com_z = (numpy_dynamics.com_positions(flown.q, body)[:, :, 1] * body.mass_kg).sum(1)
    trunk_z = flown.q[:, 1] + HAT.com_m * np.cos(flown.q[:, 2])
    above = trunk_z - com_z / body.mass_kg.sum()
    turning = numpy_dynamics.angular_momentum(*state)
    taken = np.cumsum(flown.push_n[:, 0] * above) * 1e-3
    assert np.abs(turning - turning[0] - taken).max() < 0.02 * taken.max()


@pytest.mark.parametrize(
    "settings", [CPU, DOUBLE, replace(DOUBLE, physics_step_s=5e-4)]
)
def test_on_the_ground_momentum_is_the_push_and_what_the_ground_gives(settings):
    pushed = walk(WorldRanges(push=PUSH).draw([1]), settings, 0.6).trajectories[0]
    body = Bodies.nominal()
    momentum = numpy_dynamics.momentum(pushed.q, pushed.qdot, body)[:, 0]
    ground_ns = pushed.ground_force_n[1:, ::2].sum() * 1e-3
    impulse_ns = momentum[-1] - momentum[0] - ground_ns
    assert impulse_ns == pytest.approx(FORCE_N * PUSH.duration_s, rel=0.01)


def test_recorded_pushes_are_means_over_the_samples_intervals():
    worlds = WorldRanges(push=replace(PUSH, time_s=0.203)).draw([1])
    coarse, fine = (
        simulate(
            PUBLISHED_GAINS,
            duration_s=0.5,
            worlds=worlds,
            record=[0],
            record_rate_hz=rate,
            settings=CPU,
        )
        .trajectories[0]
        .push_n[:, 0]
        for rate in (100.0, 1000.0)
    )
    assert np.flatnonzero(fine).tolist() == list(range(203, 303))
    np.testing.assert_allclose(coarse, fine.reshape(-1, 10).mean(axis=1), atol=1e-9)
    assert coarse.max() == FORCE_N and 0.0 < coarse[20] < FORCE_N


def test_a_foot_slips_where_friction_is_little_and_only_then():
    walks = [
        walk(worlds, DOUBLE).trajectories[0]
        for worlds in (WorldRanges(slip=SLIP).draw([1]), None)
    ]
    slipped, held = (
        np.abs(each.ground_force_n[:, ::2])
        / np.maximum(each.ground_force_n[:, 1::2], 1e-9)
        for each in walks
    )
    meanwhile = slice(300, 800)
    on = walks[0].ground_force_n[meanwhile, 1::2] > 0.0
    assert slipped[meanwhile][on].max() == pytest.approx(
        SLIP.friction
    )  # the cone's edge
    assert held[meanwhile].max() > 2.0 * SLIP.friction
    np.testing.assert_array_equal(walks[0].q[:300], walks[1].q[:300])


@pytest.mark.parametrize("settings", [CPU, DOUBLE])
def test_others_of_the_batch_keep_their_bits_and_a_push_of_nothing_is_none(settings):
    nominal = WorldRanges()
    worlds = Worlds.stacked(
        each.draw([1])
        for each in (
            nominal,
            WorldRanges(push=PUSH, slip=SLIP),
            WorldRanges(push=replace(PUSH, force_n=0.0)),
            WorldRanges(push=replace(PUSH, time_s=5.0), slip=replace(SLIP, time_s=5.0)),
        )
    )
    rows = simulate(
        np.tile(PUBLISHED_GAINS, (4, 1)),
        duration_s=2.0,
        worlds=worlds,
        settings=settings,
    ).rows
    alone = simulate(PUBLISHED_GAINS, duration_s=2.0, settings=settings).rows[0]
    assert [row.tobytes() == alone.tobytes() for row in rows] == [
        True,
        False,
        True,
        True,
    ]


def test_mujoco_has_no_slip():
    with refused(r"^worlds\.slip: .*none with the engine mujoco"):
        walk(WorldRanges(slip=SLIP).draw([1]), Settings(engine="mujoco", arch="cpu"))
