"""MuJoCo's own `mj_step` on the same body, timed: the yardstick of `tools/bench.py --mujoco`.

    python -m tests.parity.mujoco_bench_model --rollouts 256

The linkage of `taichi_nmm.mujoco_engine` with 14 of MuJoCo's muscles (fixed tendons with the
largest moment arms of the walker's muscles, the cheapest transmission there is), joint limits, and
a sphere at each heel and ball that meets a plane. MuJoCo has no delays, reflexes, swing control or
score to compute: its muscles get constant excitation, so every rollout of a second ends in a fall,
as most random gains do.
"""

import argparse
import json
import os
import time
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np
from mujoco import rollout
from numpy.typing import NDArray

from taichi_nmm.body import BALL_OFFSET_M, HEEL_OFFSET_M, Bodies
from taichi_nmm.initial import initial_rows
from taichi_nmm.kernel import joints
from taichi_nmm.kernel.layout import COORDINATES, State
from taichi_nmm.kernel.muscle_table import MUSCLE_DATA, MuscleData
from taichi_nmm.mujoco_engine.mjcf import RELATIVE, compile_model, linkage
from taichi_nmm.terrain import flat

STEP_S = 1e-3
ROLLOUT_STEPS = 1000
EXCITATION = 0.05
FRICTION = 0.9  # as in the walker
RADIUS_M = 0.01  # of the contact spheres
SEGMENT_OF_JOINT = {"hip": "thigh", "knee": "shank", "ankle": "foot"}  # whose hinge it is
RANGE_RAD = {
    "hip": (-2.0, joints.HIP_EXTENSION_LIMIT_RAD),
    "knee": (joints.KNEE_STRAIGHTEST_RAD, 2.5),
    "ankle": (joints.ANKLE_DORSIFLEXION_LIMIT_RAD, joints.ANKLE_PLANTARFLEXION_LIMIT_RAD),
}


def muscular_walker() -> mujoco.MjModel:
    """The nominal body on a plane, with its joint limits and muscles."""
    root = linkage(Bodies.nominal())
    named = {element.get("name"): element for element in root.iter("joint")}
    bodies = {element.get("name"): element for element in root.iter("body")}
    next(root.iter("option")).set("timestep", repr(STEP_S))
    friction = f"{FRICTION} 0.005 0.0001"
    SubElement(
        next(root.iter("worldbody")), "geom",
        type="plane", size="1 1 1", contype="0", conaffinity="1", friction=friction,
    )  # fmt: skip
    tendons, actuators = SubElement(root, "tendon"), SubElement(root, "actuator")
    for side in ("l", "r"):
        for x in (HEEL_OFFSET_M, BALL_OFFSET_M):  # spheres that meet the plane only
            SubElement(
                bodies[f"foot_{side}"], "geom",
                type="sphere", size=repr(RADIUS_M), pos=f"{x} 0 {RADIUS_M}",
                contype="1", conaffinity="0", friction=friction,
            )  # fmt: skip
        for joint, segment in SEGMENT_OF_JOINT.items():
            low, high = RANGE_RAD[joint]
            hinge = named[f"{segment}_{side}"]
            hinge.attrib |= {"limited": "true", "range": f"{low!r} {high!r}"}
        for name, data in MUSCLE_DATA.items():
            _add_muscle(tendons, actuators, f"{name}_{side}", data, side)
    return compile_model(root)


def initial_state(model: mujoco.MjModel) -> NDArray[np.float64]:
    """The start of every walk, as MuJoCo's full physics state [nstate]."""
    start = initial_rows(flat())
    data = mujoco.MjData(model)
    data.qpos[:] = RELATIVE @ start[State.q : State.q + COORDINATES]
    data.qvel[:] = RELATIVE @ start[State.qdot : State.qdot + COORDINATES]
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    return state


def steps_per_second(threads: int, rollouts: int) -> float:
    """`mj_step` calls a second, `rollouts` walks of `ROLLOUT_STEPS`, on so many threads."""
    model = muscular_walker()
    data = [mujoco.MjData(model) for _ in range(threads)]
    start = np.tile(initial_state(model), (rollouts, 1))
    excitation = np.random.default_rng(0).uniform(0, 2 * EXCITATION, (rollouts, 1, model.nu))
    control = np.repeat(excitation, ROLLOUT_STEPS, axis=1)
    with rollout.Rollout(nthread=threads if threads > 1 else 0) as pool:
        pool.rollout(model, data, start[:threads], control[:threads])  # warms threads and memory
        began = time.perf_counter()
        pool.rollout(model, data, start, control)
        return rollouts * ROLLOUT_STEPS / (time.perf_counter() - began)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rollouts", type=int, default=256)
    rollouts = parser.parse_args().rollouts
    threads = os.cpu_count() or 1
    single, every = (steps_per_second(count, rollouts) for count in (1, threads))
    measured = {"version": mujoco.__version__, "threads": threads, "steps_per_s_single": single}
    print(json.dumps(measured | {"steps_per_s_all": every}))


def _add_muscle(
    tendons: Element, actuators: Element, label: str, data: MuscleData, side: str
) -> None:
    """A tendon whose length is linear in its joints, and the muscle that pulls it.

    The length falls by sign * arm with an angle: a pull of F makes the torque sign * arm * F.
    """
    tendon = SubElement(tendons, "fixed", name=label)
    shortest = longest = 0.0
    for joint, segment in SEGMENT_OF_JOINT.items():
        attachment = getattr(data, joint)
        if attachment is not None:
            slope = -attachment.sign * attachment.arm_m
            SubElement(tendon, "joint", joint=f"{segment}_{side}", coef=repr(slope))
            ends = [slope * angle for angle in RANGE_RAD[joint]]
            shortest, longest = shortest + min(ends), longest + max(ends)
    SubElement(
        actuators, "muscle", name=label, tendon=label,
        force=repr(float(data.fmax_n)), lengthrange=f"{shortest!r} {longest!r}",
    )  # fmt: skip


if __name__ == "__main__":
    main()
