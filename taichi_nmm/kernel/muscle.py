"""The Hill-type muscle-tendon unit: table of the seven muscles, contraction, torque, metabolism.

Sources: Geyer & Herr 2010 (constants, as in the walker T); metabolic rate Alexander 1997.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.kernel.backend import Rows, ti
from taichi_nmm.kernel.elementary import exponential
from taichi_nmm.kernel.layout import MUSCLES_PER_LEG, Muscle, Work
from taichi_nmm.result import MUSCLES

WIDTH = 0.56  # w of the force-length curve
LN_RESIDUAL = float(np.log(0.05))  # ln c: force at |l - 1| = w
ECCENTRIC = 1.5  # N: force at the largest lengthening speed
SHAPE = 5.0  # K of the force-velocity curve
REFERENCE_STRAIN = 0.04  # of the tendon at Fmax
ACTIVATION_TIME_S = 0.010
ACTIVATION_FLOOR = 0.01
BEYOND_ECCENTRIC = 100.0  # slope of the force-velocity curve beyond v = 1, keeps it monotone
ECCENTRIC_SHAPE = 7.56 * SHAPE
SHORTEST_FIBRE = 0.05
# Alexander 1997, metabolic power over a Fmax vmax at a shortening speed u over vmax:
# 0.23 - 0.16 exp(-8 u) while shortening, 0.01 - 0.11 u + 0.06 exp(23 u) while lengthening.
SHORTENING_POWER, SHORTENING_DECAY, SHORTENING_RATE = 0.23, 0.16, -8.0
LENGTHENING_POWER, LENGTHENING_SLOPE, LENGTHENING_GROWTH, LENGTHENING_RATE = 0.01, 0.11, 0.06, 23.0
NEWTON_ITERATIONS = 4  # fixed: the cap is part of the model, all forms of the kernel share it


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

# Columns of the table that the kernel reads, one row a muscle.
(
    T_FMAX, T_OPTIMAL, T_VMAX, T_SLACK,
    T_LENGTH, T_HIP_SLOPE, T_KNEE_SINE, T_KNEE_COSINE, T_ANKLE_SINE, T_ANKLE_COSINE,
    T_HIP_ARM, T_KNEE_ARM_COSINE, T_KNEE_ARM_SINE, T_ANKLE_ARM_COSINE, T_ANKLE_ARM_SINE,
    TABLE_COLUMNS,
) = range(16)  # fmt: skip


def muscle_table() -> NDArray[np.float64]:
    """Constants of the seven muscles for the kernel, [7, TABLE_COLUMNS].

    The unit's length is linear in the hip angle and in sine and cosine of knee and ankle angle, as
    are the signed arms: with a cosine arm, dl = rho r (sin(ref - max) - sin(phi - max)) and
    arm = r cos(phi - max); with a constant one, dl = rho r (ref - phi).
    """
    table = np.zeros((MUSCLES_PER_LEG, TABLE_COLUMNS))
    for row, data in zip(table, MUSCLE_DATA.values(), strict=True):
        row[[T_FMAX, T_OPTIMAL, T_VMAX, T_SLACK]] = (
            data.fmax_n, data.optimal_length_m, data.vmax_per_s, data.slack_length_m,
        )  # fmt: skip
        row[T_LENGTH] = data.optimal_length_m + data.slack_length_m
        if data.hip is not None:
            scale = data.hip.sign * data.hip.pennation * data.hip.arm_m
            row[T_LENGTH] += scale * np.deg2rad(data.hip.reference_angle_deg)
            row[T_HIP_SLOPE] = -scale
            row[T_HIP_ARM] = data.hip.sign * data.hip.arm_m
        if data.knee is not None:
            _cosine_arm(row, data.knee, T_KNEE_SINE, T_KNEE_ARM_COSINE)
        if data.ankle is not None:
            _cosine_arm(row, data.ankle, T_ANKLE_SINE, T_ANKLE_ARM_COSINE)
    return table


def _cosine_arm(
    row: NDArray[np.float64], attachment: Attachment, sine: int, arm_cosine: int
) -> None:
    assert attachment.angle_of_largest_arm_deg is not None
    largest = np.deg2rad(attachment.angle_of_largest_arm_deg)
    reference = np.deg2rad(attachment.reference_angle_deg)
    scale = attachment.sign * attachment.pennation * attachment.arm_m
    row[T_LENGTH] += scale * np.sin(reference - largest)
    row[sine] = -scale * np.cos(largest)
    row[sine + 1] = scale * np.sin(largest)
    row[arm_cosine] = attachment.sign * attachment.arm_m * np.cos(largest)
    row[arm_cosine + 1] = attachment.sign * attachment.arm_m * np.sin(largest)


@ti.func
def constants(table: Rows, m):
    """Row m of the kernel's muscle table, as a vector."""
    return ti.Vector([table[m, column] for column in range(TABLE_COLUMNS)])


