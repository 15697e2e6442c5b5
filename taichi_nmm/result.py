"""What a simulation returns: a structured row a walker, trajectories on request; costs of rows."""

import math
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.inputs import checks
from storage.inputs.errors import InputError

END_REASONS = ("completed", "fell", "diverged")
"""How a walk ends: `"completed"`, `"fell"`, or `"diverged"` (to NaN, or beyond 10^6)."""

COMPLETED, FELL, DIVERGED = range(len(END_REASONS))
FALL_HEIGHT_M = 0.6  # hip over the ground
FALL_LEAN_RAD = math.radians(60.0)

HUMAN_SPEED_MPS = 1.3  # Winter; the paper's v_human and target speed

MUSCLES = ("SOL", "TA", "GAS", "VAS", "HAM", "GLU", "HFL")
"""Names of a leg's muscles, [7]."""

DELAYED_BY_LEG = (
    "SOL_force_fmax",
    "GAS_force_fmax",
    "TA_stretch_lopt",
    "VAS_force_fmax",
    "knee_flexion_rad",
    "knee_flexion_radps",
    "stance",
    "HAM_force_fmax",
    "GLU_force_fmax",
    "load_hat_weight",
)
DELAYED = (
    *(f"{side}_delayed_{signal}" for signal in DELAYED_BY_LEG for side in "lr"),
    "delayed_hat_rad",
    "delayed_hat_radps",
)
"""Signals of the nerves, with units: forces over the nominal Fmax, load over the weight
of head, arms and trunk, stretch of TA beyond its reflex's offset in optimal lengths."""

Fields = tuple[tuple[str, str], ...]


COLUMNS = tomllib.loads(
    Path(__file__).with_name("columns.toml").read_text(encoding="utf-8")
)
OUTCOME_FIELDS: Fields = tuple(COLUMNS["outcome"].items())
SCORE_FIELDS: Fields = tuple(COLUMNS["score"].items())  # the determinants of gait
SUMMARY_FIELDS: Fields = tuple(COLUMNS["summary"].items())
# A store has these where its `kept` names them.
FURTHER_FIELDS: Fields = tuple(COLUMNS["further"].items())

ENERGY, OF_MUSCLES = "cost_of_transport_powered_jpkgpm", "cost_of_transport_jpkgpm"
"""What a gait of the least energy has the least of, unless a goal names another column:
the energy of muscles and motors, J for each kg of the whole body and each metre; and
that of muscles alone."""

RESULT_DTYPE = np.dtype(
    [*OUTCOME_FIELDS, *SCORE_FIELDS, *SUMMARY_FIELDS, *FURTHER_FIELDS]
)

NEEDED_BY = {
    column: needed for needed, columns in COLUMNS["needs"].items() for column in columns
}
"""Of columns that may be unknown, the column that tells."""


def unknown(column: str, given: Any) -> NDArray[np.bool_]:
    """Where a column is unknown, though rows of results have a number there, [n].

    No step was scored, none was begun, or the walker got nowhere; steps of one leg
    alone are not compared with those of the other; a walker that diverged left no
    number.

    Args:
        column: its name.
        given: the columns by name, each [n]: this one, and that of `NEEDED_BY`.
    """
    values = np.asarray(given[column], dtype=np.float64)
    missing: NDArray[np.bool_] = ~np.isfinite(values)
    if column.endswith("_asymmetry"):
        missing |= np.abs(values) >= 1.0
    if column not in NEEDED_BY:
        return missing
    measured = np.asarray(given[NEEDED_BY[column]], dtype=np.float64)
    if NEEDED_BY[column] == "mean_speed_mps":
        return np.asarray(missing | ~(measured > 0.0))
    return np.asarray(missing | (measured == 0.0))


def unmeasured(column: str, given: Any) -> NDArray[np.bool_]:
    """As `unknown`, where the columns that are given tell; nowhere else.

    Args:
        column: of the walker's, or of any other simulator.
        given: columns by name, perhaps without the one that tells.
    """
    names = given.dtype.names if isinstance(given, np.ndarray) else given
    if NEEDED_BY.get(column) in names:
        return unknown(column, given)
    return np.zeros(np.shape(given[column]), dtype=bool)


def known_numbers(row: np.void) -> dict[str, float | int | None]:
    """The numbers of a row by column, as plain values; None: unknown."""
    names = row.dtype.names or ()
    return {name: None if unknown(name, row) else row[name].item() for name in names}


