"""Nerves: the controller feels signals that are 20, 10 or 5 ms old, with lag and noise.

Delays are ring buffers at the control tick. A slot is read before it is overwritten, so
a ring of n slots delays by n ticks. Lag and noise are ours. Noise is a hash of tick,
walker and signal, so that it does not depend on the batch, and costs no memory.
"""

from taichi_nmm.kernel.backend import Rows, Static, ti
from taichi_nmm.kernel.contact import on_ground
from taichi_nmm.kernel.elementary import (
    FIRST_FACTOR,
    INCREMENT,
    TICK_FACTOR,
    larger,
    uniform,
)
from taichi_nmm.kernel.layout import (
    GAS,
    GLU,
    HAM,
    LEGS,
    MUSCLES_PER_LEG,
    RINGS,
    SOL,
    TA,
    VAS,
    Signal,
)
from taichi_nmm.kernel.muscle import WIDTH

TA_LENGTH_OFFSET = 1.0 - 0.5 * WIDTH


@ti.func
def sense(lane, state: Rows, muscle: Rows, work: Rows):
    """Present values of the signals that will be felt late, at `work.sensed`."""
    sensed = work.sensed
    for leg in ti.static(range(LEGS)):
        m = ti.static(MUSCLES_PER_LEG * leg)
        length_ta = muscle.length[m + TA, lane] - TA_LENGTH_OFFSET
        sensed.force_sol[leg, lane] = muscle.force[m + SOL, lane]
        sensed.force_gas[leg, lane] = muscle.force[m + GAS, lane]
        sensed.length_ta[leg, lane] = larger(length_ta, 0.0)
        sensed.force_vas[leg, lane] = muscle.force[m + VAS, lane]
        sensed.knee[leg, lane] = work.joint[3 * leg + 1, lane]
        sensed.knee_rate[leg, lane] = work.joint_rate[3 * leg + 1, lane]
        sensed.stance[leg, lane] = on_ground(lane, leg, state)
        sensed.force_ham[leg, lane] = muscle.force[m + HAM, lane]
        sensed.force_glu[leg, lane] = muscle.force[m + GLU, lane]
        sensed.load[leg, lane] = state.load_filter[leg, lane]
    sensed.trunk[lane] = state.q[2, lane]
    sensed.trunk_rate[lane] = state.qdot[2, lane]


@ti.func
def exchange(lane, ring: Static, slot, delay: Rows, work: Rows):
    """Put the present signals of a kind of ring into a slot, and take the delayed ones out."""
    first_signal, count, ticks, first_row = ti.static(RINGS[ring])
    for i in ti.static(range(count)):
        row = first_row + i * ticks + slot
        old = delay[row, lane]
        delay[row, lane] = work.sensed[first_signal + i, lane]
        work.sensed[first_signal + i, lane] = old


RATE_SCALE_RADPS = 10.0  # noise of angular rates over that of angles
FLAGS = range(Signal.stance, Signal.stance + LEGS)
RATES = (Signal.knee_rate, Signal.knee_rate + 1, Signal.trunk_rate)
# Each signal that is no flag, with the scale of its noise.
FELT = tuple(
    (signal, RATE_SCALE_RADPS if signal in RATES else 1.0)
    for signal in range(Signal.count)
    if signal not in FLAGS
)


@ti.func
def feel(lane, tick, state: Rows, const: Rows, work: Rows):
    """Lag and noise on the delayed signals, at `work.sensed`; the others pass unchanged."""
    blend = const.nerve_blend[lane]
    amplitude = const.sensing_noise[lane]
    walker = ti.cast(const.noise_seed[lane], ti.u32)
    start = ti.cast(tick, ti.u32) * ti.u32(TICK_FACTOR) + walker * ti.u32(FIRST_FACTOR)
    for signal, scale in ti.static(FELT):
        now = work.sensed[signal, lane]
        before = state.felt[signal, lane]
        # Not by the blend alone: before + (now - before) is not always now.
        felt = ti.select(blend == 1.0, now, before + blend * (now - before))
        state.felt[signal, lane] = felt
        noise = uniform(start + ti.u32(INCREMENT * (signal + 1) % 2**32))
        work.sensed[signal, lane] = felt + amplitude * scale * noise
