"""Exoskeleton and prosthesis: torques by closed forms, and what a walker does with them."""

import numpy as np
import pytest

import taichi_nmm
from taichi_nmm.kernel.layout import Const, State, Work
from taichi_nmm.parameters import (
    DEVICE,
    FIXED,
    LOW_LEVEL_GAINS,
    PUBLISHED_GAINS,
    load_gains,
)
from taichi_nmm.walkers import check_batch, constant_rows
from tests.cases import refused
from tests.parity.interpreter import interpreted

STRIDE, STANCE = 1000, 600  # ticks
TORQUE, PEAK, RISE, FALL = 30.0, 0.5, 0.25, 0.1


def torques(strides, worn, rate_radps=0.0):
    """Of all joints, which turn at a rate: [ticks, 6], of a leg that walks evenly and
    of one that hardly lifts.
    """
    (device,) = interpreted("device")
    state = State.of(np.zeros((State.count, 1)))
    work = Work.of(np.full((Work.count, 1), rate_radps))
    worlds = taichi_nmm.WorldRanges(exoskeleton=worn).draw([1])
    batch = check_batch(PUBLISHED_GAINS, worlds=worlds)
    const = Const.of(constant_rows(batch, taichi_nmm.Settings()).T)
    const.exo_torque[:] = TORQUE
    const.exo_peak[:] = PEAK
    const.exo_rise[:] = RISE
    const.exo_fall[:] = FALL
    found = []
    for tick in range(strides * STRIDE):
        since = tick % STRIDE
        state.touching[1] = since < STANCE  # the ball is enough
        state.touching[2] = since < STRIDE - 50  # too short a lift to be a swing
        device.assist(np.arange(1), state, const, work)
        found.append(state.device_torque[:, 0].copy())
    return np.array(found)


def test_the_torque_rises_and_falls_on_splines_once_a_stride_has_been_seen():
    every = torques(4, taichi_nmm.Exoskeleton())
    found = every[:, 2]
    assert not found[: 2 * STRIDE].any() and not every[:, [0, 1, 3, 4, 5]].any()
    share = (np.arange(STRIDE) + 1) / STRIDE
    up, down = (
        np.clip((share - PEAK + RISE) / RISE, 0, 1),
        np.clip((share - PEAK) / FALL, 0, 1),
    )
    expected = TORQUE * (3 * up**2 - 2 * up**3) * (1 - 3 * down**2 + 2 * down**3)
    for stride in found[2 * STRIDE :].reshape(2, STRIDE):
        np.testing.assert_allclose(stride, expected, atol=1e-12)
    assert (
        expected.max() == TORQUE and expected[int(1000 * (PEAK + FALL)) :].max() < 1e-3
    )


@pytest.mark.parametrize(
    ("motion", "joint", "sign"),
    [
        ("hip_extension", 0, 1),
        ("hip_flexion", 0, -1),
        ("knee_extension", 1, -1),
        ("knee_flexion", 1, 1),
        ("plantarflexion", 2, 1),
        ("dorsiflexion", 2, -1),
    ],
)
def test_it_helps_one_motion_of_a_side_with_no_more_than_its_power(motion, joint, sign):
    for side, worn in (("left", True), ("right", False), ("both", True)):
        found = torques(3, taichi_nmm.Exoskeleton(motion, side))
        assert np.ptp(found[:, joint] * sign) == (TORQUE if worn else 0.0)
        assert not np.delete(found, joint, axis=1).any()
    for rate in (2.0 * sign, -2.0 * sign):
        found = (
            torques(3, taichi_nmm.Exoskeleton(motion, power_w=20.0), rate)[:, joint]
            * sign
        )
        assert found.max() == pytest.approx(10.0 if rate == 2.0 * sign else TORQUE)


