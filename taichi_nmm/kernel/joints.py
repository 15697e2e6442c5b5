"""Torques of the joints: from the forces of the muscles that span them, and from their stops.

A joint that a muscle does not span is left out of its sums when the kernel is compiled.

Stops are soft limits, tau = -k D (1 + w/w_max)+, D the angle beyond the limit (Geyer &
Herr 2010, as in the walker T). Knee and ankle enter the step implicitly.
"""

import math
from typing import Any

from taichi_nmm.kernel.backend import Rows, ti
from taichi_nmm.kernel.elementary import larger, smaller
from taichi_nmm.kernel.layout import LEGS, MUSCLES_PER_LEG
from taichi_nmm.kernel.muscle_table import STRAINS, TORQUES_NM

KNEE, ANKLE = 1, 2  # joints of a leg

CONSTANT_STRAINS = tuple(float(row[0]) for row in STRAINS)
HIP_TORQUES_NM = tuple((m, float(row[0])) for m, row in enumerate(TORQUES_NM) if row[0])


def strain_terms(leg: int, m: int, work: Any) -> list[tuple[float, Any]]:
    """Factors of muscle m's strain, and the rows of `work` that they multiply."""
    knee = 2 * leg
    ankle = knee + 1
    rows = (
        work.joint[3 * leg],
        work.sine_joint[knee],
        work.cosine_joint[knee],
        work.sine_joint[ankle],
        work.cosine_joint[ankle],
    )
    return [(float(f), row) for f, row in zip(STRAINS[m, 1:], rows, strict=True) if f]


def torque_terms(joint: int) -> list[tuple[int, float, float]]:
    """Muscles of knee or ankle, each with its torque's factors of cosine and sine, N m at Fmax."""
    factors = TORQUES_NM[:, 2 * joint - 1 : 2 * joint + 1]
    return [
        (m, float(row[0]), float(row[1])) for m, row in enumerate(factors) if row.any()
    ]


@ti.func
def stretch_tendons(lane, work: Rows):
    """Strain of each tendon over its reference, if its fibre had no length."""
    for leg in ti.static(range(LEGS)):
        for m in ti.static(range(MUSCLES_PER_LEG)):
            strain = 0.0
            strain += CONSTANT_STRAINS[m]
            for factor, row in ti.static(strain_terms(leg, m, work)):
                strain += factor * row[lane]
            work.strain[MUSCLES_PER_LEG * leg + m, lane] = strain


@ti.func
def turn_joints(lane, muscle: Rows, work: Rows):
    """Torques of the muscles on hip, knee and ankle, N m."""
    for leg in ti.static(range(LEGS)):
        first = ti.static(MUSCLES_PER_LEG * leg)
        hip = 0.0
        for m, torque in ti.static(HIP_TORQUES_NM):
            hip += torque * muscle.force[first + m, lane]
        work.joint_torque[3 * leg, lane] = hip
        for joint in ti.static((KNEE, ANKLE)):
            of_cosine = 0.0
            of_sine = 0.0
            for m, cosine, sine in ti.static(torque_terms(joint)):
                of_cosine += cosine * muscle.force[first + m, lane]
                of_sine += sine * muscle.force[first + m, lane]
            row = ti.static(2 * leg + joint - 1)
            work.joint_torque[3 * leg + joint, lane] = (
                of_cosine * work.cosine_joint[row, lane]
                + of_sine * work.sine_joint[row, lane]
            )


STOP_STIFFNESS_NMPRAD = math.degrees(0.3)  # 0.3 N m/deg
STOP_RELAXATION_RADPS = math.radians(1.0)
KNEE_STRAIGHTEST_RAD = math.radians(5.0)
ANKLE_DORSIFLEXION_LIMIT_RAD = math.radians(-20.0)
ANKLE_PLANTARFLEXION_LIMIT_RAD = math.radians(40.0)
HIP_EXTENSION_LIMIT_RAD = math.radians(50.0)
HIP_RELAXATION_RADPS = math.radians(20.0)  # softened, since the hip's stop is explicit
HIP_LARGEST_FACTOR = 4.0


@ti.func
def knee_and_ankle_stops(lane, step_s, work: Rows):
    """Torques at zero rate, their damping c = k D/w_max + k h, and which stops start as active."""
    for leg in ti.static(range(LEGS)):
        knee = work.joint[3 * leg + 1, lane]
        ankle = work.joint[3 * leg + 2, lane]
        bent_back = larger(KNEE_STRAIGHTEST_RAD - knee, 0.0)
        flexed = larger(ANKLE_DORSIFLEXION_LIMIT_RAD - ankle, 0.0)
        pointed = larger(ankle - ANKLE_PLANTARFLEXION_LIMIT_RAD, 0.0)
        ankle_excess = flexed - pointed  # positive pushes towards plantarflexion
        work.stop_torque_0[2 * leg, lane] = STOP_STIFFNESS_NMPRAD * bent_back
        work.stop_torque_0[2 * leg + 1, lane] = STOP_STIFFNESS_NMPRAD * ankle_excess
        knee_damping = bent_back / STOP_RELAXATION_RADPS + step_s
        ankle_damping = (flexed + pointed) / STOP_RELAXATION_RADPS + step_s
        work.stop_damping[2 * leg, lane] = STOP_STIFFNESS_NMPRAD * knee_damping
        work.stop_damping[2 * leg + 1, lane] = STOP_STIFFNESS_NMPRAD * ankle_damping
        work.stop_on[2 * leg, lane] = ti.select(bent_back > 0.0, 1.0, 0.0)
        work.stop_on[2 * leg + 1, lane] = ti.select(ankle_excess != 0.0, 1.0, 0.0)


@ti.func
def hip_stops(lane, work: Rows):
    """Add the explicit torque of the extension stop to both hips' torques."""
    for leg in ti.static(range(LEGS)):
        hip = ti.static(3 * leg)
        excess = larger(work.joint[hip, lane] - HIP_EXTENSION_LIMIT_RAD, 0.0)
        factor = 1.0 + work.joint_rate[hip, lane] / HIP_RELAXATION_RADPS
        factor = smaller(larger(factor, 0.0), HIP_LARGEST_FACTOR)
        work.joint_torque[hip, lane] += 0.0 - STOP_STIFFNESS_NMPRAD * excess * factor
