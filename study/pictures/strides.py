"""Cutting a walk into strides of the left leg, each stretched to 0 to 100 %."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.result import EVENT_KINDS, MUSCLES, Trajectory

Array = NDArray[np.float64]

PERCENT: Array = np.linspace(0.0, 100.0, 201)
SETTLING_STRIDES = 3  # the first ones still carry the initial state
FEWEST_STRIDES = 3

LEFT = 0
STRIKE, TAKE_OFF = EVENT_KINDS.index("strike"), EVENT_KINDS.index("takeoff")


@dataclass(frozen=True, eq=False)
class Strides:
    """n strides of the left leg at `PERCENT` [p], in clinical signs.

    Attributes:
        hip_flexion_deg, knee_flexion_deg, dorsiflexion_deg: [n, p].
        vertical_bw, forward_bw: ground force on the left foot over body weight, [n, p].
        activation: [7, n, p] in the order of `MUSCLES`.
        take_off_percent: when the foot leaves the ground, [k] of strides that have it.
        duration_s: [n].
    """

    hip_flexion_deg: Array
    knee_flexion_deg: Array
    dorsiflexion_deg: Array
    vertical_bw: Array
    forward_bw: Array
    activation: Array
    take_off_percent: Array
    duration_s: Array

    def __len__(self) -> int:
        """How many."""
        return len(self.duration_s)

    @property
    def enough(self) -> bool:
        """Whether a mean and a spread make sense."""
        return len(self) >= FEWEST_STRIDES


def left_strides(trajectory: Trajectory, body_weight_n: float) -> Strides:
    """All strides from left heel strike to left heel strike after the settling ones."""
    strikes = _times(trajectory, STRIKE)[SETTLING_STRIDES:]
    starts, ends = strikes[:-1], strikes[1:]
    joints = np.rad2deg(trajectory.joint_rad[:, :3])
    # A force is the mean over the interval that ends at its sample: it belongs to the middle.
    half_interval_s = 0.5 * np.diff(trajectory.time_s[:2]).sum()

    def cut(column: Array, lag_s: float = 0.0) -> Array:
        fractions = PERCENT / 100.0
        times = starts[:, None] + (ends - starts)[:, None] * fractions
        if not times.size:
            return np.zeros((0, len(PERCENT)))
        return np.interp(times + lag_s, trajectory.time_s, column)

    force = trajectory.ground_force_n / body_weight_n
    return Strides(
        hip_flexion_deg=-cut(joints[:, 0]),
        knee_flexion_deg=cut(joints[:, 1]),
        dorsiflexion_deg=-cut(joints[:, 2]),
        vertical_bw=cut(force[:, 1], half_interval_s),
        forward_bw=cut(force[:, 0], half_interval_s),
        activation=np.array([cut(trajectory.activation[:, m]) for m in range(len(MUSCLES))]),
        take_off_percent=_take_offs(trajectory, starts, ends),
        duration_s=ends - starts,
    )


def _times(trajectory: Trajectory, kind: int) -> Array:
    """Times of the left foot's events of a kind, in order, [k]."""
    events = trajectory.events
    wanted = (events["side"] == LEFT) & (events["kind"] == kind)
    return np.sort(events["time_s"][wanted])


def _take_offs(trajectory: Trajectory, starts: Array, ends: Array) -> Array:
    """Percent of the stride at the first take-off within each."""
    take_offs = _times(trajectory, TAKE_OFF)
    percents = []
    for start, end in zip(starts, ends, strict=True):
        within = take_offs[(take_offs > start) & (take_offs < end)]
        percents += [100.0 * (time - start) / (end - start) for time in within[:1]]
    return np.array(percents)
