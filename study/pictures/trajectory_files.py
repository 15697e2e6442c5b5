"""A recorded walk as a file for other programs: CSV by our own names, .mot and .sto by OpenSim's.

Names and signs of .mot and .sto are those of OpenSim's planar model gait10dof18musc: angles
counter-clockwise positive, flexion of the knee negative. Its pelvis is our hip, its trunk does not
bend. Numbers have as many digits as needed to read the same float64 back.
"""

import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from storage.commit import commit_text, require_writable
from taichi_nmm.errors import InputError
from taichi_nmm.result import MUSCLES, Trajectory

Columns = dict[str, NDArray[np.float64]]

FORMATS = (".csv", ".mot", ".sto")
RECORD_RATE_HZ = 200.0  # of walks that are kept

OPENSIM = tomllib.loads(Path(__file__).with_name("opensim.toml").read_text(encoding="utf-8"))
SIDES = ("l", "r")
OPENSIM_JOINTS = ("hip_flexion", "knee_angle", "ankle_angle")
SEGMENTS = ("thigh", "shank", "foot")
COORDINATES = (
    "x_m", "z_m", "hat_rad", *(f"{segment}_{side}_rad" for side in SIDES for segment in SEGMENTS),
)  # fmt: skip
OWN_JOINTS = ("hip_extension", "knee_flexion", "ankle_plantarflexion")
SIDED = [(side, muscle) for side in SIDES for muscle in MUSCLES]


def own_columns(trajectory: Trajectory) -> Columns:
    """All samples, by names with units; signs as in `Trajectory`."""
    return _columns("time_s", trajectory, [
        (COORDINATES, trajectory.q),
        ([f"{name}ps" for name in COORDINATES], trajectory.qdot),
        ([f"{side}_{joint}_rad" for side in SIDES for joint in OWN_JOINTS], trajectory.joint_rad),
        ([f"{side}_{muscle}_activation" for side, muscle in SIDED], trajectory.activation),
        ([f"{side}_{muscle}_force_n" for side, muscle in SIDED], trajectory.muscle_force_n),
        ([f"{side}_ground_{axis}_n" for side in SIDES for axis in "xz"], trajectory.ground_force_n),
        ([f"{side}_stance" for side in SIDES], trajectory.stance.astype(np.float64)),
    ])  # fmt: skip


def coordinates(trajectory: Trajectory) -> Columns:
    """Generalised coordinates of OpenSim's model, angles in degrees."""
    joints = -np.rad2deg(trajectory.joint_rad)  # extension, flexion, plantarflexion: all clockwise
    return _columns("time", trajectory, [
        (["pelvis_tilt"], -np.rad2deg(trajectory.q[:, 2:3])),
        (["pelvis_tx", "pelvis_ty"], trajectory.q[:, :2]),
        ([f"{joint}_r" for joint in OPENSIM_JOINTS], joints[:, 3:]),
        ([f"{joint}_l" for joint in OPENSIM_JOINTS], joints[:, :3]),
        (["lumbar_extension"], np.zeros((len(joints), 1))),
    ])  # fmt: skip


def forces(trajectory: Trajectory) -> Columns:
    """Forces of the ground, and activation and force of each muscle, by OpenSim's names."""
    muscles = [f"{OPENSIM['muscles'][muscle]}_{side}" for side, muscle in SIDED]
    return _columns("time", trajectory, [
        ([f"ground_force_{side}_{axis}" for side in SIDES for axis in ("vx", "vy")],
         trajectory.ground_force_n),
        ([f"{name}.activation" for name in muscles], trajectory.activation),
        ([f"{name}.tendon_force" for name in muscles], trajectory.muscle_force_n),
    ])  # fmt: skip


def _columns(
    time: str, trajectory: Trajectory, named: Iterable[tuple[Sequence[str], NDArray[np.float64]]]
) -> Columns:
    """The time, and the columns of arrays [t, k] by their names, k each."""
    columns = {time: trajectory.time_s}
    for names, values in named:
        columns |= dict(zip(names, values.T, strict=True))
    return columns


def trajectory_text(trajectory: Trajectory, suffix: str, name: str = "walk") -> str:
    """A walk as the text of a file: .csv everything, .mot coordinates, .sto forces.

    The name is a line of .mot and .sto.

    Raises:
        InputError: another suffix.
    """
    _require_format(suffix)
    if suffix == ".csv":
        columns = own_columns(trajectory)
        return ",".join(columns) + "\n" + _lines(columns, ",")
    if suffix == ".mot":
        columns, degrees, words = coordinates(trajectory), "yes", OPENSIM["coordinates"]
    else:
        columns, degrees, words = forces(trajectory), "no", OPENSIM["forces"]
    # OpenSim's storage, version 1: lines before `endheader` that are no keys are remarks.
    rows = len(trajectory.time_s)
    head = f"{name}\nversion=1\nnRows={rows}\nnColumns={len(columns)}\ninDegrees={degrees}\n\n"
    return f"{head}{words}\nendheader\n" + "\t".join(columns) + "\n" + _lines(columns, "\t")


def require_trajectory_file(path: Path) -> None:
    """Refuse a file that `write_trajectory` would refuse; nothing is touched.

    Raises:
        InputError: another ending, or a place that cannot be written.
    """
    _require_format(path.suffix)
    require_writable(path, "trajectory")


def write_trajectory(path: Path, trajectory: Trajectory, name: str = "walk") -> None:
    """Write a walk as a file whose name ends in .csv, .mot or .sto.

    Raises:
        InputError: another ending, or the file cannot be written.
    """
    commit_text(path, trajectory_text(trajectory, path.suffix, name))


def _require_format(suffix: str) -> None:
    if suffix not in FORMATS:
        raise InputError("trajectory", suffix, f"a file that ends in {', '.join(FORMATS)}")


def _lines(columns: Columns, between: str) -> str:
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    return "".join(between.join(map(repr, row)) + "\n" for row in rows)
