"""The seven muscles of a leg, and the tables of their constants that the kernel takes.

Source: Geyer & Herr 2010, as in the walker T. Products and quotients of constants are
computed here, not at every step.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.kernel.layout import MUSCLES_PER_LEG
from taichi_nmm.result import MUSCLES

REFERENCE_STRAIN = 0.04  # of the tendon at Fmax


@dataclass(frozen=True)
class Attachment:
    """How a muscle spans a joint, whose convention its angles have.

    Attributes:
        arm_m: the lever, where it is largest.
        angle_of_largest_arm_deg: of the joint; None: the lever is the same at all
            angles.
        reference_angle_deg: of the joint, at which the attachment adds no length.
        pennation: rho, which scales the length and not the torque, 0 to 1.
        sign: of the joint's torque, 1 or -1.
    """

    arm_m: float
    angle_of_largest_arm_deg: float | None
    reference_angle_deg: float
    pennation: float
    sign: float


@dataclass(frozen=True)
class MuscleData:
    """One muscle of a leg, the same on both sides.

    Attributes:
        fmax_n: its largest isometric force, Fmax.
        optimal_length_m: of its fibre, at which the force is largest.
        vmax_per_s: its largest speed, in optimal lengths a second.
        slack_length_m: of its tendon, up to which it carries no force.
        hip: attachment there; None: it does not span this joint.
        knee: likewise.
        ankle: likewise.
    """

    fmax_n: float
    optimal_length_m: float
    vmax_per_s: float
    slack_length_m: float
    hip: Attachment | None = None
    knee: Attachment | None = None
    ankle: Attachment | None = None


MUSCLE_DATA: dict[str, MuscleData] = {
    "SOL": MuscleData(4000, 0.04, 6, 0.26, ankle=Attachment(0.05, 20, -10, 0.5, +1)),
    "TA": MuscleData(800, 0.06, 12, 0.24, ankle=Attachment(0.04, -10, 20, 0.7, -1)),
    "GAS": MuscleData(
        1500,
        0.05,
        12,
        0.40,
        knee=Attachment(0.05, 40, 15, 0.7, +1),
        ankle=Attachment(0.05, 20, -10, 0.7, +1),
    ),
    "VAS": MuscleData(6000, 0.08, 12, 0.23, knee=Attachment(0.06, 15, 55, 0.7, -1)),
    "HAM": MuscleData(
        3000,
        0.10,
        12,
        0.31,
        hip=Attachment(0.08, None, -25, 0.7, +1),
        knee=Attachment(0.05, 0, 0, 0.7, +1),
    ),
    "GLU": MuscleData(1500, 0.11, 12, 0.13, hip=Attachment(0.10, None, -30, 0.5, +1)),
    "HFL": MuscleData(2000, 0.11, 12, 0.10, hip=Attachment(0.10, None, 0, 0.5, -1)),
}
assert tuple(MUSCLE_DATA) == MUSCLES

# Of the seven muscles, [7] each.
FMAX_N, OPTIMAL_LENGTH_M, VMAX_PER_S, SLACK_LENGTH_M = (
    np.array([getattr(data, name) for data in MUSCLE_DATA.values()], dtype=np.float64)
    for name in ("fmax_n", "optimal_length_m", "vmax_per_s", "slack_length_m")
)

# Columns of `muscle_table`, one row a muscle.
(
    T_STRETCH,  # optimal lengths that the fibre lengthens in a step at its largest speed
    T_STRAIN,  # of the tendon over its reference, for each optimal length of the fibre
    T_POWER,  # Fmax times largest speed, W
    TABLE_COLUMNS,
) = range(4)


def muscle_table(step_s: float) -> NDArray[np.float64]:
    """Constants of contraction for a physics step, [7, TABLE_COLUMNS]."""
    table = np.zeros((MUSCLES_PER_LEG, TABLE_COLUMNS))
    table[:, T_STRETCH] = step_s * VMAX_PER_S
    table[:, T_STRAIN] = OPTIMAL_LENGTH_M / (SLACK_LENGTH_M * REFERENCE_STRAIN)
    table[:, T_POWER] = FMAX_N * OPTIMAL_LENGTH_M * VMAX_PER_S
    return table


def unit_lengths(
    hip_rad: float, knee_rad: float, ankle_rad: float
) -> NDArray[np.float64]:
    """Length of fibre and tendon together of a leg's muscles, m, [7]."""
    knee, ankle = (
        (np.sin(knee_rad), np.cos(knee_rad)),
        (np.sin(ankle_rad), np.cos(ankle_rad)),
    )
    return np.asarray(LENGTHS_M @ np.array([1.0, hip_rad, *knee, *ankle]))


def _span_tables() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lengths of fibre and tendon together, m, [7, 6], and torques at Fmax, N m, [7, 5].

    As factors of 1, the hip's angle, sine and cosine of the knee, of the ankle; of the
    torques, of 1 (at the hip), cosine and sine of the knee, of the ankle. With a cosine
    arm r cos(phi - max), dl = rho r (sin(ref - max) - sin(phi - max)); with a constant
    one, that of the hip, dl = rho r (ref - phi).
    """
    lengths, torques = np.zeros((MUSCLES_PER_LEG, 6)), np.zeros((MUSCLES_PER_LEG, 5))
    for length, torque, data in zip(
        lengths, torques, MUSCLE_DATA.values(), strict=True
    ):
        length[0] = data.optimal_length_m + data.slack_length_m
        if data.hip is not None:
            scale = data.hip.sign * data.hip.pennation * data.hip.arm_m
            length[0] += scale * np.deg2rad(data.hip.reference_angle_deg)
            length[1] = -scale
            torque[0] = data.hip.sign * data.hip.arm_m * data.fmax_n
        for first, attachment in ((1, data.knee), (3, data.ankle)):
            if attachment is not None:
                assert attachment.angle_of_largest_arm_deg is not None
                largest = np.deg2rad(attachment.angle_of_largest_arm_deg)
                turn = np.array([np.cos(largest), np.sin(largest)])
                scale = attachment.sign * attachment.pennation * attachment.arm_m
                length[0] += scale * np.sin(
                    np.deg2rad(attachment.reference_angle_deg) - largest
                )
                length[first + 1 : first + 3] = scale * turn * (-1, 1)
                torque[first : first + 2] = (
                    attachment.sign * attachment.arm_m * data.fmax_n * turn
                )
    return lengths, torques


LENGTHS_M, TORQUES_NM = _span_tables()
# As the lengths: the tendons' strains over the reference at fibre length 0, [7, 6].
STRAINS = np.column_stack([LENGTHS_M[:, 0] - SLACK_LENGTH_M, LENGTHS_M[:, 1:]])
STRAINS /= (SLACK_LENGTH_M * REFERENCE_STRAIN)[:, None]
