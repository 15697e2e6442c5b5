"""Gymnasium's Walker2d under a gait of 12 gains: a state machine that keeps its balance.

The controller is SIMBICON's: K. Yin, K. Loken, M. van de Panne, "SIMBICON: Simple Biped
Locomotion Control" (2007). A leg swings until it lands, then the other one does. The
hip of the swing leg follows the place of the stance foot and the trunk's speed. Hips
bend backwards only, so the trunk leans back.
"""

import mujoco
import numpy as np
from optuna.distributions import FloatDistribution

from storage.mujoco_simulator import MujocoSimulator, gymnasium_model

FEET = ("foot", "foot_left")
# in qpos and qvel
HIP, KNEE, ANKLE = (np.array([3, 6]), np.array([4, 7]), np.array([5, 8]))
PITCH, FIRST = 2, 3  # the trunk's angle; the first joint with a motor
WEAK_ANKLE = 0.3  # of the gains of hip and knee
LEAST_SPEED_MPS, PATIENCE_S = 0.25, 2.0  # who gets less far stands rather than walks


def model():
    """The published model, with sensors below its feet and a fast integrator in place of RK4."""
    spec = mujoco.MjSpec.from_file(str(gymnasium_model("walker2d_v5.xml")))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for foot in FEET:
        # not shown
        box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [0.2, 0.1, 0.1], "group": 4}
        spec.body(foot).add_site(name=foot, pos=[-0.1, 0.0, 0.1], **box)
        touch = {
            "type": mujoco.mjtSensor.mjSENS_TOUCH,
            "objtype": mujoco.mjtObj.mjOBJ_SITE,
        }
        spec.add_sensor(name=foot, objname=foot, **touch)
    return spec


def controller(point, sensed, memory):
    """Torques of n robots, [n, 6], as shares of the motors' 100 N m."""
    rows, now = np.arange(len(sensed.x_m)), sensed.time_s
    if not memory:
        memory["since_s"], memory["swing"] = (
            np.zeros(len(rows)),
            np.zeros(len(rows), dtype=int),
        )
    waited, swing = now - memory["since_s"], memory["swing"]
    lands = (
        np.where(swing == 0, sensed.sensors["foot"], sensed.sensors["foot_left"]) > 0.0
    )
    over = (waited >= point["step_s"]) | (lands & (waited >= 0.5 * point["step_s"]))
    memory["since_s"] = np.where(over, now, memory["since_s"])
    memory["swing"] = swing = np.where(over, 1 - swing, swing)
    age, stance = (now - memory["since_s"]) / point["step_s"], 1 - swing

    angle, rate = sensed.qpos, sensed.qvel
    kp, kd = point["kp"], point["kp"] * point["kd"]
    controls = np.zeros((len(rows), 6))

    def drive(joint, target, strength=1.0):
        """A spring and a damper at a joint."""
        torque = kp * (target - angle[rows, joint]) - kd * rate[rows, joint]
        controls[rows, joint - FIRST] = strength * torque

    # the swing thigh aims at an angle from the vertical; the stance hip holds the trunk
    pitch, pitch_rate = angle[:, PITCH], rate[:, PITCH]
    thigh = angle[rows, HIP[swing]] - pitch
    thigh_rate = rate[rows, HIP[swing]] - pitch_rate
    # of the stance foot, in lengths of a leg
    behind = -np.sin(angle[rows, HIP[stance]] - pitch)
    aim = (
        point["swing_hip"]
        + point["balance_d"] * behind
        + point["balance_v"] * rate[:, 0]
    )
    torque = kp * (aim - thigh) - kd * thigh_rate
    trunk = kp * (point["trunk"] - pitch) - kd * pitch_rate
    controls[rows, HIP[swing] - FIRST] = torque
    controls[rows, HIP[stance] - FIRST] = trunk - point["share"] * torque

    lifted = age < point["lift"]
    drive(KNEE[swing], np.where(lifted, point["swing_knee"], point["stance_knee"]))
    drive(KNEE[stance], point["stance_knee"])
    drive(ANKLE[swing], 0.0, WEAK_ANKLE)
    drive(ANKLE[stance], point["push_off"] * age, WEAK_ANKLE)
    return np.clip(controls, -1.0, 1.0)


def fallen(sensed):
    """Whether a run is over, [n]."""
    slow = sensed.x_m < LEAST_SPEED_MPS * (sensed.time_s - PATIENCE_S)
    return (sensed.height_m < 0.8) | (sensed.tilt_rad > 1.0) | slow


robot = MujocoSimulator(
    model,
    controller,
    parameters={
        "step_s": FloatDistribution(0.3, 0.7),
        "swing_hip": FloatDistribution(0.3, 1.0),
        "swing_knee": FloatDistribution(-2.0, -1.0),
        "stance_knee": FloatDistribution(-0.4, 0.0),
        "lift": FloatDistribution(
            0.4, 1.0
        ),  # the share of a step for which the knee is bent
        "push_off": FloatDistribution(-0.3, 0.6),
        "trunk": FloatDistribution(-0.6, 0.1),
        "balance_d": FloatDistribution(-0.2, 0.8),
        "balance_v": FloatDistribution(0.0, 0.5),
        "share": FloatDistribution(0.3, 1.0),
        "kp": FloatDistribution(1.0, 4.0, log=True),
        "kd": FloatDistribution(0.03, 0.15, log=True),
    },
    control_step_s=0.008,
    fallen=fallen,
    measures={"speed_mps": (0.0, 2.0), "effort": (0.0, 0.6)},
)