@ti.func
def force_length(length):
    """Active force over Fmax at a normalised fibre length: exp(ln c |(l - 1)/w|^3)."""
    x = (length - 1.0) / WIDTH
    distance = ti.max(x, 0.0 - x)
    return exponential(LN_RESIDUAL * distance * distance * distance)


@ti.func
def force_velocity(v):
    """Force factor and its slope at a normalised fibre speed, lengthening positive."""
    shortens = v < 0.0
    beyond = v >= 1.0
    top = ti.select(shortens, 1.0 + v, (ECCENTRIC - 1.0) * (v - 1.0))
    bottom = 1.0 / ti.select(shortens, 1.0 - SHAPE * v, 1.0 + ECCENTRIC_SHAPE * v)
    rise = ti.select(shortens, 1.0 + SHAPE, (ECCENTRIC - 1.0) * (1.0 + ECCENTRIC_SHAPE))
    factor = ti.select(shortens, 0.0, ECCENTRIC) + top * bottom
    slope = rise * bottom * bottom
    factor = ti.select(beyond, ECCENTRIC + BEYOND_ECCENTRIC * (v - 1.0), factor)
    slope = ti.select(beyond, BEYOND_ECCENTRIC, slope)
    return factor, slope


@ti.func
def tendon_strain(unit_length, length, optimal, slack):
    """Strain of the series element over the reference strain, zero when slack."""
    return ti.max((unit_length - length * optimal) / slack - 1.0, 0.0) / REFERENCE_STRAIN


@ti.func
def imbalance(v, length, unit_length, optimal, slack, stretch, capacity):
    """SE + BE - capacity fv at fibre speed v, and its slope in v; strictly decreasing.

    `stretch` is the change of length per unit of v over the step, `capacity` is A fl + PE.
    """
    after = ti.max(length + stretch * v, SHORTEST_FIBRE)
    series = tendon_strain(unit_length, after, optimal, slack)
    buffer = ti.max((1.0 - WIDTH) - after, 0.0) / (0.5 * WIDTH)
    factor, slope = force_velocity(v)
    value = series * series + buffer * buffer - capacity * factor
    series_slope = series * optimal / (slack * REFERENCE_STRAIN)
    rate = 0.0 - 2.0 * stretch * (series_slope + buffer / (0.5 * WIDTH)) - capacity * slope
    return value, rate


