"""The exoskeleton: its torque along the stride by closed forms, and what a walker does with it."""

import numpy as np
import pytest

import taichi_nmm
from taichi_nmm.kernel.layout import Const, State
from taichi_nmm.parameters import DEVICE, LOW_LEVEL_GAINS, load_gains
from tests.parity.interpreter import interpreted

STRIDE, STANCE = 1000, 600  # ticks
TORQUE, PEAK, RISE, FALL = 30.0, 0.5, 0.25, 0.1


def torques(strides: int) -> np.ndarray:
    """Of both ankles, [ticks, 2], of a leg that walks evenly and of one that hardly lifts."""
    (device,) = interpreted("device")
    state, const, lane = np.zeros((State.count, 1)), np.zeros((Const.count, 1)), np.arange(1)
    for name, value in zip(("torque", "peak", "rise", "fall"), (TORQUE, PEAK, RISE, FALL),
                           strict=True):  # fmt: skip
        const[getattr(Const, f"exo_{name}")] = value
    found = []
    for tick in range(strides * STRIDE):
        since = tick % STRIDE
        state[State.touching + 1] = since < STANCE  # the ball is enough
        state[State.touching + 2] = since < STRIDE - 50  # too short a lift to be a swing
        device.assist(lane, state, const)
        found.append(state[State.device_torque : State.device_torque + 2, 0].copy())
    return np.array(found)


def test_the_torque_rises_and_falls_on_splines_once_a_stride_has_been_seen() -> None:
    found = torques(4)
    assert not found[: 2 * STRIDE].any() and not found[:, 1].any()
    share = (np.arange(STRIDE) + 1) / STRIDE
    up, down = np.clip((share - PEAK + RISE) / RISE, 0, 1), np.clip((share - PEAK) / FALL, 0, 1)
    expected = TORQUE * (3 * up**2 - 2 * up**3) * (1 - 3 * down**2 + 2 * down**3)
    for stride in found[2 * STRIDE :, 0].reshape(2, STRIDE):
        np.testing.assert_allclose(stride, expected, atol=1e-12)
    assert expected.max() == TORQUE and expected[int(1000 * (PEAK + FALL)) :].max() < 1e-3


@pytest.mark.parametrize("engine", ["taichi", "mujoco"])
def test_the_plantarflexors_of_a_walker_do_less_beside_it(engine: str) -> None:
    settings = taichi_nmm.Settings(arch="cpu", engine=engine)
    low_level = np.tile([each.default for each in LOW_LEVEL_GAINS], (2, 1))
    low_level[1, -len(DEVICE) :] = TORQUE, PEAK, RISE, FALL
    gains = np.tile(load_gains("reference"), (2, 1))
    rows = taichi_nmm.simulate(
        gains, duration_s=8.0, low_level_gains=low_level, settings=settings
    ).rows
    assert (rows["survived_fraction"] == 1.0).all()
    for name in ("activation_sol_mean", "activation_gas_mean"):
        alone, helped = rows[name]
        assert 0.5 * alone < helped < 0.98 * alone
