"""A recorded walk as files for other programs: CSV by our own names, markers as motion
capture has them, and all that OpenSim 4 takes.

OpenSim gets the model of its body, motion, states, torques beside the muscles', and the
ground's forces. The model has our seven links and planar joints, by the names of
OpenSim's gait10dof18musc: its pelvis is head, arms and trunk in one, with the hip as
its origin. Angles are counter-clockwise positive, flexion of the knee negative. Numbers
have as many digits as needed to read the same float64 back.
"""

from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from storage.commit import commit, commit_text, require_writable, together
from storage.inputs.errors import InputError
from study.pictures.opensim_muscles import (
    OPENSIM,
    SIDED,
    SIDES,
    fibre_lengths,
    forces_text,
    lines_text,
    motor_torques,
    muscles_of,
)
from study.pictures.stick_figure import (
    LEFT,
    NOT_SAMPLED,
    RIGHT,
    down,
    finite,
    forward,
    leg,
    trunk,
)
from taichi_nmm import __version__
from taichi_nmm.body import (
    GRAVITY_MPS2,
    SEGMENT_NAMES,
    SHANK_LENGTH_M,
    THIGH_LENGTH_M,
    Bodies,
)
from taichi_nmm.result import DELAYED, Trajectory
from taichi_nmm.world import Worlds

Array = NDArray[np.float64]
Columns = dict[str, Array]

FOLDER = Path(
    __file__
).parent  # of the model's template, and the list of external loads
FEET = (
    "1_",
    "",
)  # before the names of the left and right foot's columns, as in OpenSim's examples
BASE = [f"ground_pelvis/pelvis_{name}" for name in ("tilt", "tx", "ty")]
COORDINATES = BASE + [
    path.format(side=side) for side in SIDES for path in OPENSIM["leg"]
]
MOTION, STATES, LOADS = "motion.mot", "states.sto", "ground_forces.mot"
CONTROLS = "controls.sto"
MODEL, EXTERNAL = "walker.osim", "external_loads.xml"


def write_opensim(
    folder: Path,
    trajectory: Trajectory,
    body: Bodies,
    name: str = "walk",
    world: Worlds | None = None,
) -> None:
    """Write all six files of a walk into a folder, or none.

    Args:
        folder: new, or one that this function has written.
        trajectory: with forces and torques as means over the intervals.
        body: the first of these walked.
        name: a line of each file.
        world: the first of these it walked in; None is the nominal one.

    Raises:
        InputError: the folder cannot be written.
    """
    trajectory = finite(trajectory)
    torques = motor_torques(trajectory, world)
    controls = {f"/forceset/{motor}": values for motor, values in torques.items()}
    controls = {"time": _interval_middles(trajectory), **controls}
    with together(folder) as new:
        commit_text(new / MODEL, model_text(body, name, world))
        commit_text(new / MOTION, storage_text(motion(trajectory), "coordinates", name))
        commit_text(
            new / STATES, storage_text(states(trajectory, world), "states", name)
        )
        commit_text(new / CONTROLS, storage_text(controls, "controls", name))
        commit_text(new / LOADS, storage_text(loads(trajectory, body), "loads", name))
        commit_text(new / EXTERNAL, FOLDER.joinpath(EXTERNAL).read_text("utf-8"))


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


def table(
    time: str, time_s: Array, named: Iterable[tuple[Sequence[str], Array]]
) -> Columns:
    """The time, and the columns of arrays [t, k] by their names, k each."""
    columns = {time: time_s}
    for names, values in named:
        columns |= dict(zip(names, values.T, strict=True))
    return columns


def _coordinates(pose: Array) -> Array:
    """OpenSim's coordinates of q, or their rates of qdot, [t, 9] both."""
    joints = (
        pose[:, 3:] - pose[:, [2, 3, 4, 2, 6, 7]]
    )  # extension, flexion, plantarflexion
    return np.hstack([-pose[:, 2:3], pose[:, :2], -joints])


