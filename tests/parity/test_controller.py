"""`Controller` driven with recorded states of the simulator makes the simulator's torques."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_nmm import Controller
from taichi_nmm.body import Bodies
from taichi_nmm.kernel.joints import HIP_EXTENSION_LIMIT_RAD
from taichi_nmm.observation import Observation
from taichi_nmm.parameters import PUBLISHED_GAINS, load_gains, lower_bounds, upper_bounds
from taichi_nmm.settings import Settings
from tests.parity.recorded import Walks, record, sensed, sensed_in_float32

pytestmark = pytest.mark.slow

WALKERS = 12
TICKS = 20_000  # 20 s
NEAR = 0.07  # of each gain of the published gains


def twelve_gains() -> np.ndarray:
    """The published gains, the reference gait, and ten near the published gains."""
    rng = np.random.default_rng(3)
    gains = np.tile(PUBLISHED_GAINS, (WALKERS, 1))
    gains[1] = load_gains("reference")
    gains[2:] *= rng.uniform(1.0 - NEAR, 1.0 + NEAR, gains[2:].shape)
    return np.asarray(np.clip(gains, lower_bounds(), upper_bounds()))


def largest_difference(walks: Walks, states: list[Observation], settings: Settings) -> float:
    """Between the controllers' torques and the walkers', over the largest torque of all."""
    controller = Controller(twelve_gains(), settings=settings)
    torque = np.array([controller.step(sensed) for sensed in states])
    largest = np.abs(walks.torque_nm[walks.up]).max()
    return float(np.abs(torque - walks.torque_nm)[walks.up].max() / largest)


@pytest.mark.parametrize(("precision", "bound"), [("float64", 1e-12), ("float32", 1e-6)])
def test_recorded_states_give_the_torques_of_the_walk(precision: str, bound: float) -> None:
    settings = Settings(precision=precision, arch="cpu")
    walks = record(twelve_gains(), TICKS, settings)
    assert walks.up[-1, :2].all()  # The published gains and the reference walk to the end
    double = precision == "float64"
    states = sensed(walks, Bodies.nominal(WALKERS)) if double else sensed_in_float32(walks)
    found = largest_difference(walks, states, settings)
    assert found <= bound


def test_the_stop_of_the_hip_is_the_bodys_own() -> None:
    """In swing only the leg's angle and length count: a hip far beyond its limit changes nothing,
    where the stop would turn it by some N m."""
    inside = Observation(
        joint_rad=[[0.3, 0.4, 0.0] * 2], joint_rate_radps=[[0.0] * 6],
        trunk_rad=[0.0], trunk_rate_radps=[0.0], contact=[[False, False]], load_n=[[0.0, 0.0]],
        leg_length_m=[[0.95, 0.95]], leg_angle_rad=[[1.5, 1.5]], com_ahead_m=[[0.0, 0.0]],
        com_speed_mps=[1.3],
    )  # fmt: skip
    bent = np.array([[HIP_EXTENSION_LIMIT_RAD + 0.3, 0.4, 0.0] * 2])
    torques = [
        Controller(PUBLISHED_GAINS, settings=Settings(precision="float64")).step(state)
        for state in (inside, replace(inside, joint_rad=bent))
    ]
    np.testing.assert_array_equal(torques[0][:, [0, 3]], torques[1][:, [0, 3]])
    assert np.abs(torques[0][:, [0, 3]]).min() > 0.0
