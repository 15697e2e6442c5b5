"""Soft limits of the joints: tau = -k D (1 + w/w_max)+, D the angle beyond the limit.

Source: Geyer & Herr 2010, as in the walker T. Knee and ankle enter the step implicitly.
"""

import math

from taichi_nmm.kernel.backend import Rows, ti
from taichi_nmm.kernel.elementary import larger, smaller
from taichi_nmm.kernel.layout import LEGS, Work

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
        knee = work[Work.joint + 3 * leg + 1, lane]
        ankle = work[Work.joint + 3 * leg + 2, lane]
        bent_back = larger(KNEE_STRAIGHTEST_RAD - knee, 0.0)
        flexed = larger(ANKLE_DORSIFLEXION_LIMIT_RAD - ankle, 0.0)
        pointed = larger(ankle - ANKLE_PLANTARFLEXION_LIMIT_RAD, 0.0)
        ankle_excess = flexed - pointed  # positive pushes towards plantarflexion
        work[Work.stop_torque_0 + 2 * leg, lane] = STOP_STIFFNESS_NMPRAD * bent_back
        work[Work.stop_torque_0 + 2 * leg + 1, lane] = STOP_STIFFNESS_NMPRAD * ankle_excess
        knee_damping = bent_back / STOP_RELAXATION_RADPS + step_s
        ankle_damping = (flexed + pointed) / STOP_RELAXATION_RADPS + step_s
        work[Work.stop_damping + 2 * leg, lane] = STOP_STIFFNESS_NMPRAD * knee_damping
        work[Work.stop_damping + 2 * leg + 1, lane] = STOP_STIFFNESS_NMPRAD * ankle_damping
        work[Work.stop_on + 2 * leg, lane] = ti.select(bent_back > 0.0, 1.0, 0.0)
        work[Work.stop_on + 2 * leg + 1, lane] = ti.select(ankle_excess != 0.0, 1.0, 0.0)


@ti.func
def hip_stops(lane, work: Rows):
    """Add the explicit torque of the extension stop to both hips' torques."""
    for leg in ti.static(range(LEGS)):
        hip = ti.static(3 * leg)
        work[Work.joint_torque + hip, lane] += hip_stop_torque(
            work[Work.joint + hip, lane], work[Work.joint_rate + hip, lane]
        )


@ti.func
def hip_stop_torque(angle, rate):
    """Explicit torque of the hip's extension stop."""
    excess = larger(angle - HIP_EXTENSION_LIMIT_RAD, 0.0)
    factor = smaller(larger(1.0 + rate / HIP_RELAXATION_RADPS, 0.0), HIP_LARGEST_FACTOR)
    return 0.0 - STOP_STIFFNESS_NMPRAD * excess * factor
