"""The Hill-type muscle-tendon unit: contraction, joint torques, metabolism.

Sources: Geyer & Herr 2010 (constants, as in the walker T); metabolic rate Alexander 1997.

Some muscles of both legs contract side by side: a quantity is a vector, an element a chain, in the
order left, right of the first muscle, then of the next. A contraction is one long chain of steps
that wait for each other; several of them keep the processor busy (docs/speed.md).
"""

import numpy as np

from taichi_nmm.kernel.backend import Rows, ti
from taichi_nmm.kernel.elementary import exponential, larger, smaller
from taichi_nmm.kernel.layout import LEGS, MUSCLES_PER_LEG, Muscle, Work
from taichi_nmm.kernel.muscle_table import (
    T_ANKLE_COSINE,
    T_ANKLE_SINE,
    T_ANKLE_TORQUE_COSINE,
    T_ANKLE_TORQUE_SINE,
    T_HIP_SLOPE,
    T_HIP_TORQUE,
    T_KNEE_COSINE,
    T_KNEE_SINE,
    T_KNEE_TORQUE_COSINE,
    T_KNEE_TORQUE_SINE,
    T_LENGTH,
    T_OPTIMAL,
    T_POWER,
    T_SLACK,
    T_STRAIN,
    T_STRAIN_RATE,
    T_VMAX,
    TABLE_COLUMNS,
)

WIDTH = 0.56  # w of the force-length curve
LN_RESIDUAL = float(np.log(0.05))  # ln c: force at |l - 1| = w
ECCENTRIC = 1.5  # N: force at the largest lengthening speed
SHAPE = 5.0  # K of the force-velocity curve
ACTIVATION_TIME_S = 0.010
ACTIVATION_FLOOR = 0.01
BEYOND_ECCENTRIC = 100.0  # slope of the force-velocity curve beyond v = 1, keeps it monotone
ECCENTRIC_SHAPE = 7.56 * SHAPE
FASTEST_LENGTHENING = 3.0  # over vmax
SHORTEST_FIBRE = 0.05
BUFFER = 2.0 / WIDTH  # slope of the buffer's root: it reaches Fmax w/2 below the length 1 - w
# Alexander 1997, metabolic power over a Fmax vmax at a shortening speed u over vmax:
# 0.23 - 0.16 exp(-8 u) while shortening, 0.01 - 0.11 u + 0.06 exp(23 u) while lengthening.
SHORTENING_POWER, SHORTENING_DECAY, SHORTENING_RATE = 0.23, 0.16, -8.0
LENGTHENING_POWER, LENGTHENING_SLOPE, LENGTHENING_GROWTH, LENGTHENING_RATE = 0.01, 0.11, 0.06, 23.0
ITERATIONS = 3  # of the fibre's speed; tests/taichi_nmm/kernel/convergence.py has the table


@ti.func
def constants(table: Rows, m, n: Rows):
    """Rows m to m + n - 1 of the muscle table, one after another."""
    return ti.Vector(
        [table[m + j, c] for j in ti.static(range(n)) for c in ti.static(range(TABLE_COLUMNS))]
    )


@ti.func
def column(data: Rows, c: Rows, n: Rows):
    """A column of `constants`, the same for both legs."""
    return ti.Vector(
        [data[TABLE_COLUMNS * j + c] for j in ti.static(range(n)) for _ in ti.static(range(LEGS))]
    )


@ti.func
def of_joint(rows: Rows, first: Rows, stride: Rows, lane, n: Rows):
    """Left and right leg's value of a joint, `stride` rows apart, for each of n muscles."""
    return ti.Vector(
        [
            rows[first + stride * leg, lane]
            for _ in ti.static(range(n))
            for leg in ti.static(range(LEGS))
        ]
    )


@ti.func
def of_fibres(rows: Rows, first, lane, n: Rows):
    """Left and right leg's value of n muscles; `first` is the first one's row of the left leg."""
    return ti.Vector(
        [
            rows[first + j + MUSCLES_PER_LEG * leg, lane]
            for j in ti.static(range(n))
            for leg in ti.static(range(LEGS))
        ]
    )


@ti.func
def force_length(length):
    """Active force over Fmax at a normalised fibre length: exp(ln c |(l - 1)/w|^3)."""
    x = (length - 1.0) * (1.0 / WIDTH)
    distance = larger(x, 0.0 - x)
    return exponential(LN_RESIDUAL * distance * distance * distance)


@ti.func
def force_velocity(shortens, beyond):
    """The force factor (a + b v)/(1 + c v) over a range of speeds v, lengthening positive.

    (1 + v)/(1 - K v) for v < 0, N + (N - 1)(v - 1)/(1 + 7.56 K v) up to v = 1, a line beyond.
    """
    middle = ECCENTRIC * ECCENTRIC_SHAPE + ECCENTRIC - 1.0
    a = ti.select(beyond, ECCENTRIC - BEYOND_ECCENTRIC, 1.0)
    b = ti.select(shortens, 1.0, ti.select(beyond, BEYOND_ECCENTRIC, middle))
    c = ti.select(shortens, 0.0 - SHAPE, ti.select(beyond, 0.0, ECCENTRIC_SHAPE))
    return a, b, c


@ti.func
def tension(v, strain, strain_rate, squeeze, squeeze_rate):
    """Tendon plus buffer over Fmax after a step at fibre speed v: value, fall, half curvature.

    Squares of two lines in v: tendon strain over its reference, none when slack, and buffer.
    """
    tendon = larger(strain - strain_rate * v, 0.0)
    buffer = larger(squeeze - squeeze_rate * v, 0.0)
    force = tendon * tendon + buffer * buffer
    fall = 2.0 * (tendon * strain_rate + buffer * squeeze_rate)
    bend = ti.select(tendon > 0.0, strain_rate * strain_rate, 0.0) + ti.select(
        buffer > 0.0, squeeze_rate * squeeze_rate, 0.0
    )
    return force, fall, bend


