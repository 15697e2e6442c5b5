"""A recorded walk as files for other programs: CSV by our own names, markers as motion
capture has them, and all that OpenSim 4 takes.

OpenSim gets the model of its body, motion, states, torques beside the muscles', and the
ground's forces. The model has our seven links and planar joints, by the names of
OpenSim's gait10dof18musc: its pelvis is head, arms and trunk in one, with the hip as
its origin. Angles are counter-clockwise positive, flexion of the knee negative. Numbers
have as many digits as needed to read the same float64 back.
"""

from collections.abc import Sequence
from dataclasses import replace
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
    gained,
    lines_text,
    middle,
    motor_torques,
    muscles_of,
)
from study.pictures.stick_figure import (
    LEFT,
    RIGHT,
    down,
    finite,
    forward,
    leg,
    leg_angles,
    of_side,
    samples,
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

FOLDER = Path(__file__).parent  # of the model's template, and the list of loads
FEET = ("1_", "")  # begin the columns of the left and right foot in OpenSim's examples
BASE = [f"ground_pelvis/pelvis_{name}" for name in ("tilt", "tx", "ty")]
COORDINATES = BASE + [
    path.format(side=side) for side in SIDES for path in OPENSIM["leg"]
]
MOTION, STATES, LOADS = "motion.mot", "states.sto", "ground_forces.mot"
CONTROLS = "controls.sto"
LENGTHS = ("pelvis_tx", "pelvis_ty")  # among the coordinates; all others are angles
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
    world = world or Worlds.nominal()
    torques = motor_torques(trajectory, world)
    controls = {"time": _interval_middles(trajectory)}
    controls |= {f"/forceset/{motor}": values for motor, values in torques.items()}
    texts = {
        MODEL: model_text(body, name, world),
        MOTION: storage_text(motion(trajectory), "coordinates", name),
        STATES: storage_text(states(trajectory, world), "states", name),
        CONTROLS: storage_text(controls, "controls", name),
        LOADS: storage_text(loads(trajectory, body), "loads", name),
        EXTERNAL: FOLDER.joinpath(EXTERNAL).read_text("utf-8"),
    }
    with together(folder) as new:
        for file, text in texts.items():
            commit_text(new / file, text)


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


def named(names: Sequence[str], values: Array) -> Columns:
    """The columns of values [t, k], by k names."""
    return dict(zip(names, values.T, strict=True))


def _coordinates(pose: Array) -> Array:
    """OpenSim's coordinates of q, or their rates of qdot, [t, 9] both."""
    x, z, tilt = pose[:, :3].T
    columns = [-tilt, x, z]
    for side in (LEFT, RIGHT):
        thigh, shank, foot = leg_angles(pose, side)
        columns += [-(thigh - tilt), -(shank - thigh), -(foot - shank)]
    return np.column_stack(columns)


def motion(trajectory: Trajectory) -> Columns:
    """Coordinates of the model, angles in degrees."""
    names = [path.rpartition("/")[2] for path in COORDINATES]
    columns = named(names, _coordinates(trajectory.q))
    for name in names:
        if name not in LENGTHS:
            columns[name] = np.rad2deg(columns[name])
    return {"time": trajectory.time_s, **columns}


def states(trajectory: Trajectory, world: Worlds) -> Columns:
    """All states of the model by the paths of OpenSim 4: coordinates, speeds, muscles.

    A muscle that is missing in this world has none; fibres are as `fibre_lengths` has
    them.
    """
    paths = [f"/jointset/{path}" for path in COORDINATES]
    columns = {
        "time": trajectory.time_s,
        **named([f"{path}/value" for path in paths], _coordinates(trajectory.q)),
        **named([f"{path}/speed" for path in paths], _coordinates(trajectory.qdot)),
    }
    lengths = fibre_lengths(trajectory, world)
    for muscle in muscles_of(world):
        path = f"/forceset/{muscle.name}"
        columns[f"{path}/activation"] = trajectory.activation[:, muscle.column]
        columns[f"{path}/fiber_length"] = lengths[muscle.name]
    return columns


def loads(trajectory: Trajectory, body: Bodies) -> Columns:
    """Force, point and torque of the ground on each foot, at the middles of the intervals.

    The point follows from the foot's equation of motion; a torque is what a point
    between heel and ball leaves over.
    """
    columns = {"time": _interval_middles(trajectory)}
    for side, foot in enumerate(FEET):
        push_n = of_side(trajectory.ground_force_n, side)
        place_m, torque_nm = _pressure(trajectory, body, side)
        nothing = np.zeros_like(torque_nm)
        for name, in_plane, third in (
            ("force_v", push_n, nothing),
            ("force_p", place_m, nothing),
            ("torque_", np.zeros_like(push_n), torque_nm),
        ):
            names = [f"{foot}ground_{name}{axis}" for axis in "xyz"]
            columns |= named(names, np.column_stack([in_plane, third]))
    return columns


def _pressure(trajectory: Trajectory, body: Bodies, side: int) -> tuple[Array, Array]:
    """Where the ground pushes a foot, x and z [t, 2], and its torque about there [t]."""
    link = SEGMENT_NAMES.index(f"foot_{SIDES[side]}")
    com_m = body.com_m[0, link]
    interval_s = _interval(trajectory)
    thigh, shank, foot = leg_angles(trajectory.q, side)
    thigh_rate, shank_rate, foot_rate = leg_angles(trajectory.qdot, side)[..., None]
    speed = trajectory.qdot[:, :2] - THIGH_LENGTH_M * thigh_rate * forward(thigh)
    turning = com_m * foot_rate * down(foot)
    speed += turning - SHANK_LENGTH_M * shank_rate * forward(shank)
    joints = leg(middle(trajectory.q), side)
    ankle_m = -com_m * forward(middle(foot))  # as are all points: from the foot's mass
    com = joints.ankle - ankle_m
    push_n = of_side(trajectory.ground_force_n, side)
    push_x, push_z = push_n.T
    gravity = [0.0, GRAVITY_MPS2]
    shank_n = body.mass_kg[0, link] * (gained(speed) / interval_s + gravity) - push_n
    *_, torque_nm = of_side(trajectory.joint_torque_nm, side).T
    moment = torque_nm - _cross(ankle_m, shank_n)
    moment -= body.inertia_kgm2[0, link] * gained(foot_rate[:, 0]) / interval_s
    low, high = np.sort([joints.heel, joints.ball], axis=0) - com
    sole_z = low[:, 1]
    on_ground = push_z > 0.0
    x = (moment + sole_z * push_x) / np.where(on_ground, push_z, np.inf)
    point = np.column_stack([np.clip(x, low[:, 0], high[:, 0]), sole_z])
    left_over = np.where(on_ground, moment - _cross(point, push_n), 0.0)
    return com + point, left_over


def _interval(trajectory: Trajectory) -> float:
    """Seconds between two samples; 1 where there is but one."""
    return float(np.diff(trajectory.time_s[:2]).sum()) or 1.0


def _interval_middles(trajectory: Trajectory) -> Array:
    """When the means over the intervals are taken, [t]."""
    return trajectory.time_s - 0.5 * _interval(trajectory)


def _cross(arm: Array, force: Array) -> Array:
    """Moment of forces [t, 2], counter-clockwise, [t]."""
    return np.asarray(arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0])