EVENT_KINDS = ("strike", "takeoff")
# Side 0 is left, 1 right; kind is an index into EVENT_KINDS.
EVENT_DTYPE = np.dtype([("time_s", "f8"), ("side", "u1"), ("kind", "u1")])


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One walker through time, sampled at `rate_hz`; [t] samples, legs left then right.

    Attributes:
        walker: its row in the batch.
        time_s: [t].
        q: generalised coordinates x, z, th_hat, th_thigh_l, th_shank_l, th_foot_l,
            ..._r, [t, 9].
        qdot: their rates, [t, 9].
        joint_rad: hip, knee, ankle left, then right; extension, flexion, plantarflexion
            positive, [t, 6].
        activation: muscles in the order of `MUSCLES`, left leg then right, [t, 14].
        muscle_force_n: in the order of `activation`, [t, 14].
        ground_force_n: left x, left z, right x, right z, mean over the sample interval,
            [t, 4].
        joint_torque_nm: all that turns a joint in the last physics step, in the order
            and signs of `joint_rad`, [t, 6]: muscles, ideal torques, exoskeleton,
            prosthesis, and stops (but not those of MuJoCo).
        swing_torque_nm: the ideal part of it, left hip, left knee, right hip, right
            knee, [t, 4].
        device_torque_nm: of an exoskeleton, in the order of `joint_torque_nm`, [t, 6].
        push_n: of a world's push on the trunk, forwards, mean over the sample interval,
            [t, 1].
        fibre_length_m: of the contractile elements, in the order of `activation`, [t,
            14].
        fibre_velocity_mps: their rates, lengthening positive, [t, 14].
        delayed: signals that reach the controller, 20, 10 or 5 ms old, in the order of
            `DELAYED`, [t, 22]; without the lag and the noise of a world.
        stance: foot on the ground, left and right, bool [t, 2].
        events: strikes and take-offs, `EVENT_DTYPE`, at the controller's tick.
        prosthesis: whether the left leg, and the right, has one, bool [2].
        push: when the world's begins, how long it lasts, and its force, [3]; 0 where
            there is none.
        slip: the same, with the friction meanwhile.
    """

    walker: int
    time_s: NDArray[np.float64]
    q: NDArray[np.float64]
    qdot: NDArray[np.float64]
    joint_rad: NDArray[np.float64]
    activation: NDArray[np.float64]
    muscle_force_n: NDArray[np.float64]
    ground_force_n: NDArray[np.float64]
    joint_torque_nm: NDArray[np.float64]
    swing_torque_nm: NDArray[np.float64]
    device_torque_nm: NDArray[np.float64]
    push_n: NDArray[np.float64]
    fibre_length_m: NDArray[np.float64]
    fibre_velocity_mps: NDArray[np.float64]
    delayed: NDArray[np.float64]
    stance: NDArray[np.bool_]
    events: NDArray[np.void]
    prosthesis: NDArray[np.bool_]
    push: NDArray[np.float64]
    slip: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Result:
    """Outcome of a batch.

    Attributes:
        rows: one row a walker in the order given, `RESULT_DTYPE`, [n].
        trajectories: one of each walker in `simulate(record=...)`, in that order.
        metadata: engine, version, architecture, precision and step that produced the
            rows.
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


# The two costs of Antonova, Rai, Atkeson 2016. The paper leaves two things open: the
# speed term of the smooth cost is taken as a deviation, and the distance of a walker
# that fell backward as zero, since 1/(1 + d) has a pole at -1 m.

FALL_COST = 300.0
SPEED_WEIGHT = 100.0
NEEDED = (
    "distance_m",
    "duration_s",
    "mean_speed_mps",
    "cost_of_transport_jpkgpm",
    "end_reason",
)


def _rows(field: str, value: Any) -> Any:
    """Result rows: a structured array with the columns of the costs."""
    names = getattr(getattr(value, "dtype", None), "names", None) or ()
    for name in NEEDED:
        if name not in names or value.dtype[name].kind not in "fiu":
            raise InputError(
                field, value, f"rows of a Result, with numbers in the column {name}"
            )
    return value


_checked = checks.checked(rows=_rows, target_speed_mps=checks.number())


@_checked
def smooth_cost(
    rows: NDArray[np.void], target_speed_mps: float = HUMAN_SPEED_MPS
) -> NDArray[np.float64]:
    """1/(1 + t) + 0.3/(1 + d) + 0.01 |s - s_target| of each row, [n].

    t is the time walked in s, d the final hip position in m, s the mean speed in m/s.

    Args:
        rows: of a `Result`, [n].
        target_speed_mps: s_target.
    """
    distance = np.maximum(rows["distance_m"], 0.0)
    speed_error = np.abs(rows["mean_speed_mps"] - target_speed_mps)
    return np.asarray(
        1.0 / (1.0 + rows["duration_s"]) + 0.3 / (1.0 + distance) + 0.01 * speed_error
    )


@_checked
def walking_cost(
    rows: NDArray[np.void], target_speed_mps: float = HUMAN_SPEED_MPS
) -> NDArray[np.float64]:
    """300 - x_fall of a walker that fell, else 100 |v - v_target| + cost of transport, [n].

    x_fall is the distance before the fall in m, the cost of transport in J/(kg m). A
    walker that stood still until the end counts as walking, and pays 130 for its speed.

    Args:
        rows: of a `Result`, [n].
        target_speed_mps: v_target.
    """
    fell = FALL_COST - np.maximum(rows["distance_m"], 0.0)
    walked = (
        SPEED_WEIGHT * np.abs(rows["mean_speed_mps"] - target_speed_mps)
        + rows["cost_of_transport_jpkgpm"]
    )
    return np.asarray(np.where(rows["end_reason"] == COMPLETED, walked, fell))
