"""Nerves besides their delays: a lag and noise on what is felt, in worlds that have them.

Both are ours. Noise is a hash of tick, walker and signal, so that it is the same whoever else is in
the batch, and costs no memory.
"""

from taichi_nmm.kernel.backend import Rows, ti
from taichi_nmm.kernel.layout import LEGS, Const, Signal, State, Work

RATE_SCALE_RADPS = 10.0  # noise of angular rates over that of angles
FLAGS = range(Signal.stance, Signal.stance + LEGS)
RATES = (Signal.knee_rate, Signal.knee_rate + 1, Signal.trunk_rate)
# Each signal that is no flag, with the scale of its noise.
FELT = tuple(
    (signal, RATE_SCALE_RADPS if signal in RATES else 1.0)
    for signal in range(Signal.count)
    if signal not in FLAGS
)
# Weyl's increment 2^32 / golden ratio, and the rounds of `lowbias32` (C. Wellons, 2018).
INCREMENT, FIRST_FACTOR, SECOND_FACTOR = 0x9E3779B9, 0x7FEB352D, 0x846CA68B
TICK_FACTOR = 0x85EBCA6B  # odd: no two ticks share their noise


@ti.func
def feel(lane, tick, state: Rows, const: Rows, work: Rows):
    """Lag and noise on the delayed signals, at `Work.sensed`; the others pass unchanged."""
    blend = const[Const.nerve_blend, lane]
    amplitude = const[Const.sensing_noise, lane]
    walker = ti.cast(const[Const.noise_seed, lane], ti.u32)
    start = ti.cast(tick, ti.u32) * ti.u32(TICK_FACTOR) + walker * ti.u32(FIRST_FACTOR)
    for signal, scale in ti.static(FELT):
        now = work[Work.sensed + signal, lane]
        before = state[State.felt + signal, lane]
        # Not by the blend alone: before + (now - before) is not always now.
        felt = ti.select(blend == 1.0, now, before + blend * (now - before))
        state[State.felt + signal, lane] = felt
        noise = uniform(start + ti.u32(INCREMENT * (signal + 1) % 2**32))
        work[Work.sensed + signal, lane] = felt + amplitude * scale * noise


@ti.func
def uniform(word):
    """A number in [-1, 1) from a word of 32 bits."""
    word ^= word >> ti.u32(16)
    word *= ti.u32(FIRST_FACTOR)
    word ^= word >> ti.u32(15)
    word *= ti.u32(SECOND_FACTOR)
    word ^= word >> ti.u32(16)
    return ti.cast(ti.cast(word >> ti.u32(8), ti.i32), float) * 2.0**-23 - 1.0