def model_text(body: Bodies, name: str, world: Worlds) -> str:
    """The model of the first body in the first world, as XML."""
    return (
        FOLDER.joinpath(MODEL)
        .read_text("utf-8")
        .format(
            name=name,
            version=__version__,
            forces=forces_text(world),
            lines=lines_text(world),
            mass=body.mass_kg[0].tolist(),
            inertia=body.inertia_kgm2[0].tolist(),
            com=body.com_m[0].tolist(),
            down=(-body.com_m[0]).tolist(),
        )
    )


MARKERS = ["SHOULDER", "HIP"]
MARKERS += [
    f"{side}_{point}" for side in "LR" for point in ("KNEE", "ANKLE", "HEEL", "BALL")
]
MOST_FRAMES = 65535  # that a C3D file can count


def write_c3d(path: Path, trajectory: Trajectory) -> None:
    """Write the markers in mm: forwards, to the left (all in one plane, at 0), and up."""
    import ezc3d

    shown = finite(trajectory)
    if len(shown.time_s) > MOST_FRAMES:
        allowed = f"a walk of at most {MOST_FRAMES} samples"
        raise InputError("trajectory", path.name, allowed)
    shoulder, _ = trunk(shown.q)
    left, right = leg(shown.q, LEFT).chain(), leg(shown.q, RIGHT).chain()
    places_m = np.concatenate([shoulder[:, None], left, right[:, 1:]], axis=1)
    across, up = 1e3 * places_m.T
    file = ezc3d.c3d()
    file["data"]["points"] = np.array(
        [across, np.zeros_like(up), up, np.ones_like(up)],  # the last is not used
        np.float32,
    )
    point = file["parameters"]["POINT"]
    point["RATE"]["value"] = [1.0 / float(shown.time_s[0])]
    point["UNITS"]["value"] = ["mm"]
    point["LABELS"]["value"] = MARKERS
    # In a folder of its own: ezc3d insists on the ending, and tells of no full disk.
    with TemporaryDirectory() as folder:
        made = Path(folder) / "walk.c3d"
        file.write(str(made))
        content = made.read_bytes()
    commit(path, lambda new: new.write_bytes(content), lambda new: ezc3d.c3d(str(new)))


