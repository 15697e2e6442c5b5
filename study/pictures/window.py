"""Which part of a walk is shown: its end, where it fell if it fell, at any wanted times."""

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.errors import InputError
from taichi_nmm.result import Trajectory

Array = NDArray[np.float64]

NOT_SAMPLED = ("walker", "events")


def finite(trajectory: Trajectory) -> Trajectory:
    """The samples whose pose is finite: a walker that diverged is shown until it did.

    Raises:
        InputError: there is none.
    """
    good = np.isfinite(trajectory.q).all(axis=1)
    if not good.any():
        raise InputError("trajectory", "no finite sample", "a walker that was recorded")
    if good.all():
        return trajectory
    per_sample = [field.name for field in fields(trajectory) if field.name not in NOT_SAMPLED]
    return replace(trajectory, **{name: getattr(trajectory, name)[good] for name in per_sample})


def last_metres(trajectory: Trajectory, metres: float) -> tuple[float, float]:
    """Start and end time of the last stretch over which the hip travelled `metres`."""
    x = trajectory.q[:, 0]
    before = np.flatnonzero(np.abs(x[-1] - x) > metres)
    first = before[-1] if len(before) else 0
    return float(trajectory.time_s[first]), float(trajectory.time_s[-1])


def last_seconds(trajectory: Trajectory, seconds: float) -> tuple[float, float]:
    """Start and end time of the last `seconds`."""
    start, end = float(trajectory.time_s[0]), float(trajectory.time_s[-1])
    return max(start, end - seconds), end


def at_times(trajectory: Trajectory, values: Array, times_s: Array) -> Array:
    """Columns of `values` [t, k] at these times, linear between samples, [len(times_s), k]."""
    columns = [np.interp(times_s, trajectory.time_s, column) for column in values.T]
    return np.stack(columns, axis=1)
