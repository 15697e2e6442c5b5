"""Limits of MuJoCo's against the law of the walker's stops, by torque."""

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_nmm.body import Bodies
from taichi_nmm.kernel.joints import STOP_STIFFNESS_NMPRAD
from taichi_nmm.mujoco_engine.mjcf import JOINTS, LEAST_RANGE_RAD, STOPS, limit, walk_model
from taichi_nmm.settings import MujocoSettings, Settings

SECONDS = 0.3
TOLERANCE = 0.3  # a curve of MuJoCo's family is not the law; its default is off by several times
FROM_S = 0.05  # before, the limb is still being slowed down
BENT_RAD = 0.5


def crept(
    joint: str, torque_nm: float, step_s: float, limits: str = "stops"
) -> NDArray[np.float64]:
    """Angle beyond the limit under a constant torque, from the limit on, in the air, [t] rad."""
    settings = Settings(
        engine="mujoco", physics_step_s=step_s, mujoco=MujocoSettings(limits=limits)
    )
    model = walk_model(Bodies.nominal(), settings, 0.9)
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    index, stop = JOINTS.index(joint), STOPS[joint.split("_")[0]]
    low = joint.startswith("shank")
    start, sign = (stop.low_rad, -1.0) if low else (stop.high_rad, 1.0)
    data.qpos[1] = 5.0
    data.qpos[[4, 7]] = BENT_RAD  # the knees
    data.qpos[3 + index] = start
    data.ctrl[index] = sign * torque_nm
    beyond = []
    for _ in range(round(SECONDS / step_s)):
        mujoco.mj_step(model, data)
        beyond.append(sign * (data.qpos[3 + index] - start))
    return np.array(beyond)


def law(joint: str, torque_nm: float, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same by D' = w_max (T/(k D) - 1), D(0) = 0: with L = T/k and W = w_max t, it is
    -D - L ln(1 - D/L) = W, whose beginning is D = sqrt(2 L W)."""
    largest = torque_nm / STOP_STIFFNESS_NMPRAD
    way = STOPS[joint.split("_")[0]].relaxation_radps * times_s
    low, high = np.zeros_like(way), np.full_like(way, largest * (1 - 1e-12))
    for _ in range(100):
        middle = 0.5 * (low + high)
        too_far = -middle - largest * np.log1p(-middle / largest) > way
        low, high = np.where(too_far, low, middle), np.where(too_far, middle, high)
    return low


@pytest.mark.parametrize("step_s", [1e-3, 0.5e-3])
@pytest.mark.parametrize(
    ("joint", "torque_nm"),
    [
        ("shank_l", 20.0), ("shank_l", 60.0), ("shank_r", 150.0),
        ("foot_l", 20.0), ("foot_r", 60.0),
    ],
)  # fmt: skip
def test_a_pushed_joint_creeps_as_the_stop_does(
    joint: str, torque_nm: float, step_s: float
) -> None:
    found = crept(joint, torque_nm, step_s)
    times_s = step_s * np.arange(1, len(found) + 1)
    expected = law(joint, torque_nm, times_s)
    assert (np.diff(found[times_s > FROM_S]) > 0).all()
    compared = (times_s >= FROM_S) & (expected <= LEAST_RANGE_RAD)
    assert compared.sum() > 20
    np.testing.assert_allclose(found[compared], expected[compared], rtol=TOLERANCE)


def test_the_law_begins_with_a_root() -> None:
    times_s = np.array([1e-4, 1e-3])
    largest = 60.0 / STOP_STIFFNESS_NMPRAD
    root = np.sqrt(2 * largest * STOPS["foot"].relaxation_radps * times_s)
    np.testing.assert_allclose(law("foot_l", 60.0, times_s), root, rtol=0.01)


def test_mujocos_own_limits_are_left_as_they_are() -> None:
    settings = Settings(engine="mujoco", mujoco=MujocoSettings(limits="mujoco"))
    model = walk_model(Bodies.nominal(), settings, 0.9)
    default = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint limited='true' range='0 1'/><geom size='1'/></body>"
        "</worldbody></mujoco>"
    )
    for joint in range(3, 9):
        np.testing.assert_array_equal(model.jnt_solref[joint], default.jnt_solref[0])
        np.testing.assert_array_equal(model.jnt_solimp[joint], default.jnt_solimp[0])


@pytest.mark.parametrize("step_s", [1e-3, 0.5e-3, 0.25e-3])
def test_numbers_are_those_that_mujoco_takes(step_s: float) -> None:
    """Of limbs light and heavy: it would clip others silently."""
    for stop in STOPS.values():
        for inverse_inertia in (1.0, 10.0, 300.0):
            solref, solimp = limit(stop, inverse_inertia, step_s)
            assert solref[0] >= 2.0 * step_s and solref[1] > 0.0
            least, largest, width, midpoint, power = solimp
            assert 1e-4 <= least < largest <= 0.9999
            assert width >= LEAST_RANGE_RAD and 0.0 <= midpoint <= 1.0 and power >= 1.0
