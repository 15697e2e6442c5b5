"""Gymnasium's Ant, a body in three dimensions, under a central pattern generator of 12 parameters.

A. J. Ijspeert, "Central pattern generators for locomotion control in animals and
robots: a review" (2008): phases that hold a lag make the rhythm of the legs; the
trunk's course and pitch change it.
"""

import mujoco
import numpy as np
from optuna.distributions import FloatDistribution

from storage.mujoco_simulator import MujocoSimulator, gymnasium_model

# The four legs: front left, hind left, hind right, front right.
LEFT = np.array([1.0, 1.0, -1.0, -1.0])
FRONT = np.array([1.0, -1.0, -1.0, 1.0])
# the sign of an ankle's angle that bends it down
DOWN = np.array([1.0, -1.0, -1.0, 1.0])
# in qpos; in qvel 1 less
HIP, ANKLE = (np.array([7, 9, 11, 13]), np.array([8, 10, 12, 14]))
MOTOR = np.array([2, 4, 6, 0])  # of the hips; each ankle's follows
START = [
    0.0,
    0.0,
    0.55,
    1.0,
    0.0,
    0.0,
    0.0,
    0.0,
    1.0,
    0.0,
    -1.0,
    0.0,
    -1.0,
    0.0,
    1.0,
]  # Gymnasium's
MOST_TURN = 0.8  # of a stride
LEAST_SPEED_MPS, PATIENCE_S = 0.45, 2.0  # who gets less far stands rather than walks
LANE_M = 1.5  # to each side


def model():
    """The published model, with a fast integrator in place of RK4."""
    spec = mujoco.MjSpec.from_file(str(gymnasium_model("ant.xml")))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec


def controller(point, sensed, memory):
    """Torques of n robots, [n, 8], as shares of the motors' 150 N m."""
    of = {name: values[:, None] for name, values in point.items()}
    first, second = point["diagonal"], point["hind"]
    lag = np.column_stack([0.0 * first, first, second, first + second])
    phase = 2.0 * np.pi * (of["frequency_hz"] * sensed.time_s + lag)
    w, x, y, z = (sensed.qpos[:, place] for place in (3, 4, 5, 6))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    turn = point["turn"] * yaw + point["lane"] * sensed.qpos[:, 1]
    turn = np.clip(turn, -MOST_TURN, MOST_TURN)[:, None]
    stride = of["stride"] * (1.0 + LEFT * turn)
    hip = LEFT * (of["centre"] * FRONT - stride * np.cos(phase))
    lift = of["lift"] * np.maximum(-np.sin(phase), 0.0)
    ankle = DOWN * (
        of["stance"] + of["lean"] * FRONT * sensed.pitch_rad[:, None] - lift
    )
    kp, kd = of["kp"], of["kp"] * of["kd"]
    controls = np.empty((len(turn), 8))
    for target, place, motor in ((hip, HIP, MOTOR), (ankle, ANKLE, MOTOR + 1)):
        error = target - sensed.qpos[:, place]
        controls[:, motor] = kp * error - kd * sensed.qvel[:, place - 1]
    return np.clip(controls, -1.0, 1.0)


def fallen(sensed):
    """Whether a run is over, [n]."""
    slow = sensed.x_m < LEAST_SPEED_MPS * (sensed.time_s - PATIENCE_S)
    astray = np.abs(sensed.qpos[:, 1]) > LANE_M
    return (sensed.height_m < 0.2) | (sensed.tilt_rad > 1.0) | slow | astray


robot = MujocoSimulator(
    model,
    controller,
    parameters={
        "frequency_hz": FloatDistribution(0.5, 2.5),
        "diagonal": FloatDistribution(
            0.3, 0.7
        ),  # lag of the hind left leg; 0.5 is a trot
        "hind": FloatDistribution(-0.2, 0.2),  # lag of the hind right leg
        "stride": FloatDistribution(0.1, 0.6),
        "centre": FloatDistribution(-0.3, 0.3),
        "stance": FloatDistribution(0.5, 1.2),
        "lift": FloatDistribution(0.0, 0.7),
        "lean": FloatDistribution(-1.0, 1.0),
        "turn": FloatDistribution(-2.0, 2.0),
        "lane": FloatDistribution(-1.0, 1.0),
        "kp": FloatDistribution(0.3, 10.0, log=True),
        "kd": FloatDistribution(0.02, 0.3, log=True),
    },
    start_qpos=START,
    control_step_s=0.05,
    fallen=fallen,
    measures={"speed_mps": (0.0, 1.5), "effort": (0.0, 0.3)},
)
