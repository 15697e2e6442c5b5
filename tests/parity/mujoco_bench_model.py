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
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator

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
    _find(root, "option", None).set("timestep", repr(STEP_S))
    _add_contacts(root)
    _limit_joints(root)
    tendons = ElementTree.SubElement(root, "tendon")
    actuators = ElementTree.SubElement(root, "actuator")
    for side in ("l", "r"):
        for name, data in MUSCLE_DATA.items():
            _add_muscle(tendons, actuators, name, data, side)
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
    measured = {
        "version": mujoco.__version__,
        "threads": threads,
        "steps_per_s_single": steps_per_second(1, rollouts),
        "steps_per_s_all": steps_per_second(threads, rollouts),
    }
    print(json.dumps(measured))


def _find(root: ElementTree.Element, tag: str, name: str | None) -> ElementTree.Element:
    return next(e for e in root.iter(tag) if name is None or e.get("name") == name)


def _add_contacts(root: ElementTree.Element) -> None:
    """A plane, and spheres that meet it only; bits keep them from meeting each other."""
    friction = f"{FRICTION} 0.005 0.0001"
    ElementTree.SubElement(
        _find(root, "worldbody", None), "geom",
        type="plane", size="1 1 1", contype="0", conaffinity="1", friction=friction,
    )  # fmt: skip
    for side in ("l", "r"):
        for x in (HEEL_OFFSET_M, BALL_OFFSET_M):
            ElementTree.SubElement(
                _find(root, "body", f"foot_{side}"), "geom",
                type="sphere", size=repr(RADIUS_M), pos=f"{x} 0 {RADIUS_M}",
                contype="1", conaffinity="0", friction=friction,
            )  # fmt: skip


def _limit_joints(root: ElementTree.Element) -> None:
    for joint, segment in SEGMENT_OF_JOINT.items():
        for side in ("l", "r"):
            hinge = _find(root, "joint", f"{segment}_{side}")
            low, high = RANGE_RAD[joint]
            hinge.set("limited", "true")
            hinge.set("range", f"{low!r} {high!r}")


def _add_muscle(
    tendons: ElementTree.Element,
    actuators: ElementTree.Element,
    name: str,
    data: MuscleData,
    side: str,
) -> None:
    """A tendon whose length is linear in its joints, and the muscle that pulls it."""
    label = f"{name}_{side}"
    tendon = ElementTree.SubElement(tendons, "fixed", name=label)
    shortest = longest = 0.0
    for joint, coefficient in _tendon_coefficients(data):
        hinge = f"{SEGMENT_OF_JOINT[joint]}_{side}"
        ElementTree.SubElement(tendon, "joint", joint=hinge, coef=repr(coefficient))
        ends = [coefficient * angle for angle in RANGE_RAD[joint]]
        shortest, longest = shortest + min(ends), longest + max(ends)
    ElementTree.SubElement(
        actuators, "muscle", name=label, tendon=label,
        force=repr(float(data.fmax_n)), lengthrange=f"{shortest!r} {longest!r}",
    )  # fmt: skip


def _tendon_coefficients(data: MuscleData) -> Iterator[tuple[str, float]]:
    """d(length)/d(angle) at each joint it spans; a pull of F makes the torque sign * arm * F."""
    for joint in SEGMENT_OF_JOINT:
        attachment = getattr(data, joint)
        if attachment is not None:
            yield joint, -attachment.sign * attachment.arm_m


if __name__ == "__main__":
    main()
