"""The Hill-type muscle-tendon unit: activation, contraction, metabolism.

Sources: Geyer & Herr 2010 (constants, as in the walker T); metabolic rate Alexander
1997.

A contraction is one long chain of steps that wait for each other. So it is cut into
phases: a phase is short enough for the processor to begin the next muscles while it
waits (docs/speed.md).
"""

import numpy as np

from taichi_nmm.kernel.backend import Rows, Static, ti
from taichi_nmm.kernel.elementary import (
    LOG2_E,
    larger,
    smaller,
    square_root,
    two_to,
)
from taichi_nmm.kernel.layout import LEGS, MUSCLES_PER_LEG
from taichi_nmm.kernel.muscle_table import (
    REFERENCE_STRAIN,
    T_POWER,
    T_STRAIN,
    T_STRETCH,
    TABLE_COLUMNS,
)

WIDTH = 0.56  # w of the force-length curve
LOG2_RESIDUAL = float(np.log2(0.05))  # log2 c: force at |l - 1| = w
ECCENTRIC = 1.5  # N: force at the largest lengthening speed
SHAPE = 5.0  # K of the force-velocity curve
ACTIVATION_TIME_S = 0.010
ACTIVATION_FLOOR = 0.01
# The slope of the force-velocity curve beyond v = 1 keeps it monotone.
BEYOND_ECCENTRIC = 100.0
ECCENTRIC_SHAPE = 7.56 * SHAPE
FASTEST_LENGTHENING = 3.0  # over vmax
SHORTEST_FIBRE = 0.05
# The slope of the buffer's root, which reaches Fmax w/2 below the length 1 - w.
BUFFER = 2.0 / WIDTH
# Alexander 1997, metabolic power over a Fmax vmax at a shortening speed u over vmax:
# 0.23 - 0.16 exp(-8 u) while shortening, 0.01 - 0.11 u + 0.06 exp(23 u) while lengthening.
SHORTENING_POWER, SHORTENING_DECAY, SHORTENING_RATE = 0.23, 0.16, -8.0
LENGTHENING_POWER, LENGTHENING_SLOPE, LENGTHENING_GROWTH, LENGTHENING_RATE = (
    0.01,
    0.11,
    0.06,
    23.0,
)
ITERATIONS = 3  # of the fibre's speed; docs/speed.md has the table


@ti.func
def force_length(length):
    """Active force over Fmax at a normalised fibre length: exp(ln c |(l - 1)/w|^3)."""
    x = (length - 1.0) * (1.0 / WIDTH)
    distance = larger(x, 0.0 - x)
    return two_to(LOG2_RESIDUAL * distance * distance * distance)


@ti.func
def force_velocity(shortens, beyond):
    """The force factor (a + b v)/(1 + c v) over a range of speeds v, lengthening positive.

    (1 + v)/(1 - K v) for v < 0, N + (N - 1)(v - 1)/(1 + 7.56 K v) up to v = 1, a line
    beyond.
    """
    middle = ECCENTRIC * ECCENTRIC_SHAPE + ECCENTRIC - 1.0
    a = ti.select(beyond, ECCENTRIC - BEYOND_ECCENTRIC, 1.0)
    b = ti.select(shortens, 1.0, ti.select(beyond, BEYOND_ECCENTRIC, middle))
    c = ti.select(shortens, 0.0 - SHAPE, ti.select(beyond, 0.0, ECCENTRIC_SHAPE))
    return a, b, c


@ti.func
def tension(v, strain, strain_rate, squeeze, squeeze_rate):
    """Tendon plus buffer over Fmax after a step at fibre speed v: value, half fall, half curvature.

    Squares of two lines in v: tendon strain over its reference, none when slack, and
    buffer.
    """
    tendon = larger(strain - strain_rate * v, 0.0)
    buffer = larger(squeeze - squeeze_rate * v, 0.0)
    force = tendon * tendon + buffer * buffer
    half_fall = tendon * strain_rate + buffer * squeeze_rate
    bend = ti.select(tendon > 0.0, strain_rate * strain_rate, 0.0) + ti.select(
        buffer > 0.0, squeeze_rate * squeeze_rate, 0.0
    )
    return force, half_fall, bend


@ti.func
def speed_range(start, strain, strain_rate, squeeze, squeeze_rate, capacity):
    """Where tendon, buffer and fibre balance: a first speed, its range, the fibre's force there.

    The signs at v = 0 and v = 1 tell the range of the force-velocity curve. Returns v,
    low, high, and the fibre's force as (pull + pull_slope v)/(1 + c v).
    """
    at_0, _fall_0, _bend_0 = tension(0.0, strain, strain_rate, squeeze, squeeze_rate)
    at_1, _fall_1, _bend_1 = tension(1.0, strain, strain_rate, squeeze, squeeze_rate)
    shortens = at_0 < capacity
    beyond = (at_1 >= ECCENTRIC * capacity) & (shortens == False)  # noqa: E712
    low = ti.select(shortens, 0.0 - 1.0, ti.select(beyond, 1.0, 0.0))
    high = ti.select(shortens, 0.0, ti.select(beyond, FASTEST_LENGTHENING, 1.0))
    a, b, c = force_velocity(shortens, beyond)
    v = smaller(larger(low, start), high)
    return v, low, high, capacity * a, capacity * b, c


