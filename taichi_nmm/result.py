"""What a simulation returns: one structured row a walker, and trajectories on request."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm import checks

END_REASONS = ("completed", "fell", "diverged")
"""How a walk ends: `"completed"`, `"fell"`, or `"diverged"` beyond all sense."""

COMPLETED, FELL, DIVERGED = range(len(END_REASONS))

HUMAN_SPEED_MPS = 1.3  # Winter; the paper's v_human and target speed

MUSCLES = ("SOL", "TA", "GAS", "VAS", "HAM", "GLU", "HFL")

OUTCOME_FIELDS: tuple[tuple[str, str], ...] = (
    ("duration_s", "f8"),
    ("end_reason", "u1"),  # index into END_REASONS
    ("hip_x_m", "f8"),
    ("hip_z_m", "f8"),
    ("distance_m", "f8"),
    ("mean_speed_mps", "f8"),
    ("cost_of_transport_jpkgpm", "f8"),
)

# The determinants of gait: sums and means over the scored steps.
SCORE_FIELDS: tuple[tuple[str, str], ...] = (
    ("survived_fraction", "f8"),
    ("step_count", "i4"),
    ("m1_sum", "f8"),
    ("m2_sum", "f8"),
    ("m3_sum", "f8"),
    ("m4_sum", "f8"),
    ("m5_sum_mps", "f8"),
    ("m5_corrected_sum", "f8"),
    ("m1_mean", "f8"),
    ("m2_mean", "f8"),
    ("m3_mean", "f8"),
    ("m4_mean", "f8"),
    ("m5_mean_mps", "f8"),
    ("phi_printed", "f8"),
    ("phi_corrected", "f8"),
)

# Zero where no step was scored. Angles: knee flexion, plantarflexion and forward lean positive.
SUMMARY_FIELDS: tuple[tuple[str, str], ...] = (
    ("knee_peak_swing_rad", "f8"),
    ("knee_peak_stance_rad", "f8"),
    ("ankle_strike_rad", "f8"),
    ("ankle_takeoff_rad", "f8"),
    ("trunk_mean_rad", "f8"),
    ("trunk_sd_rad", "f8"),
    ("step_length_mean_m", "f8"),
    ("step_length_sd_m", "f8"),
    ("step_duration_mean_s", "f8"),
    ("step_duration_sd_s", "f8"),
    ("double_support_fraction", "f8"),
    ("flight_fraction", "f8"),
    ("hip_height_mean_m", "f8"),  # over the ground
    ("hip_height_sd_m", "f8"),
    ("hip_speed_sd_mps", "f8"),
    ("grf_vertical_mean_bw", "f8"),
    ("grf_vertical_peak_bw", "f8"),  # mean over steps of the peak of the 20 ms filtered force
    ("grf_braking_peak_bw", "f8"),
    ("grf_propulsion_peak_bw", "f8"),
    *((f"activation_{muscle.lower()}_mean", "f8") for muscle in MUSCLES),
)

RESULT_DTYPE = np.dtype([*OUTCOME_FIELDS, *SCORE_FIELDS, *SUMMARY_FIELDS])

EVENT_KINDS = ("strike", "takeoff")
# Side 0 is left, 1 right; kind is an index into EVENT_KINDS.
EVENT_DTYPE = np.dtype([("time_s", "f8"), ("side", "u1"), ("kind", "u1")])


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One walker through time, sampled at `rate_hz`; [t] samples, legs left then right.

    Attributes:
        walker: its row in the batch.
        time_s: [t].
        q: generalised coordinates x, z, th_hat, th_thigh_l, th_shank_l, th_foot_l, ..._r, [t, 9].
        qdot: their rates, [t, 9].
        joint_rad: hip, knee, ankle left, then right; extension, flexion, plantarflexion positive,
            [t, 6].
        activation: muscles in the order of `MUSCLES`, left leg then right, [t, 14].
        muscle_force_n: in the order of `activation`, [t, 14].
        ground_force_n: left x, left z, right x, right z, mean over the sample interval, [t, 4].
        stance: foot on the ground, left and right, bool [t, 2].
        events: strikes and take-offs, `EVENT_DTYPE`, at the controller's tick.
    """

    walker: int
    time_s: NDArray[np.float64]
    q: NDArray[np.float64]
    qdot: NDArray[np.float64]
    joint_rad: NDArray[np.float64]
    activation: NDArray[np.float64]
    muscle_force_n: NDArray[np.float64]
    ground_force_n: NDArray[np.float64]
    stance: NDArray[np.bool_]
    events: NDArray[np.void]


@dataclass(frozen=True, eq=False)
class Result:
    """Outcome of a batch.

    Attributes:
        rows: one row a walker in the order given, `RESULT_DTYPE`, [n].
        trajectories: one of each walker in `simulate(record=...)`, in that order.
        metadata: engine, version, architecture, precision, step: what produced the rows.
    """

    rows: NDArray[np.void]
    trajectories: tuple[Trajectory, ...] = ()
    metadata: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """One column by field name.

        Raises:
            InputError: no such field.
        """
        checks.word(*self.rows.dtype.names or ())("column", name)
        return self.rows[name]

    @property
    def end_reason(self) -> NDArray[np.str_]:
        """End reasons as words, [n]."""
        return np.asarray(np.array(END_REASONS)[self.rows["end_reason"]])