def motion(trajectory: Trajectory) -> Columns:
    """Coordinates of the model, angles in degrees."""
    values = _coordinates(trajectory.q)
    values[:, [0, *range(3, 9)]] = np.rad2deg(values[:, [0, *range(3, 9)]])
    names = [path.rpartition("/")[2] for path in COORDINATES]
    return table("time", trajectory.time_s, [(names, values)])


def states(trajectory: Trajectory, world: Worlds | None = None) -> Columns:
    """All states of the model by the paths of OpenSim 4: coordinates, speeds, muscles.

    A muscle that is missing in this world has none; fibres are as `fibre_lengths` has
    them.
    """
    paths = [f"/jointset/{path}" for path in COORDINATES]
    columns = table(
        "time",
        trajectory.time_s,
        [
            ([f"{path}/value" for path in paths], _coordinates(trajectory.q)),
            ([f"{path}/speed" for path in paths], _coordinates(trajectory.qdot)),
        ],
    )
    lengths = fibre_lengths(trajectory, world)
    for muscle, activation in zip(
        muscles_of(world), trajectory.activation.T, strict=True
    ):
        if muscle.name in lengths:
            columns[f"/forceset/{muscle.name}/activation"] = activation
            columns[f"/forceset/{muscle.name}/fiber_length"] = lengths[muscle.name]
    return columns


def loads(trajectory: Trajectory, body: Bodies) -> Columns:
    """Force, point and torque of the ground on each foot, at the middles of the intervals.

    The point follows from the foot's equation of motion; a torque is what a point
    between heel and ball leaves over.
    """
    interval_s = _interval(trajectory)
    q, qdot = trajectory.q, trajectory.qdot
    columns = {"time": _interval_middles(trajectory)}
    for side, foot in enumerate(FEET):
        link = SEGMENT_NAMES.index(f"foot_{SIDES[side]}")
        mass, inertia = body.mass_kg[0, link], body.inertia_kgm2[0, link]
        com_m = body.com_m[0, link]
        thigh, shank, angle = q[:, 3 + 3 * side : 6 + 3 * side].T
        w = qdot[:, 3 + 3 * side : 6 + 3 * side, None]
        speed = qdot[:, :2] - THIGH_LENGTH_M * w[:, 0] * forward(thigh)
        speed += com_m * w[:, 2] * down(angle) - SHANK_LENGTH_M * w[:, 1] * forward(
            shank
        )
        drawn, lever = leg(_middle(q), side), -com_m * forward(_middle(angle))
        force = trajectory.ground_force_n[:, 2 * side : 2 * side + 2]
        above = (
            mass * (_gained(speed) / interval_s + [0.0, GRAVITY_MPS2]) - force
        )  # of the shank
        moment = trajectory.joint_torque_nm[:, 3 * side + 2] - _cross(lever, above)
        moment -= inertia * _gained(w[:, 2, 0]) / interval_s
        low, high = np.sort([drawn.heel, drawn.ball], axis=0) - (drawn.ankle - lever)
        on = force[:, 1] > 0.0
        ahead = (moment + low[:, 1] * force[:, 0]) / np.where(on, force[:, 1], np.inf)
        point = np.column_stack([np.clip(ahead, low[:, 0], high[:, 0]), low[:, 1]])
        left = np.where(on, moment - _cross(point, force), 0.0)
        zero, (ahead, above) = np.zeros_like(left), (drawn.ankle - lever + point).T
        values = (*force.T, zero, ahead, above, zero, zero, zero, left)
        kinds = (f"{foot}ground_{kind}" for kind in ("force_v", "force_p", "torque_"))
        names = [f"{kind}{axis}" for kind in kinds for axis in "xyz"]
        columns |= dict(zip(names, values, strict=True))
    return columns


def _interval(trajectory: Trajectory) -> float:
    """Seconds between two samples; 1 where there is but one."""
    return float(np.diff(trajectory.time_s[:2]).sum()) or 1.0