@ti.func
def nearer(
    v, low, high, pull, pull_slope, c, strain, strain_rate, squeeze, squeeze_rate
):
    """A speed nearer to the balance at the end of the step.

    Within its range the excess, tension (1 + c v) - (pull + pull_slope v), is a cubic
    in v: this solves its parabola at v (Euler's method, third order). Never divides by
    the activation, and stays stable where an explicit step would not.
    """
    force, half_fall, bend = tension(v, strain, strain_rate, squeeze, squeeze_rate)
    bottom = 1.0 + c * v
    excess = force * bottom - (pull + pull_slope * v)
    half_slope = half_fall * bottom + 0.5 * (pull_slope - c * force)
    curve = bend * bottom - 2.0 * c * half_fall
    root = square_root(larger(0.0, half_slope * half_slope - curve * excess))
    return smaller(larger(low, v + excess / (half_slope + root)), high)


@ti.func
def metabolic_rate(v):
    """Metabolic power over a Fmax vmax at a normalised fibre speed (Alexander 1997)."""
    shortening = 0.0 - v
    shortens = shortening > 0.0
    e = two_to(
        ti.select(shortens, LOG2_E * SHORTENING_RATE, LOG2_E * LENGTHENING_RATE)
        * shortening
    )
    return ti.select(
        shortens,
        SHORTENING_POWER - SHORTENING_DECAY * e,
        LENGTHENING_POWER - LENGTHENING_SLOPE * shortening + LENGTHENING_GROWTH * e,
    )


@ti.func
def constants(table: Rows, m):
    """Row m of the muscle table."""
    return ti.Vector([table[m, c] for c in ti.static(range(TABLE_COLUMNS))])


@ti.func
def tendon_stretch(lane, row, nominal, own: Static, const: Rows):
    """Strain of a tendon over its reference, for each optimal length of its fibre."""
    stretch = nominal
    if ti.static(own):
        stretch = const.stretch[row, lane]
    return stretch


@ti.func
def activate(
    lane, m, data: Rows, blend, own: Static, muscle: Rows, const: Rows, work: Rows
):
    """Activation of muscle m of both legs, and where its fibre will balance.

    `data` are the muscle's `constants`, `blend` 1 - exp(-step / activation time). Where
    `own`, a constant of the compiler, walkers have their own: the strain s of a tendon
    whose slack length is 1/t of the nominal is t s + (t - 1)/reference, the attachments
    of muscles being where they were.
    """
    for leg in ti.static(range(LEGS)):
        row = m + MUSCLES_PER_LEG * leg
        activation = muscle.activation[row, lane]
        order = muscle.stimulation[row, lane]
        strain = work.strain[row, lane]
        if ti.static(own):
            activation += const.activation_blend[row, lane] * (order - activation)
            tightness = const.tightness[row, lane]
            strain = tightness * strain + (tightness - 1.0) * (1.0 / REFERENCE_STRAIN)
        else:
            activation += blend * (order - activation)
        length = muscle.length[row, lane]
        passive = larger((length - 1.0) * (1.0 / WIDTH), 0.0)
        capacity = activation * force_length(length) + passive * passive
        stretch = tendon_stretch(lane, row, data[T_STRAIN], own, const)
        strain -= stretch * length
        squeeze = ((1.0 - WIDTH) - length) * BUFFER
        v, low, high, pull, pull_slope, hyperbola = speed_range(
            muscle.velocity[row, lane],
            strain,
            data[T_STRETCH] * stretch,
            squeeze,
            data[T_STRETCH] * BUFFER,
            capacity,
        )
        muscle.activation[row, lane] = activation
        muscle.velocity[row, lane] = v
        work.strain[row, lane] = strain
        work.squeeze[row, lane] = squeeze
        work.slowest[row, lane] = low
        work.fastest[row, lane] = high
        work.pull[row, lane] = pull
        work.pull_slope[row, lane] = pull_slope
        work.hyperbola[row, lane] = hyperbola


@ti.func
def balance(lane, m, data: Rows, own: Static, muscle: Rows, const: Rows, work: Rows):
    """One iteration of the fibre's speed of muscle m of both legs."""
    for leg in ti.static(range(LEGS)):
        row = m + MUSCLES_PER_LEG * leg
        muscle.velocity[row, lane] = nearer(
            muscle.velocity[row, lane],
            work.slowest[row, lane],
            work.fastest[row, lane],
            work.pull[row, lane],
            work.pull_slope[row, lane],
            work.hyperbola[row, lane],
            work.strain[row, lane],
            data[T_STRETCH] * tendon_stretch(lane, row, data[T_STRAIN], own, const),
            work.squeeze[row, lane],
            data[T_STRETCH] * BUFFER,
        )


@ti.func
def contract(lane, m, data: Rows, own: Static, muscle: Rows, const: Rows, work: Rows):
    """Length and force of muscle m of both legs after the step, and its metabolic power.

    A muscle's strength scales its tendon too, so that it contracts as the nominal one
    does.
    """
    for leg in ti.static(range(LEGS)):
        row = m + MUSCLES_PER_LEG * leg
        v, strength = (
            muscle.velocity[row, lane],
            const.strength[row, lane],
        )
        stretch = tendon_stretch(lane, row, data[T_STRAIN], own, const)
        strain = work.strain[row, lane] - data[T_STRETCH] * stretch * v
        tendon = larger(strain, 0.0)
        muscle.force[row, lane] = strength * (tendon * tendon)
        length = muscle.length[row, lane] + data[T_STRETCH] * v
        muscle.length[row, lane] = larger(length, SHORTEST_FIBRE)
        power = strength
        if ti.static(own):
            # The power is its own fibre's.
            power *= stretch / (data[T_STRAIN] * const.tightness[row, lane])
        work.metabolic_power[row, lane] = power * (
            muscle.activation[row, lane] * data[T_POWER] * metabolic_rate(v)
        )
