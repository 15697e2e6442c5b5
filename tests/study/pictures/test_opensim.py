"""OpenSim's files of a walk: read back, they give the joint torques that the walker had."""

from pathlib import Path
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
LEG = (
    "hip_{0}/hip_flexion_{0}",
    "knee_{0}/knee_angle_{0}",
    "ankle_{0}/ankle_angle_{0}",
)


def body_of(model: ElementTree.ElementTree) -> Bodies:
    """The masses of a model; its joints lie where ours do."""

    def numbers(kind: str, tag: str) -> Array:
        found = [part.findtext(f".//{tag}", "").split() for part in model.iter(kind)]
        return np.array(found, dtype=float)

    np.testing.assert_array_equal(
        numbers("PinJoint", "translation"), [[0, 0, 0], [0, -0.5, 0], [0, -0.5, 0]] * 2
    )
    com_m = np.abs(numbers("Body", "mass_center")).sum(axis=1)
    return Bodies(
        numbers("Body", "mass").T, numbers("Body", "inertia")[:, 2][None], com_m[None]
    )


def inverse_dynamics(folder: Path) -> tuple[Array, Array]:
    """Joint torques [t, 6] as ours, and what is left over: force x, z and moment on the trunk."""
    body = body_of(ElementTree.parse(folder / MODEL))
    states, loads = (
        read_storage((folder / name).read_text())[1] for name in (STATES, LOADS)
    )
    step_s = float(np.diff(states["time"]).mean())
    np.testing.assert_allclose(loads["time"][1:], states["time"][1:] - 0.5 * step_s)

    def pose(kind: str) -> Array:
        x, z, tilt = (
            states[f"/jointset/ground_pelvis/pelvis_{c}/{kind}"]
            for c in ("tx", "ty", "tilt")
        )
        joints = [
            states[f"/jointset/{path.format(side)}/{kind}"]
            for side in "lr"
            for path in LEG
        ]
        legs = [
            np.cumsum([tilt, *joints[first : first + 3]], axis=0)[1:]
            for first in (0, 3)
        ]
        return np.column_stack([x, z, -tilt, -legs[0].T, -legs[1].T])

    q, qdot = pose("value"), pose("speed")
    middle, speed = (
        q[1:] - 0.5 * np.diff(q, axis=0),
        contract("nica,na->nic", jacobians(q, body), qdot),
    )
    force = body.mass_kg[..., None] * (
        np.diff(speed, axis=0) / step_s + [0.0, GRAVITY_MPS2]
    )
    needed = contract("nica,nic->na", jacobians(middle, body), force)
    needed[:, 2:] += body.inertia_kgm2 * np.diff(qdot[:, 2:], axis=0) / step_s
    ankles = Bodies(body.mass_kg, body.inertia_kgm2, np.zeros((1, 7)))
    for foot, name in ((3, "1_ground_"), (6, "ground_")):
        push, centre = (
            np.column_stack([loads[f"{name}force_{kind}{axis}"][1:] for axis in "xy"])
            for kind in "vp"
        )
        x, z = (centre - com_positions(middle, ankles)[:, foot]).T
        needed -= contract("nca,nc->na", jacobians(middle, ankles)[:, foot], push)
        needed[:, 2 + foot] -= (
            z * push[:, 0] - x * push[:, 1] - loads[f"{name}torque_z"][1:]
        )
    torques = np.hstack(
        [np.cumsum(needed[:, leg], axis=1)[:, ::-1] for leg in ([5, 4, 3], [8, 7, 6])]
    )
    needed[:, 2] += torques[:, 0] + torques[:, 3]
    return torques, needed[:, :3]


SPRING = taichi_nmm.WorldRanges(
    prosthesis=taichi_nmm.Prosthesis("left", 600.0, 0.0, 0.1)
)


@pytest.mark.parametrize("ranges", [taichi_nmm.WorldRanges(), SPRING])
def test_inverse_dynamics_of_the_files_gives_the_walkers_torques(
    tmp_path: Path, ranges: taichi_nmm.WorldRanges
) -> None:
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
    left = np.quantile(np.abs(left_over), 0.99, axis=0) / [
        weight_n,
        weight_n,
        peaks_nm[0],
    ]
    assert left.max() < 0.02
    # What the list of loads, the states and the motion name is there.
    forces, model = (
        ElementTree.parse(tmp_path / "walk" / name) for name in (EXTERNAL, MODEL)
    )
    loads, states, motion = (
        read_storage((tmp_path / "walk" / name).read_text())[1]
        for name in (forces.findtext(".//datafile") or "", STATES, MOTION)
    )
    for force in forces.iter("ExternalForce"):
        for tag in ("force", "point", "torque"):
            assert {
                f"{force.findtext(f'{tag}_identifier')}{axis}" for axis in "xyz"
            } <= set(loads)
    muscles = [
        f"/forceset/{each.get('name')}"
        for each in model.iter("Millard2012EquilibriumMuscle")
    ]
    assert len(muscles) == 14 and {f"{muscle}/activation" for muscle in muscles} <= set(
        states
    )
    assert {each.get("name") for each in model.iter("Coordinate")} == set(motion) - {
        "time"
    }
