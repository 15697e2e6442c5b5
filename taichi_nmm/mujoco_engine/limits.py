"""The walker's joint stops as limits of MuJoCo's.

A stop is tau = -k D (1 + w/w_max)+, D the angle beyond the limit (`kernel.joint_stops`): a damper
that grows with the excess, and a weak spring. A limit of MuJoCo's with impedance d, whose joint
has the inverse inertia A, gives at a slow creep under a torque T (MuJoCo's documentation,
Computation, "Constraint model")

    (1 - d) T = d (b w + K d D) / A .

Equal damping asks for d/(1 - d) = D/rho with rho = w_max b/(k A). MuJoCo's impedance with its
midpoint at the limit is d_max (1 - (1 - D/width)^p): d_max is right at the width, and p comes
nearest below it. The time constant t is the shortest that MuJoCo lets a step have: b = 2/(d_max t)
is then the largest, and stable.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.kernel import joint_stops as stops

LEAST_RANGE_RAD = math.radians(10.0)  # the law is followed so far at least; walking stays within
POWERS = np.linspace(2.0, 20.0, 73)
EXCESSES = np.linspace(0.05, 0.95, 19)  # over the width, where the power is chosen
STEPS_PER_TIME_CONSTANT = 2.0  # MuJoCo's least (`refsafe`)
SMALLEST_IMPEDANCE = 1e-4  # MuJoCo's own bound
NO_LIMIT_RAD = math.pi


@dataclass(frozen=True)
class Stop:
    """A joint's range, rad, and the law of what lies beyond: stiffness k, relaxation rate w_max."""

    low_rad: float
    high_rad: float
    relaxation_radps: float


STOPS: dict[str, Stop] = {
    "thigh": Stop(-NO_LIMIT_RAD, stops.HIP_EXTENSION_LIMIT_RAD, stops.HIP_RELAXATION_RADPS),
    "shank": Stop(stops.KNEE_STRAIGHTEST_RAD, NO_LIMIT_RAD, stops.STOP_RELAXATION_RADPS),
    "foot": Stop(
        stops.ANKLE_DORSIFLEXION_LIMIT_RAD,
        stops.ANKLE_PLANTARFLEXION_LIMIT_RAD,
        stops.STOP_RELAXATION_RADPS,
    ),
}  # by the segment whose hinge it is


def limit(
    stop: Stop, inverse_inertia: float, step_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`solref` [2] and `solimp` [5] of a limit with a stop's law.

    Args:
        stop: whose law.
        inverse_inertia: of the joint, as MuJoCo has it in `dof_invweight0`, 1/(kg m2).
        step_s: physics step.
    """
    time_constant_s = STEPS_PER_TIME_CONSTANT * step_s
    stiffness = stops.STOP_STIFFNESS_NMPRAD
    slow = 2.0 * stop.relaxation_radps / (time_constant_s * stiffness * inverse_inertia)
    width = max(4.0 * slow, LEAST_RANGE_RAD)
    largest = 1.0 - slow / width  # = width/(width + rho), with rho = slow/largest
    power = _nearest_power(largest, largest * width / slow)
    damping = 2.0 / (largest * time_constant_s)  # b
    # K: d^2 K/(1 - d) = k A at the width, and less below; the damper is what stops.
    spring = stiffness * inverse_inertia * (1.0 - largest) / largest**2
    return (
        np.array([time_constant_s, damping / (2.0 * math.sqrt(spring))]),
        np.array([SMALLEST_IMPEDANCE, largest, width, 0.0, power]),
    )


def _nearest_power(largest: float, widths_of_rho: float) -> float:
    """The power whose d/(1 - d) is nearest to D/rho, by the mean square of the logarithm."""
    impedance = largest * (1.0 - (1.0 - EXCESSES) ** POWERS[:, None])
    error = np.log(impedance / (1.0 - impedance)) - np.log(EXCESSES * widths_of_rho)
    return float(POWERS[np.argmin(np.mean(error**2, axis=1))])
