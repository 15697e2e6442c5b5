"""Accelerations of the linkage in the air by MuJoCo, in our coordinates."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from taichi_nmm.body import Bodies
from taichi_nmm.mujoco_engine.mjcf import RELATIVE, compile_model, linkage

Array = NDArray[np.float64]


def forward_dynamics(q: Array, qdot: Array, joint_torque: Array, bodies: Bodies) -> Array:
    """Accelerations [n, 9] by `mj_forward`; one body a state."""
    states = zip(q, qdot, joint_torque, strict=True)
    return np.array([_accelerate(bodies, row, *state) for row, state in enumerate(states)])


def _accelerate(bodies: Bodies, row: int, q: Array, qdot: Array, joint_torque: Array) -> Array:
    model = compile_model(linkage(bodies, row))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = RELATIVE @ q, RELATIVE @ qdot
    data.qfrc_applied[3:] = joint_torque
    mujoco.mj_forward(model, data)
    return np.linalg.solve(RELATIVE, data.qacc)