FORMATS = (".csv", ".c3d", ".mot", ".sto")
RECORD_RATE_HZ = 1000.0  # of walks that are kept: loads of every tick
KEPT_RATE_HZ = 200.0
MEANS = (
    "ground_force_n",
    "joint_torque_nm",
    "swing_torque_nm",
    "device_torque_nm",
    "push_n",
)

LINKS = [f"{link}_{side}" for side in SIDES for link in ("thigh", "shank", "foot")]
OWN_COORDINATES = ["x_m", "z_m", "hat_rad", *(f"{link}_rad" for link in LINKS)]
OWN_JOINTS = ("hip_extension", "knee_flexion", "ankle_plantarflexion")
JOINTS = [f"{side}_{joint}" for side in SIDES for joint in OWN_JOINTS]
MUSCLES = [f"{side}_{muscle}" for side, muscle in SIDED]
CSV = (  # a field of the trajectory, how the names of its columns begin, and their end
    ("q", OWN_COORDINATES, ""),
    ("qdot", OWN_COORDINATES, "ps"),
    ("joint_rad", JOINTS, "_rad"),
    ("activation", MUSCLES, "_activation"),
    ("muscle_force_n", MUSCLES, "_force_n"),
    (
        "ground_force_n",
        [f"{side}_ground_{axis}" for side in SIDES for axis in "xz"],
        "_n",
    ),
    ("stance", SIDES, "_stance"),
    ("joint_torque_nm", JOINTS, "_torque_nm"),
    (
        "swing_torque_nm",
        [name for name in JOINTS if "ankle" not in name],
        "_swing_torque_nm",
    ),
    ("device_torque_nm", JOINTS, "_device_torque_nm"),
    ("push_n", ["push_n"], ""),
    ("fibre_length_m", MUSCLES, "_fibre_m"),
    ("fibre_velocity_mps", MUSCLES, "_fibre_mps"),
    ("delayed", DELAYED, ""),
)
POWERS = [f"{joint}_power_w" for joint in JOINTS]
OWN_COLUMNS = [f"{stem}{end}" for _, stems, end in CSV for stem in stems] + POWERS
"""Names of `own_columns`, less the time's."""


def kept(trajectory: Trajectory) -> Trajectory:
    """`KEPT_RATE_HZ` of more samples: loads as means over the intervals, all else at their ends."""
    count = round(1.0 / (KEPT_RATE_HZ * _interval(trajectory)))
    if count < 2:
        return trajectory
    size = len(trajectory.time_s) // count
    means = {}
    for name in MEANS:
        whole = getattr(trajectory, name)[: size * count]
        means[name] = whole.reshape(size, count, -1).mean(axis=1)
    return replace(samples(trajectory, slice(count - 1, None, count)), **means)


def own_columns(trajectory: Trajectory) -> Columns:
    """All samples, by names with units; signs as in `Trajectory`.

    A joint's power is the mean over the interval that ends at a sample: its torque
    times the angle that it turns.
    """
    columns = {"time_s": trajectory.time_s}
    for field, stems, end in CSV:
        values = getattr(trajectory, field).astype(np.float64)
        columns |= named([f"{stem}{end}" for stem in stems], values)
    turned_rad = gained(trajectory.joint_rad)
    power_w = trajectory.joint_torque_nm * turned_rad / _interval(trajectory)
    return columns | named(POWERS, power_w)


def require_trajectory_file(path: Path) -> None:
    """Refuse a file that `write_trajectory` would refuse; nothing is touched.

    Raises:
        InputError: another ending, or a place that cannot be written.
    """
    if path.suffix not in FORMATS:
        allowed = f"a file that ends in {', '.join(FORMATS)}"
        raise InputError("trajectory", path.suffix, allowed)
    if path.suffix == ".c3d" and find_spec("ezc3d") is None:
        allowed = "with ezc3d: pip install 'taichi-nmm[c3d]'"
        raise InputError("trajectory", ".c3d", allowed)
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
        columns = states(trajectory, world or Worlds.nominal())
        commit_text(path, storage_text(columns, "states", name))