@ti.func
def fibre_velocity(start, strain, strain_rate, squeeze, squeeze_rate, capacity):
    """Speed at which tendon, buffer and fibre balance at the end of the step.

    The signs at v = 0 and v = 1 tell the range of the force-velocity curve. Within it the excess
    tension (1 + c v) - capacity (a + b v) is a cubic in v; each iteration solves its parabola at v
    (Euler's method, third order). Never divides by the activation, and stays stable where an
    explicit step would not.
    """
    at_0, _fall_0, _bend_0 = tension(0.0, strain, strain_rate, squeeze, squeeze_rate)
    at_1, _fall_1, _bend_1 = tension(1.0, strain, strain_rate, squeeze, squeeze_rate)
    shortens = at_0 < capacity
    beyond = (at_1 >= ECCENTRIC * capacity) & (shortens == False)  # noqa: E712
    low = ti.select(shortens, 0.0 - 1.0, ti.select(beyond, 1.0, 0.0))
    high = ti.select(shortens, 0.0, ti.select(beyond, FASTEST_LENGTHENING, 1.0))
    a, b, c = force_velocity(shortens, beyond)
    v = smaller(larger(low, start), high)
    for _ in ti.static(range(ITERATIONS)):
        force, fall, bend = tension(v, strain, strain_rate, squeeze, squeeze_rate)
        bottom = 1.0 + c * v
        excess = force * bottom - capacity * (a + b * v)
        slope = fall * bottom - force * c + capacity * b
        curve = bend * bottom - fall * c
        root = ti.sqrt(larger(0.0, slope * slope - 4.0 * curve * excess))
        v = smaller(larger(low, v + 2.0 * excess / (slope + root)), high)
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
def contract(lane, m, n: Rows, data: Rows, step_s, blend, muscle: Rows, work: Rows):
    """One physics step of n muscles of both legs: activation, fibre, force, torques, energy.

    `data` are the `constants` of muscles m to m + n - 1, `blend` 1 - exp(-step / activation time).
    """
    hip = of_joint(work, Work.joint, 3, lane, n)
    sine_knee = of_joint(work, Work.sine_joint, 2, lane, n)
    cosine_knee = of_joint(work, Work.cosine_joint, 2, lane, n)
    sine_ankle = of_joint(work, Work.sine_joint + 1, 2, lane, n)
    cosine_ankle = of_joint(work, Work.cosine_joint + 1, 2, lane, n)
    unit_length = (
        column(data, T_LENGTH, n) + column(data, T_HIP_SLOPE, n) * hip
        + column(data, T_KNEE_SINE, n) * sine_knee + column(data, T_KNEE_COSINE, n) * cosine_knee
        + column(data, T_ANKLE_SINE, n) * sine_ankle
        + column(data, T_ANKLE_COSINE, n) * cosine_ankle
    )  # fmt: skip
    activation = of_fibres(muscle, Muscle.activation + m, lane, n)
    activation += blend * (of_fibres(muscle, Muscle.stimulation + m, lane, n) - activation)
    length = of_fibres(muscle, Muscle.length + m, lane, n)
    passive = larger((length - 1.0) * (1.0 / WIDTH), 0.0)
    capacity = activation * force_length(length) + passive * passive
    tendon_length = unit_length - column(data, T_OPTIMAL, n) * length
    strain = (tendon_length - column(data, T_SLACK, n)) * column(data, T_STRAIN, n)
    strain_rate = step_s * column(data, T_STRAIN_RATE, n)
    stretch = step_s * column(data, T_VMAX, n)
    squeeze = ((1.0 - WIDTH) - length) * BUFFER
    start = of_fibres(muscle, Muscle.velocity + m, lane, n)
    v = fibre_velocity(start, strain, strain_rate, squeeze, stretch * BUFFER, capacity)
    tendon = larger(strain - strain_rate * v, 0.0)
    force = tendon * tendon
    length = larger(length + stretch * v, SHORTEST_FIBRE)
    hip_torque = column(data, T_HIP_TORQUE, n) * force
    knee_torque = force * (
        column(data, T_KNEE_TORQUE_COSINE, n) * cosine_knee
        + column(data, T_KNEE_TORQUE_SINE, n) * sine_knee
    )
    ankle_torque = force * (
        column(data, T_ANKLE_TORQUE_COSINE, n) * cosine_ankle
        + column(data, T_ANKLE_TORQUE_SINE, n) * sine_ankle
    )
    power = activation * column(data, T_POWER, n) * metabolic_rate(v)
    for j in ti.static(range(n)):
        for leg in ti.static(range(LEGS)):
            i = m + j + MUSCLES_PER_LEG * leg
            chain = ti.static(LEGS * j + leg)
            muscle[Muscle.activation + i, lane] = activation[chain]
            muscle[Muscle.length + i, lane] = length[chain]
            muscle[Muscle.velocity + i, lane] = v[chain]
            muscle[Muscle.force + i, lane] = force[chain]
            work[Work.joint_torque + 3 * leg, lane] += hip_torque[chain]
            work[Work.joint_torque + 3 * leg + 1, lane] += knee_torque[chain]
            work[Work.joint_torque + 3 * leg + 2, lane] += ankle_torque[chain]
            work[Work.metabolic_power, lane] += power[chain]
