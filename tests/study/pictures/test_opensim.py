"""OpenSim's files of a walk: read back, they give the joint torques that the walker had."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

import taichi_nmm
from study.pictures.opensim import EXTERNAL, LOADS, MODEL, MOTION, STATES, write_opensim
from study.pictures.trajectory_files import kept
from taichi_nmm import terrain
from taichi_nmm.body import GRAVITY_MPS2, Bodies
from tests.study import synthetic_gait
from tests.study.pictures.test_trajectory_files import read_storage

Array = NDArray[np.float64]
BODY = Bodies.disturbed([5])
CHAIN = {"hip": "hip_flexion", "knee": "knee_angle", "ankle": "ankle_angle"}


def cross(arm: Array, force: Array) -> Array:
    return np.asarray(arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0])


def inverse_dynamics(folder: Path) -> tuple[dict[str, Array], Array]:
    """Joint torques, by Newton and Euler of all that is below, and what is left over, [t, 3]."""
    parts = {part.get("name", ""): part for part in ElementTree.parse(folder / MODEL).iter()}
    states, loads = (read_storage((folder / name).read_text())[1] for name in (STATES, LOADS))
    step_s = np.diff(states["time"])
    np.testing.assert_allclose(loads["time"][1:], states["time"][1:] - 0.5 * step_s)

    def numbers(name: str, tag: str) -> Array:
        return np.array(parts[name].findtext(f".//{tag}", "").split(), dtype=float)

    def state(path: str) -> Array:
        both = (states[f"/jointset/{path}/{kind}"] for kind in ("value", "speed"))
        return np.stack(list(both))

    def beyond(place: Array, angle: Array, arm: Array) -> Array:
        """Place and velocity [2, t, 2] of a point `arm` of a link with these angle and rate."""
        cosine, sine = np.cos(angle[0]), np.sin(angle[0])
        along = np.stack([arm[0] * cosine - arm[1] * sine, arm[0] * sine + arm[1] * cosine], -1)
        across = angle[1, :, None] * np.stack([-along[:, 1], along[:, 0]], -1)
        return place + np.stack([along, across])

    def link(name: str, place: Array, angle: Array) -> tuple[Array, Array, Array]:
        """Where its centre of mass is, the mean force and moment that move it so."""
        at, speed = beyond(place, angle, numbers(name, "mass_center"))
        force = np.diff(speed, axis=0) / step_s[:, None] + [0.0, GRAVITY_MPS2]
        turning = numbers(name, "inertia")[2] * np.diff(angle[1]) / step_s
        return at[1:] - 0.5 * np.diff(at, axis=0), numbers(name, "mass") * force, turning

    tilt, *slides = (state(f"ground_pelvis/pelvis_{name}") for name in ("tilt", "tx", "ty"))
    hip = np.stack(slides, axis=-1)
    trunk, left_over, turning = link("pelvis", hip, tilt)
    turning = turning + cross(trunk - hip[0, 1:] + 0.5 * np.diff(hip[0], axis=0), left_over)
    torques: dict[str, Array] = {}
    for side, foot in (("l", "1_"), ("r", "")):
        place, angle, joints, links = hip, tilt, {}, []
        for joint, name in CHAIN.items():
            place = beyond(place, angle, numbers(f"{joint}_{side}", "translation"))
            angle = angle + state(f"{joint}_{side}/{name}_{side}")
            joints[f"{name}_{side}"] = place[0, 1:] - 0.5 * np.diff(place[0], axis=0)
            child = parts[f"{joint}_{side}"].findtext("socket_child_frame", "")
            links.append(link(child.removeprefix("/bodyset/"), place, angle))
        push, centre = (
            np.stack([loads[f"{foot}ground_force_{kind}{axis}"][1:] for axis in "xy"], axis=-1)
            for kind in "vp"
        )
        left_over = left_over + sum(force for _, force, _ in links) - push
        for number, (name, at) in enumerate(joints.items()):
            torques[name] = -cross(centre - at, push) - loads[f"{foot}ground_torque_z"][1:]
            torques[name] += sum(t + cross(com - at, f) for com, f, t in links[number:])
        turning = turning + torques[f"hip_flexion_{side}"]
    return torques, np.column_stack([left_over, turning])


def test_inverse_dynamics_of_the_files_gives_the_walkers_torques(tmp_path: Path) -> None:
    """Within 2 %; in the 5 ms of a heel's impact the pose between two samples is not known."""
    result = taichi_nmm.simulate(
        taichi_nmm.PUBLISHED_GAINS, duration_s=4.0, bodies=BODY, record=[0], record_rate_hz=1000.0,
        terrains=terrain.rough(1, flat_start_m=1.0),
    )  # fmt: skip
    trajectory = kept(result.trajectories[0])
    write_opensim(tmp_path / "walk", trajectory, BODY)
    found, left_over = inverse_dynamics(tmp_path / "walk")
    assert len(left_over) == 799 and result.end_reason == ["completed"]
    expected = dict(zip([f"{name}_{side}" for side in "lr" for name in CHAIN.values()],
                        -trajectory.joint_torque_nm[1:].T, strict=True))  # fmt: skip
    for name, torque in expected.items():
        error = np.abs(found[name] - torque) / np.abs(torque).max()
        assert np.quantile(error, 0.99) < 0.02 and error.max() < 0.1, name
    weight_n, hips_nm = BODY.mass_kg.sum() * GRAVITY_MPS2, np.abs(expected["hip_flexion_l"]).max()
    left = np.quantile(np.abs(left_over), 0.99, axis=0) / [weight_n, weight_n, hips_nm]
    assert left.max() < 0.02


def test_the_folder_has_all_that_opensim_asks_for(tmp_path: Path) -> None:
    write_opensim(tmp_path / "walk", synthetic_gait.GLIMPSE, BODY)
    forces = ElementTree.parse(tmp_path / "walk" / EXTERNAL).getroot()
    _, columns = read_storage(
        (tmp_path / "walk" / (forces.findtext(".//datafile") or "")).read_text()
    )
    for tag in ("force", "point", "torque"):
        for force in forces.iter("ExternalForce"):
            assert {f"{force.findtext(f'{tag}_identifier')}{axis}" for axis in "xyz"} <= set(
                columns
            )
    model = ElementTree.parse(tmp_path / "walk" / MODEL)
    muscles = {f"/forceset/{each.get('name')}" for each in model.iter("Thelen2003Muscle")}
    _, states = read_storage((tmp_path / "walk" / STATES).read_text())
    assert len(muscles) == 14 and {f"{muscle}/activation" for muscle in muscles} <= set(states)
    named = {each.get("name") for each in model.iter("Coordinate")}
    _, motion = read_storage((tmp_path / "walk" / MOTION).read_text())
    assert named == set(motion) - {"time"}
