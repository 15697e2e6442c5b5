"""A walk for OpenSim 4: the model of its body, motion, states, and the ground's forces.

The model has our seven links and planar joints, by the names of OpenSim's gait10dof18musc: its
pelvis is head, arms and trunk in one, with the hip as its origin. Angles are counter-clockwise
positive, flexion of the knee negative.
"""

import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from storage.commit import commit_text, together
from study.pictures.stick_figure import down, finite, forward, leg
from taichi_nmm import __version__
from taichi_nmm.body import (
    GRAVITY_MPS2,
    LINK_DIRECTIONS,
    LINK_ORIGINS_M,
    LINK_WIDTHS_M,
    LINKS,
    SEGMENTS,
    SHANK_LENGTH_M,
    THIGH_LENGTH_M,
    Bodies,
    muscle_points,
)
from taichi_nmm.kernel.muscle_table import MUSCLE_DATA
from taichi_nmm.result import MUSCLES, Trajectory

Array = NDArray[np.float64]
Columns = dict[str, Array]

OPENSIM = tomllib.loads(Path(__file__).with_name("opensim.toml").read_text(encoding="utf-8"))
XML: dict[str, str] = {name: text.lstrip() for name, text in OPENSIM["xml"].items()}
SIDES = ("l", "r")
FEET = {"l": "1_", "r": ""}  # before the names of a foot's columns, as in OpenSim's examples
SIDED = [(side, muscle) for side in SIDES for muscle in MUSCLES]
MUSCLE_NAMES = [f"{OPENSIM['muscles'][muscle]}_{side}" for side, muscle in SIDED]
JOINTS = [(joint, side) for side in SIDES for joint in OPENSIM["joints"]]
COORDINATES = [
    *((f"ground_pelvis/{name}", name) for name in ("pelvis_tilt", "pelvis_tx", "pelvis_ty")),
    *((f"{joint}_{side}/{OPENSIM['joints'][joint]}_{side}", f"{OPENSIM['joints'][joint]}_{side}")
      for joint, side in JOINTS),
]  # fmt: skip
MOTION, STATES, LOADS = "motion.mot", "states.sto", "ground_forces.mot"
MODEL, EXTERNAL = "walker.osim", "external_loads.xml"


def write_opensim(folder: Path, trajectory: Trajectory, body: Bodies, name: str = "walk") -> None:
    """Write all five files of a walk into a folder, or none.

    Args:
        folder: new, or one that this function has written.
        trajectory: with forces and torques as means over the intervals.
        body: the first of these walked.
        name: a line of each file.

    Raises:
        InputError: the folder cannot be written.
    """
    trajectory = finite(trajectory)
    with together(folder) as new:
        commit_text(new / MODEL, model_text(body, name))
        commit_text(new / MOTION, storage_text(motion(trajectory), "coordinates", name))
        commit_text(new / STATES, storage_text(states(trajectory), "states", name))
        commit_text(new / LOADS, storage_text(loads(trajectory, body), "loads", name))
        forces = "".join(XML["force"].format(side=side, foot=FEET[side]) for side in SIDES)
        commit_text(new / EXTERNAL, XML["loads"].format(forces=forces, file=LOADS))


def storage_text(columns: Columns, words: str, name: str) -> str:
    """OpenSim's storage, version 1: lines before `endheader` that are no keys are remarks."""
    rows = len(columns["time"])
    degrees = "yes" if words == "coordinates" else "no"
    head = f"{name}\nversion=1\nnRows={rows}\nnColumns={len(columns)}\ninDegrees={degrees}\n\n"
    names, lines = "\t".join(columns), table_lines(columns, "\t")
    return f"{head}{OPENSIM[words]}\nendheader\n{names}\n{lines}"


def table_lines(columns: Columns, between: str) -> str:
    """Rows with as many digits as needed to read the same float64 back."""
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    return "".join(between.join(map(repr, row)) + "\n" for row in rows)


def table(time: str, time_s: Array, named: Iterable[tuple[Sequence[str], Array]]) -> Columns:
    """The time, and the columns of arrays [t, k] by their names, k each."""
    columns = {time: time_s}
    for names, values in named:
        columns |= dict(zip(names, values.T, strict=True))
    return columns


def _coordinates(pose: Array) -> Array:
    """OpenSim's coordinates of q, or their rates of qdot, [t, 9] both."""
    joints = pose[:, 3:] - pose[:, [2, 3, 4, 2, 6, 7]]  # extension, flexion, plantarflexion
    return np.hstack([-pose[:, 2:3], pose[:, :2], -joints])


def motion(trajectory: Trajectory) -> Columns:
    """Coordinates of the model, angles in degrees."""
    values = _coordinates(trajectory.q)
    values[:, [0, *range(3, 9)]] = np.rad2deg(values[:, [0, *range(3, 9)]])
    return table("time", trajectory.time_s, [([name for _, name in COORDINATES], values)])


def states(trajectory: Trajectory) -> Columns:
    """All states of the model by the paths of OpenSim 4: coordinates, speeds, muscles."""
    paths = [f"/jointset/{path}" for path, _ in COORDINATES]
    muscles = [f"/forceset/{name}" for name in MUSCLE_NAMES]
    return table("time", trajectory.time_s, [
        ([f"{path}/value" for path in paths], _coordinates(trajectory.q)),
        ([f"{path}/speed" for path in paths], _coordinates(trajectory.qdot)),
        ([f"{muscle}/activation" for muscle in muscles], trajectory.activation),
        ([f"{muscle}/fiber_length" for muscle in muscles], trajectory.fibre_length_m),
    ])  # fmt: skip


