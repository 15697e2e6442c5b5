"""OpenSim's files of a walk: read back, they give the joint torques that the walker had."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.typing import NDArray

import taichi_nmm
from study.pictures.trajectory_files import (
    EXTERNAL,
    LOADS,
    MODEL,
    MOTION,
    STATES,
    kept,
    write_opensim,
)
from taichi_nmm import terrain
from taichi_nmm.body import GRAVITY_MPS2, Bodies
from tests.parity.numpy_dynamics import com_positions, contract, jacobians
from tests.study.pictures.test_trajectory_files import read_storage

Array = NDArray[np.float64]
BODY = Bodies.disturbed([5])
LOAD = ("force_vx", "force_vy", "force_px", "force_py", "torque_z")
LEG = (
    "hip_{0}/hip_flexion_{0}",
    "knee_{0}/knee_angle_{0}",
    "ankle_{0}/ankle_angle_{0}",
)


def body_of(model):
    """The masses of a model; its joints lie where ours do."""

    def numbers(kind, tag):
        found = [part.findtext(f".//{tag}", "").split() for part in model.iter(kind)]
        return np.array(found, dtype=float)

    joints = numbers("PinJoint", "translation")
    np.testing.assert_array_equal(joints, [[0, 0, 0], [0, -0.5, 0], [0, -0.5, 0]] * 2)
    return Bodies(
        mass_kg=numbers("Body", "mass").T,
        inertia_kgm2=numbers("Body", "inertia")[:, 2][None],
        com_m=np.abs(numbers("Body", "mass_center")).sum(axis=1)[None],
    )


def columns_of(file):
    return read_storage(file.read_text())[1]


def pose_of(states, kind):
    """Our coordinates, of OpenSim's values or speeds, [t, 9]."""
    x, z, tilt = (
        states[f"/jointset/ground_pelvis/pelvis_{name}/{kind}"]
        for name in ("tx", "ty", "tilt")
    )
    columns = [x, z, -tilt]
    for side in "lr":
        joints = [states[f"/jointset/{path.format(side)}/{kind}"] for path in LEG]
        columns += list(-np.cumsum([tilt, *joints], axis=0)[1:])
    return np.column_stack(columns)


def inverse_dynamics(folder):
    """Joint torques [t, 6] as ours, and what is left over: force x, z and moment on the trunk."""
    body = body_of(ElementTree.parse(folder / MODEL))
    states, loads = columns_of(folder / STATES), columns_of(folder / LOADS)
    step_s = float(np.diff(states["time"]).mean())
    np.testing.assert_allclose(loads["time"][1:], states["time"][1:] - 0.5 * step_s)
    q, qdot = pose_of(states, "value"), pose_of(states, "speed")
    middle = q[1:] - 0.5 * np.diff(q, axis=0)
    speed = contract("nica,na->nic", jacobians(q, body), qdot)
    gained = np.diff(speed, axis=0) / step_s + [0.0, GRAVITY_MPS2]
    force = body.mass_kg[..., None] * gained
    needed = contract("nica,nic->na", jacobians(middle, body), force)
    needed[:, 2:] += body.inertia_kgm2 * np.diff(qdot[:, 2:], axis=0) / step_s
    ankles = replace(body, com_m=np.zeros((1, 7)))
    for foot, name in ((3, "1_ground_"), (6, "ground_")):
        load = {key: loads[name + key][1:] for key in LOAD}
        push = np.column_stack([load["force_vx"], load["force_vy"]])
        centre = np.column_stack([load["force_px"], load["force_py"]])
        x, z = (centre - com_positions(middle, ankles)[:, foot]).T
        needed -= contract("nca,nc->na", jacobians(middle, ankles)[:, foot], push)
        needed[:, 2 + foot] -= z * push[:, 0] - x * push[:, 1] - load["torque_z"]
    # From the foot up, each joint carries what is below it.
    left, right = (
        np.cumsum(needed[:, links], axis=1)[:, ::-1] for links in ([5, 4, 3], [8, 7, 6])
    )
    needed[:, 2] += left[:, 0] + right[:, 0]
    return np.hstack([left, right]), needed[:, :3]


SPRING = taichi_nmm.WorldRanges(
    prosthesis=taichi_nmm.Prosthesis("left", 600.0, 0.0, 0.1)
)


@pytest.mark.parametrize("ranges", [taichi_nmm.WorldRanges(), SPRING])
def test_inverse_dynamics_of_the_files_gives_the_walkers_torques(tmp_path, ranges):
    """Within 2 %; in the 5 ms of a heel's impact the pose between two samples is not known."""
    result = taichi_nmm.simulate(
        taichi_nmm.PUBLISHED_GAINS,
        duration_s=4.0,
        bodies=BODY,
        record=[0],
        record_rate_hz=1000.0,
        terrains=terrain.rough(1, flat_start_m=1.0),
        worlds=ranges.draw([1]),
    )
    trajectory = kept(result.trajectories[0])
    write_opensim(tmp_path / "walk", trajectory, BODY)
    found, left_over = inverse_dynamics(tmp_path / "walk")
    assert len(left_over) == 799 and result.end_reason == ["completed"]
    peaks_nm = np.abs(trajectory.joint_torque_nm).max(axis=0)
    errors = np.abs(found - trajectory.joint_torque_nm[1:]) / peaks_nm
    assert np.quantile(errors, 0.99, axis=0).max() < 0.02 and errors.max() < 0.1
    weight_n = BODY.mass_kg.sum() * GRAVITY_MPS2
    scale = [weight_n, weight_n, peaks_nm[0]]
    assert (np.quantile(np.abs(left_over), 0.99, axis=0) / scale).max() < 0.02
    # What the list of loads, the states and the motion name is there.
    folder = tmp_path / "walk"
    forces, model = (
        ElementTree.parse(folder / EXTERNAL),
        ElementTree.parse(folder / MODEL),
    )
    loads = columns_of(folder / (forces.findtext(".//datafile") or ""))
    for force in forces.iter("ExternalForce"):
        for tag in ("force", "point", "torque"):
            start = force.findtext(f"{tag}_identifier")
            assert {f"{start}{axis}" for axis in "xyz"} <= set(loads)
    muscles = [each.get("name") for each in model.iter("Millard2012EquilibriumMuscle")]
    activations = {f"/forceset/{muscle}/activation" for muscle in muscles}
    assert len(muscles) == 14 and activations <= set(columns_of(folder / STATES))
    coordinates = {each.get("name") for each in model.iter("Coordinate")}
    assert {"time", *coordinates} == set(columns_of(folder / MOTION))
