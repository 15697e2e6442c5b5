"""A recorded walk as a file for other programs: CSV by our own names, .mot and .sto by OpenSim's.

Numbers have as many digits as needed to read the same float64 back.
"""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from storage.commit import commit_text, require_writable
from study.pictures.opensim import (
    SIDED,
    SIDES,
    Columns,
    motion,
    states,
    storage_text,
    table,
    table_lines,
)
from study.pictures.stick_figure import NOT_SAMPLED
from taichi_nmm.errors import InputError
from taichi_nmm.result import Trajectory

FORMATS = (".csv", ".mot", ".sto")
RECORD_RATE_HZ = 1000.0  # of walks that are kept: loads of every tick
KEPT_RATE_HZ = 200.0
MEANS = ("ground_force_n", "joint_torque_nm", "swing_torque_nm")

SEGMENTS = ("thigh", "shank", "foot")
COORDINATES = (
    "x_m", "z_m", "hat_rad", *(f"{segment}_{side}_rad" for side in SIDES for segment in SEGMENTS),
)  # fmt: skip
OWN_JOINTS = ("hip_extension", "knee_flexion", "ankle_plantarflexion")
TORQUES = [f"{side}_{joint}" for side in SIDES for joint in OWN_JOINTS]


def kept(trajectory: Trajectory) -> Trajectory:
    """`KEPT_RATE_HZ` of more samples: loads as means over the intervals, all else at their ends."""
    interval_s = float(np.diff(trajectory.time_s[:2]).sum())
    count = round(1.0 / (KEPT_RATE_HZ * interval_s)) if interval_s else 1
    if count < 2:
        return trajectory
    size = len(trajectory.time_s) // count
    names = [field.name for field in fields(trajectory) if field.name not in NOT_SAMPLED]
    thin = {name: getattr(trajectory, name)[count - 1 :: count] for name in names}
    whole = {name: getattr(trajectory, name)[: size * count] for name in MEANS}
    means = {name: each.reshape(size, count, -1).mean(axis=1) for name, each in whole.items()}
    return replace(trajectory, **(thin | means))


def own_columns(trajectory: Trajectory) -> Columns:
    """All samples, by names with units; signs as in `Trajectory`."""
    swing = [name for name in TORQUES if "ankle" not in name]
    return table("time_s", trajectory.time_s, [
        (COORDINATES, trajectory.q),
        ([f"{name}ps" for name in COORDINATES], trajectory.qdot),
        ([f"{name}_rad" for name in TORQUES], trajectory.joint_rad),
        ([f"{side}_{muscle}_activation" for side, muscle in SIDED], trajectory.activation),
        ([f"{side}_{muscle}_force_n" for side, muscle in SIDED], trajectory.muscle_force_n),
        ([f"{side}_ground_{axis}_n" for side in SIDES for axis in "xz"], trajectory.ground_force_n),
        ([f"{side}_stance" for side in SIDES], trajectory.stance.astype(np.float64)),
        ([f"{name}_torque_nm" for name in TORQUES], trajectory.joint_torque_nm),
        ([f"{name}_swing_torque_nm" for name in swing], trajectory.swing_torque_nm),
        ([f"{side}_{muscle}_fibre_m" for side, muscle in SIDED], trajectory.fibre_length_m),
        ([f"{side}_{muscle}_fibre_mps" for side, muscle in SIDED], trajectory.fibre_velocity_mps),
    ])  # fmt: skip


def trajectory_text(trajectory: Trajectory, suffix: str, name: str = "walk") -> str:
    """A walk as the text of a file: .csv everything, .mot coordinates, .sto states.

    The name is a line of .mot and .sto.

    Raises:
        InputError: another suffix.
    """
    _require_format(suffix)
    if suffix == ".csv":
        columns = own_columns(trajectory)
        return ",".join(columns) + "\n" + table_lines(columns, ",")
    if suffix == ".mot":
        return storage_text(motion(trajectory), "coordinates", name)
    return storage_text(states(trajectory), "states", name)


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