@pytest.mark.parametrize("engine", ["taichi", "mujoco"])
@pytest.mark.parametrize(
    ("motion", "curve", "power_w", "muscles"),
    [
        ("hip_extension", (15.0, 0.15, 0.1, 0.2), 30.0, ("ham", "glu")),
        ("plantarflexion", (TORQUE, PEAK, RISE, FALL), 1e6, ("sol", "gas")),
    ],
)
def test_it_takes_work_from_the_muscles_that_do_the_same(
    engine, motion, curve, power_w, muscles
):
    """Torque and power are as recorded, and a walker's muscles do less beside them."""
    worn = taichi_nmm.Exoskeleton(motion, "both", power_w)
    low_level = np.tile([each.default for each in LOW_LEVEL_GAINS], (2, 1))
    low_level[1, len(FIXED) : len(FIXED) + len(DEVICE)] = curve
    result = taichi_nmm.simulate(
        np.tile(load_gains("reference"), (2, 1)),
        duration_s=8.0,
        low_level_gains=low_level,
        worlds=taichi_nmm.WorldRanges(exoskeleton=worn).draw([1]),
        settings=taichi_nmm.Settings(arch="cpu", engine=engine),
        record=[1],
        record_rate_hz=1000,
    )
    assert (result["survived_fraction"] == 1.0).all()
    alone, helped = sum(result[f"activation_{name}_mean"] for name in muscles)
    assert 0.5 * alone < helped < 0.98 * alone
    walk = result.trajectories[0]
    joint = 0 if motion == "hip_extension" else 2
    torque = walk.device_torque_nm[:, joint]
    assert torque.max() == pytest.approx(curve[0], abs=0.1)
    assert not np.delete(walk.device_torque_nm, [joint, joint + 3], axis=1).any()
    rate = walk.qdot[:, 3 + joint] - walk.qdot[:, 2 + joint]
    assert np.max(torque[1:] * rate[:-1]) < 1.001 * power_w


def work_of_a_cycle(stiffness, damping):
    """Of a prosthesis on the right foot, which swings by 0.2 rad once a second, J."""
    (device,) = interpreted("device")
    times = np.arange(0.0, 1.0, 1e-3)
    const = Const.of(np.zeros((Const.count, 1000)))
    work = Work.of(np.zeros((Work.count, 1000)))
    const.ankle_stiffness[1] = stiffness
    const.ankle_rest[1] = 0.1
    const.ankle_damping[1] = damping
    angle = 0.3 + 0.2 * np.sin(2 * np.pi * times)
    rate = 0.4 * np.pi * np.cos(2 * np.pi * times)
    work.joint[5], work.joint_rate[5] = angle, rate
    torque = device.prosthesis_torque(np.arange(1000), 5, 1, const, work)
    np.testing.assert_allclose(torque, stiffness * (0.1 - angle) - damping * rate)
    return float(np.mean(torque * rate))


def test_a_prosthesis_gives_back_what_its_spring_took_and_never_more():
    for damping in (0.0, 1.5):  # c A^2 pi omega
        assert work_of_a_cycle(300.0, damping) == pytest.approx(
            -damping * 0.08 * np.pi**2
        )


@pytest.mark.parametrize("engine", ["taichi", "mujoco"])
def test_a_walker_with_a_prosthesis_has_no_muscle_across_that_ankle(engine):
    """Its ankle is where the spring alone balances the foot, which in the air weighs little."""
    foot = taichi_nmm.Prosthesis("right", 600.0, 1.0, 0.1)
    worlds = taichi_nmm.WorldRanges(prosthesis=foot).draw([1])
    settings = taichi_nmm.Settings
    (walked,) = taichi_nmm.simulate(
        PUBLISHED_GAINS,
        worlds=worlds,
        settings=settings(arch="cpu", engine=engine),
        record=[0],
    ).trajectories
    assert (
        not walked.muscle_force_n[:, 7:10].any() and walked.muscle_force_n[:, :3].any()
    )
    in_the_air = ~walked.stance[:, 1] & (walked.time_s > 0.1) & (walked.time_s < 0.4)
    np.testing.assert_allclose(walked.joint_rad[in_the_air, 5], 0.1, atol=0.02)
    rate = walked.qdot[:, 8] - walked.qdot[:, 7]
    # The angle at which the last step began.
    angle = walked.joint_rad[:, 5] - settings.physics_step_s * rate
    free = (angle > np.deg2rad(-20.0)) & (angle < np.deg2rad(40.0))  # of the stops
    torque_nm = 600.0 * (0.1 - angle) - 1.0 * rate
    np.testing.assert_allclose(
        walked.joint_torque_nm[free, 5], torque_nm[free], atol=1e-3
    )
    assert free.sum() > 100 and np.ptp(torque_nm[free]) > 100.0


def test_a_foot_too_light_for_its_damper_is_refused():
    worlds = taichi_nmm.WorldRanges(
        prosthesis=taichi_nmm.Prosthesis("left", 400.0, 2.0)
    ).draw([1])
    light = taichi_nmm.Bodies.nominal()
    light.inertia_kgm2[0, 3] = light.mass_kg[0, 3] = 1e-3
    with refused(r"^worlds\.prosthesis\.damping_nmsprad: 2.0 .* to 0.8 "):
        taichi_nmm.simulate(PUBLISHED_GAINS, bodies=light, worlds=worlds)