def _interval_middles(trajectory: Trajectory) -> Array:
    """When the means over the intervals are taken, [t]."""
    return trajectory.time_s - 0.5 * _interval(trajectory)


def _gained(values: Array) -> Array:
    """How much values grow in the interval that ends at a sample, 0 at the first."""
    return np.diff(values, axis=0, prepend=values[:1])


def _middle(values: Array) -> Array:
    """Values in the middle of the interval that ends at a sample."""
    return values - 0.5 * _gained(values)


def _cross(arm: Array, force: Array) -> Array:
    """Moment of forces [t, 2], counter-clockwise, [t]."""
    return np.asarray(arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0])


def model_text(body: Bodies, name: str = "walk", world: Worlds | None = None) -> str:
    """The model of the first body in the first world, as XML."""
    numbers = {
        "mass": body.mass_kg[0].tolist(),
        "inertia": body.inertia_kgm2[0].tolist(),
        "com": body.com_m[0].tolist(),
        "down": (-body.com_m[0]).tolist(),
    }
    text = FOLDER.joinpath(MODEL).read_text("utf-8")
    return text.format(
        name=name,
        version=__version__,
        forces=forces_text(world),
        lines=lines_text(world),
        **numbers,
    )


MARKERS = ["SHOULDER", "HIP"]
MARKERS += [
    f"{side}_{point}" for side in "LR" for point in ("KNEE", "ANKLE", "HEEL", "BALL")
]
MOST_FRAMES = 65535  # that a C3D file can count


def write_c3d(path: Path, trajectory: Trajectory) -> None:
    """Write the markers in mm: forwards, to the left (all in one plane, at 0), and up."""
    import ezc3d

    shown, file = finite(trajectory), ezc3d.c3d()
    if len(shown.time_s) > MOST_FRAMES:
        raise InputError(
            "trajectory", path.name, f"a walk of at most {MOST_FRAMES} samples"
        )
    left, right = (leg(shown.q, side).chain() for side in (LEFT, RIGHT))
    places_m = np.concatenate([trunk(shown.q)[0][:, None], left, right[:, 1:]], axis=1)
    points = np.ones((4, *places_m.T.shape[1:]), np.float32)  # the last is not used
    points[0], points[1], points[2] = (
        1e3 * places_m[..., 0].T,
        0.0,
        1e3 * places_m[..., 1].T,
    )
    rate_hz = 1.0 / float(shown.time_s[0])
    for name, value in (("RATE", [rate_hz]), ("UNITS", ["mm"]), ("LABELS", MARKERS)):
        file["parameters"]["POINT"][name]["value"] = value
    file["data"]["points"] = points
    with (
        TemporaryDirectory() as folder
    ):  # ezc3d insists on the ending, and tells of no full disk
        made = Path(folder) / "walk.c3d"
        file.write(str(made))
        content = made.read_bytes()
    commit(path, lambda new: new.write_bytes(content), lambda new: ezc3d.c3d(str(new)))


FORMATS = (".csv", ".c3d", ".mot", ".sto")
RECORD_RATE_HZ = 1000.0  # of walks that are kept: loads of every tick
KEPT_RATE_HZ = 200.0
MEANS = ("ground_force_n", "joint_torque_nm", "swing_torque_nm", "device_torque_nm")

SEGMENTS = ("thigh", "shank", "foot")
OWN_COORDINATES = (
    "x_m",
    "z_m",
    "hat_rad",
    *(f"{segment}_{side}_rad" for side in SIDES for segment in SEGMENTS),
)
OWN_JOINTS = ("hip_extension", "knee_flexion", "ankle_plantarflexion")
TORQUES = [f"{side}_{joint}" for side in SIDES for joint in OWN_JOINTS]


