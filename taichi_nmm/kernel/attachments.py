"""How the muscles span the joints: strains of their tendons, and joint torques from their forces.

A joint that a muscle does not span is left out of its sums when the kernel is compiled.
"""

from taichi_nmm.kernel.backend import Rows, ti
from taichi_nmm.kernel.layout import LEGS, MUSCLES_PER_LEG, Muscle, Work
from taichi_nmm.kernel.muscle_table import STRAINS, TORQUES_NM

KNEE, ANKLE = 1, 2  # joints of a leg

CONSTANT_STRAINS = tuple(float(row[0]) for row in STRAINS)
HIP_TORQUES_NM = tuple((m, float(row[0])) for m, row in enumerate(TORQUES_NM) if row[0])


def strain_terms(leg: int, m: int) -> list[tuple[float, int]]:
    """Factors of muscle m's strain, and the rows of `Work` that they multiply."""
    knee, ankle = 2 * leg, 2 * leg + 1
    rows = (
        Work.joint + 3 * leg,
        Work.sine_joint + knee, Work.cosine_joint + knee,
        Work.sine_joint + ankle, Work.cosine_joint + ankle,
    )  # fmt: skip
    return [(float(f), row) for f, row in zip(STRAINS[m, 1:], rows, strict=True) if f]


def torque_terms(joint: int) -> list[tuple[int, float, float]]:
    """Muscles of knee or ankle, each with its torque's factors of cosine and sine, N m at Fmax."""
    factors = TORQUES_NM[:, 2 * joint - 1 : 2 * joint + 1]
    return [(m, float(row[0]), float(row[1])) for m, row in enumerate(factors) if row.any()]


@ti.func
def stretch_tendons(lane, work: Rows):
    """Strain of each tendon over its reference, if its fibre had no length."""
    for leg in ti.static(range(LEGS)):
        for m in ti.static(range(MUSCLES_PER_LEG)):
            strain = 0.0
            strain += CONSTANT_STRAINS[m]
            for factor, row in ti.static(strain_terms(leg, m)):
                strain += factor * work[row, lane]
            work[Work.strain + MUSCLES_PER_LEG * leg + m, lane] = strain


@ti.func
def turn_joints(lane, muscle: Rows, work: Rows):
    """Torques of the muscles on hip, knee and ankle, N m."""
    for leg in ti.static(range(LEGS)):
        force = ti.static(Muscle.force + MUSCLES_PER_LEG * leg)
        hip = 0.0
        for m, torque in ti.static(HIP_TORQUES_NM):
            hip += torque * muscle[force + m, lane]
        work[Work.joint_torque + 3 * leg, lane] = hip
        for joint in ti.static((KNEE, ANKLE)):
            of_cosine = 0.0
            of_sine = 0.0
            for m, cosine, sine in ti.static(torque_terms(joint)):
                of_cosine += cosine * muscle[force + m, lane]
                of_sine += sine * muscle[force + m, lane]
            row = ti.static(2 * leg + joint - 1)
            work[Work.joint_torque + 3 * leg + joint, lane] = (
                of_cosine * work[Work.cosine_joint + row, lane]
                + of_sine * work[Work.sine_joint + row, lane]
            )