def loads(trajectory: Trajectory, body: Bodies) -> Columns:
    """Force, point and torque of the ground on each foot, at the middles of the intervals.

    The point follows from the foot's equation of motion; a torque is what a point between heel and
    ball leaves over.
    """
    interval_s = float(np.diff(trajectory.time_s[:2]).sum()) or 1.0
    q, qdot = trajectory.q, trajectory.qdot
    named: list[tuple[list[str], Array]] = []
    for side, foot in enumerate(FEET.values()):
        link, gravity = 3 + 3 * side, [0.0, GRAVITY_MPS2]
        mass, inertia, com_m = (each[0, link] for each in vars(body).values())
        w = qdot[:, 3 + 3 * side : 6 + 3 * side, None]
        thigh, shank, angle = q[:, 3 + 3 * side : 6 + 3 * side].T
        speed = qdot[:, :2] - THIGH_LENGTH_M * w[:, 0] * forward(thigh)
        speed += com_m * w[:, 2] * down(angle) - SHANK_LENGTH_M * w[:, 1] * forward(shank)
        drawn = leg(_middle(q), side)
        force = trajectory.ground_force_n[:, 2 * side : 2 * side + 2]
        above = mass * (_gained(speed) / interval_s + gravity) - force  # of the shank on the foot
        lever = -com_m * forward(_middle(angle))
        moment = trajectory.joint_torque_nm[:, 3 * side + 2] - _cross(lever, above)
        moment -= inertia * _gained(w[:, 2, 0]) / interval_s
        low, high = np.sort([drawn.heel[:, 0], drawn.ball[:, 0]], axis=0)
        com, y_m = drawn.ankle - lever, np.minimum(drawn.heel[:, 1], drawn.ball[:, 1])
        on = force[:, 1] > 0.0
        ahead = moment + (y_m - com[:, 1]) * force[:, 0]
        x_m = np.clip(com[:, 0] + ahead / np.where(on, force[:, 1], np.inf), low, high)
        point = np.column_stack([x_m, y_m])
        torque = np.where(on, moment - _cross(point - com, force), 0.0)
        for name, columns in (("force_v", force), ("force_p", point)):
            names = [f"{foot}ground_{name}{axis}" for axis in "xyz"]
            named.append((names, np.column_stack([columns, np.zeros_like(x_m)])))
        names = [f"{foot}ground_torque_{axis}" for axis in "xyz"]
        named.append((names, np.column_stack([np.zeros((len(x_m), 2)), torque])))
    return table("time", trajectory.time_s - 0.5 * interval_s, named)


def _gained(values: Array) -> Array:
    """How much values grow in the interval that ends at a sample, 0 at the first."""
    return np.diff(values, axis=0, prepend=values[:1])


def _middle(values: Array) -> Array:
    """Values in the middle of the interval that ends at a sample."""
    return values - 0.5 * _gained(values)


def _cross(arm: Array, force: Array) -> Array:
    """Moment of forces [t, 2], counter-clockwise, [t]."""
    return np.asarray(arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0])


def model_text(body: Bodies, name: str = "walk") -> str:
    """The model of the first body, as XML."""
    bodies, joints = [], []
    for index, segment in enumerate(SEGMENTS):
        kind = 0 if index == 0 else (index - 1) % 3 + 1
        axis = np.array(LINK_DIRECTIONS[kind], dtype=float)
        side = SIDES[index > 3]
        own, above = (_body_name(k, side) for k in (kind, max(kind - 1, 0)))
        radii = np.abs(axis) * 0.5 * segment.length_m
        radii[radii == 0.0] = 0.5 * LINK_WIDTHS_M[kind]
        bodies.append(XML["body"].format(
            name=own, middle=_place(axis * 0.5 * segment.length_m), com=_place(
                axis * body.com_m[0, index]), mass=float(body.mass_kg[0, index]),
            inertia=float(body.inertia_kgm2[0, index]),
            radii=" ".join(map(repr, [*radii.tolist(), radii.min().item()])),
        ))  # fmt: skip
        if index:
            joint = list(OPENSIM["joints"])[kind - 1]
            joints.append(XML["joint"].format(
                name=f"{joint}_{side}", parent=above, child=own,
                coordinate=f"{OPENSIM['joints'][joint]}_{side}", place=_place(LINK_ORIGINS_M[kind]),
            ))  # fmt: skip
    return XML["model"].format(
        name=name, version=__version__, gravity=GRAVITY_MPS2, bodies="".join(bodies),
        joints="".join(joints), muscles="".join(map(_muscle, SIDED, MUSCLE_NAMES)),
    )  # fmt: skip


def _body_name(kind: int, side: str) -> str:
    """The name of a link, by its place in `LINKS`."""
    name: str = OPENSIM["bodies"][LINKS[kind]]
    return f"{name}_{side}" if kind else name


def _muscle(sided: tuple[str, str], name: str) -> str:
    side, data = sided[0], MUSCLE_DATA[sided[1]]
    points = [
        XML["point"].format(name=f"{name}-{n}", body=_body_name(kind, side), place=_place(place))
        for n, (kind, place) in enumerate(muscle_points(sided[1]), start=1)
    ]
    return XML["muscle"].format(
        name=name, points="".join(points), force=float(data.fmax_n), optimal=data.optimal_length_m,
        slack=data.slack_length_m, fastest=float(data.vmax_per_s),
    )  # fmt: skip


def _place(x_z: Iterable[float]) -> str:
    """Our x and z, in OpenSim's axes."""
    x, z = map(float, x_z)
    return f"{x!r} {z!r} 0"
