"""The seven muscles of a leg, and the table of their constants that the kernel reads.

Source: Geyer & Herr 2010, as in the walker T. What the kernel would multiply or divide at every
step from constants alone is multiplied out here.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.kernel.layout import MUSCLES_PER_LEG
from taichi_nmm.result import MUSCLES

REFERENCE_STRAIN = 0.04  # of the tendon at Fmax


@dataclass(frozen=True)
class Attachment:
    """How a muscle spans a joint: lever `arm_m`, largest at `angle_of_largest_arm_deg`.

    None for `angle_of_largest_arm_deg` is a constant arm. `sign` is that of the joint torque;
    `pennation` (rho) scales the length, not the torque. Angles in the joint's convention.
    """

    arm_m: float
    angle_of_largest_arm_deg: float | None
    reference_angle_deg: float
    pennation: float
    sign: float


@dataclass(frozen=True)
class MuscleData:
    """One muscle: Fmax, optimal fibre length, largest speed, tendon slack length, attachments."""

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
        1500, 0.05, 12, 0.40,
        knee=Attachment(0.05, 40, 15, 0.7, +1), ankle=Attachment(0.05, 20, -10, 0.7, +1),
    ),
    "VAS": MuscleData(6000, 0.08, 12, 0.23, knee=Attachment(0.06, 15, 55, 0.7, -1)),
    "HAM": MuscleData(
        3000, 0.10, 12, 0.31,
        hip=Attachment(0.08, None, -25, 0.7, +1), knee=Attachment(0.05, 0, 0, 0.7, +1),
    ),
    "GLU": MuscleData(1500, 0.11, 12, 0.13, hip=Attachment(0.10, None, -30, 0.5, +1)),
    "HFL": MuscleData(2000, 0.11, 12, 0.10, hip=Attachment(0.10, None, 0, 0.5, -1)),
}  # fmt: skip
assert tuple(MUSCLE_DATA) == MUSCLES

FMAX_N: NDArray[np.float64] = np.array([data.fmax_n for data in MUSCLE_DATA.values()])

# Columns of the table, one row a muscle. The unit is fibre and tendon; its length and the torques
# at Fmax are linear in the hip angle, and in sine and cosine of knee and ankle angle.
(
    T_OPTIMAL, T_SLACK, T_VMAX,  # m, m, 1/s
    T_STRAIN, T_STRAIN_RATE,  # of the tendon over its reference: per m, and at vmax per s
    T_POWER,  # Fmax times largest speed, W
    T_LENGTH, T_HIP_SLOPE, T_KNEE_SINE, T_KNEE_COSINE, T_ANKLE_SINE, T_ANKLE_COSINE,  # m
    T_HIP_TORQUE, T_KNEE_TORQUE_COSINE, T_KNEE_TORQUE_SINE,  # N m at Fmax
    T_ANKLE_TORQUE_COSINE, T_ANKLE_TORQUE_SINE,
    TABLE_COLUMNS,
) = range(18)  # fmt: skip


def muscle_table() -> NDArray[np.float64]:
    """Constants of the seven muscles for the kernel, [7, TABLE_COLUMNS].

    With a cosine arm, dl = rho r (sin(ref - max) - sin(phi - max)) and arm = r cos(phi - max); with
    a constant one, dl = rho r (ref - phi).
    """
    table = np.zeros((MUSCLES_PER_LEG, TABLE_COLUMNS))
    for row, data in zip(table, MUSCLE_DATA.values(), strict=True):
        largest_speed_mps = data.optimal_length_m * data.vmax_per_s
        row[[T_OPTIMAL, T_SLACK, T_VMAX]] = (
            data.optimal_length_m, data.slack_length_m, data.vmax_per_s,
        )  # fmt: skip
        row[T_STRAIN] = 1.0 / (data.slack_length_m * REFERENCE_STRAIN)
        row[T_STRAIN_RATE] = row[T_STRAIN] * largest_speed_mps
        row[T_POWER] = data.fmax_n * largest_speed_mps
        row[T_LENGTH] = data.optimal_length_m + data.slack_length_m
        if data.hip is not None:
            _constant_arm(row, data.hip, data.fmax_n)
        if data.knee is not None:
            _cosine_arm(row, data.knee, data.fmax_n, T_KNEE_SINE, T_KNEE_TORQUE_COSINE)
        if data.ankle is not None:
            _cosine_arm(row, data.ankle, data.fmax_n, T_ANKLE_SINE, T_ANKLE_TORQUE_COSINE)
    return table


def _constant_arm(row: NDArray[np.float64], hip: Attachment, fmax_n: float) -> None:
    scale = hip.sign * hip.pennation * hip.arm_m
    row[T_LENGTH] += scale * np.deg2rad(hip.reference_angle_deg)
    row[T_HIP_SLOPE] = -scale
    row[T_HIP_TORQUE] = hip.sign * hip.arm_m * fmax_n


def _cosine_arm(
    row: NDArray[np.float64],
    attachment: Attachment,
    fmax_n: float,
    sine: int,
    torque_cosine: int,
) -> None:
    assert attachment.angle_of_largest_arm_deg is not None
    largest = np.deg2rad(attachment.angle_of_largest_arm_deg)
    reference = np.deg2rad(attachment.reference_angle_deg)
    scale = attachment.sign * attachment.pennation * attachment.arm_m
    torque = attachment.sign * attachment.arm_m * fmax_n
    row[T_LENGTH] += scale * np.sin(reference - largest)
    row[sine] = -scale * np.cos(largest)
    row[sine + 1] = scale * np.sin(largest)
    row[torque_cosine] = torque * np.cos(largest)
    row[torque_cosine + 1] = torque * np.sin(largest)