@ti.func
def fibre_velocity(start, length, unit_length, optimal, slack, stretch, capacity):
    """Speed at which tendon and fibre balance at the end of the step.

    Safeguarded Newton within the bracket given by the signs at v = 0 and v = 1: never divides by
    the activation, and stays stable where an explicit step would not.
    """
    at_0, _rate_0 = imbalance(0.0, length, unit_length, optimal, slack, stretch, capacity)
    at_1, _rate_1 = imbalance(1.0, length, unit_length, optimal, slack, stretch, capacity)
    low = ti.select(at_0 < 0.0, -3.0, ti.select(at_1 < 0.0, 0.0, 1.0))
    high = ti.select(at_0 < 0.0, 0.0, ti.select(at_1 < 0.0, 1.0, 3.0))
    v = ti.min(ti.max(start, low), high)
    for _ in ti.static(range(NEWTON_ITERATIONS)):
        value, rate = imbalance(v, length, unit_length, optimal, slack, stretch, capacity)
        low = ti.select(value > 0.0, v, low)
        high = ti.select(value > 0.0, high, v)
        newton = v - value / rate
        inside = (newton >= low) & (newton <= high)
        v = ti.select(inside, newton, 0.5 * (low + high))
    return v


@ti.func
def metabolic_rate(v):
    """Metabolic power over a Fmax vmax at a normalised fibre speed (Alexander 1997)."""
    shortening = 0.0 - v
    shortens = shortening > 0.0
    e = exponential(ti.select(shortens, SHORTENING_RATE, LENGTHENING_RATE) * shortening)
    return ti.select(
        shortens,
        SHORTENING_POWER - SHORTENING_DECAY * e,
        LENGTHENING_POWER - LENGTHENING_SLOPE * shortening + LENGTHENING_GROWTH * e,
    )


@ti.func
def contract(lane, leg: Rows, m, data: Rows, step_s, blend, muscle: Rows, work: Rows):
    """One physics step of muscle m of a leg: activation, fibre, force, joint torques, energy.

    `data` is the muscle's row of the table, `blend` 1 - exp(-step / activation time).
    """
    i = leg * MUSCLES_PER_LEG + m
    a = muscle[Muscle.activation + i, lane]
    a += blend * (muscle[Muscle.stimulation + i, lane] - a)
    hip = work[Work.joint + 3 * leg, lane]
    sine_knee = work[Work.sine_joint + 2 * leg, lane]
    cosine_knee = work[Work.cosine_joint + 2 * leg, lane]
    sine_ankle = work[Work.sine_joint + 2 * leg + 1, lane]
    cosine_ankle = work[Work.cosine_joint + 2 * leg + 1, lane]
    unit_length = (
        data[T_LENGTH] + data[T_HIP_SLOPE] * hip
        + data[T_KNEE_SINE] * sine_knee + data[T_KNEE_COSINE] * cosine_knee
        + data[T_ANKLE_SINE] * sine_ankle + data[T_ANKLE_COSINE] * cosine_ankle
    )  # fmt: skip
    length = muscle[Muscle.length + i, lane]
    passive = ti.max((length - 1.0) / WIDTH, 0.0)
    capacity = a * force_length(length) + passive * passive
    optimal, slack = data[T_OPTIMAL], data[T_SLACK]
    stretch = step_s * data[T_VMAX]
    v = fibre_velocity(
        muscle[Muscle.velocity + i, lane], length, unit_length, optimal, slack, stretch, capacity
    )
    length = ti.max(length + stretch * v, SHORTEST_FIBRE)
    series = tendon_strain(unit_length, length, optimal, slack)
    force = data[T_FMAX] * series * series
    muscle[Muscle.activation + i, lane] = a
    muscle[Muscle.length + i, lane] = length
    muscle[Muscle.velocity + i, lane] = v
    muscle[Muscle.force + i, lane] = series * series
    work[Work.joint_torque + 3 * leg, lane] += data[T_HIP_ARM] * force
    work[Work.joint_torque + 3 * leg + 1, lane] += force * (
        data[T_KNEE_ARM_COSINE] * cosine_knee + data[T_KNEE_ARM_SINE] * sine_knee
    )
    work[Work.joint_torque + 3 * leg + 2, lane] += force * (
        data[T_ANKLE_ARM_COSINE] * cosine_ankle + data[T_ANKLE_ARM_SINE] * sine_ankle
    )
    work[Work.metabolic_power, lane] += (
        a * data[T_FMAX] * data[T_VMAX] * optimal * metabolic_rate(v)
    )