def kept(trajectory: Trajectory) -> Trajectory:
    """`KEPT_RATE_HZ` of more samples: loads as means over the intervals, all else at their ends."""
    interval_s = float(np.diff(trajectory.time_s[:2]).sum())
    count = round(1.0 / (KEPT_RATE_HZ * interval_s)) if interval_s else 1
    if count < 2:
        return trajectory
    size = len(trajectory.time_s) // count
    names = [
        field.name for field in fields(trajectory) if field.name not in NOT_SAMPLED
    ]
    thin = {name: getattr(trajectory, name)[count - 1 :: count] for name in names}
    whole = {name: getattr(trajectory, name)[: size * count] for name in MEANS}
    means = {
        name: each.reshape(size, count, -1).mean(axis=1) for name, each in whole.items()
    }
    return replace(trajectory, **(thin | means))


def own_columns(trajectory: Trajectory) -> Columns:
    """All samples, by names with units; signs as in `Trajectory`."""
    swing = [name for name in TORQUES if "ankle" not in name]
    return table(
        "time_s",
        trajectory.time_s,
        [
            (OWN_COORDINATES, trajectory.q),
            ([f"{name}ps" for name in OWN_COORDINATES], trajectory.qdot),
            ([f"{name}_rad" for name in TORQUES], trajectory.joint_rad),
            (
                [f"{side}_{muscle}_activation" for side, muscle in SIDED],
                trajectory.activation,
            ),
            (
                [f"{side}_{muscle}_force_n" for side, muscle in SIDED],
                trajectory.muscle_force_n,
            ),
            (
                [f"{side}_ground_{axis}_n" for side in SIDES for axis in "xz"],
                trajectory.ground_force_n,
            ),
            (
                [f"{side}_stance" for side in SIDES],
                trajectory.stance.astype(np.float64),
            ),
            ([f"{name}_torque_nm" for name in TORQUES], trajectory.joint_torque_nm),
            ([f"{name}_swing_torque_nm" for name in swing], trajectory.swing_torque_nm),
            (
                [f"{name}_device_torque_nm" for name in TORQUES],
                trajectory.device_torque_nm,
            ),
            (
                [f"{side}_{muscle}_fibre_m" for side, muscle in SIDED],
                trajectory.fibre_length_m,
            ),
            (
                [f"{side}_{muscle}_fibre_mps" for side, muscle in SIDED],
                trajectory.fibre_velocity_mps,
            ),
            (DELAYED, trajectory.delayed),
        ],
    )


def require_trajectory_file(path: Path) -> None:
    """Refuse a file that `write_trajectory` would refuse; nothing is touched.

    Raises:
        InputError: another ending, or a place that cannot be written.
    """
    if path.suffix not in FORMATS:
        raise InputError(
            "trajectory", path.suffix, f"a file that ends in {', '.join(FORMATS)}"
        )
    if path.suffix == ".c3d" and find_spec("ezc3d") is None:
        raise InputError(
            "trajectory", ".c3d", "with ezc3d: pip install 'taichi-nmm[c3d]'"
        )
    require_writable(path, "trajectory")


def write_trajectory(
    path: Path, trajectory: Trajectory, name: str = "walk", world: Worlds | None = None
) -> None:
    """Write a walk as a file: .csv all samples, .c3d markers, .mot coordinates, .sto states.

    The name is a line of .mot and .sto. `world` is the first that it walked in, None
    the nominal: .sto has the muscles that are there, with their own lengths.

    Raises:
        InputError: another ending, or the file cannot be written.
    """
    require_trajectory_file(path)
    if path.suffix == ".csv":
        columns = own_columns(trajectory)
        commit_text(path, ",".join(columns) + "\n" + table_lines(columns, ","))
    elif path.suffix == ".c3d":
        write_c3d(path, trajectory)
    elif path.suffix == ".mot":
        commit_text(path, storage_text(motion(trajectory), "coordinates", name))
    else:
        commit_text(path, storage_text(states(trajectory, world), "states", name))
