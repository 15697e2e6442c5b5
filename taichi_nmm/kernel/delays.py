"""Nerves: what the controller feels is 20, 10 or 5 ms old.

Ring buffers at the control tick. A slot is read before it is overwritten, so a ring of n slots
delays by n ticks.
"""

from taichi_nmm.kernel.backend import Rows, ti
from taichi_nmm.kernel.contact import on_ground
from taichi_nmm.kernel.elementary import larger
from taichi_nmm.kernel.layout import (
    GAS,
    GLU,
    HAM,
    LEGS,
    LONG_DELAY_TICKS,
    LONG_SIGNALS,
    MID_DELAY_TICKS,
    MID_SIGNALS,
    MUSCLES_PER_LEG,
    SHORT_DELAY_TICKS,
    SHORT_SIGNALS,
    SOL,
    TA,
    VAS,
    Delay,
    Muscle,
    Signal,
    State,
    Work,
)
from taichi_nmm.kernel.muscle import WIDTH

TA_LENGTH_OFFSET = 1.0 - 0.5 * WIDTH


@ti.func
def sense(lane, state: Rows, muscle: Rows, work: Rows):
    """Present values of the signals that will be felt late, at `Work.sensed`."""
    s = ti.static(Work.sensed)
    for leg in ti.static(range(LEGS)):
        m = ti.static(MUSCLES_PER_LEG * leg)
        length_ta = muscle[Muscle.length + m + TA, lane] - TA_LENGTH_OFFSET
        work[s + Signal.force_sol + leg, lane] = muscle[Muscle.force + m + SOL, lane]
        work[s + Signal.force_gas + leg, lane] = muscle[Muscle.force + m + GAS, lane]
        work[s + Signal.length_ta + leg, lane] = larger(length_ta, 0.0)
        work[s + Signal.force_vas + leg, lane] = muscle[Muscle.force + m + VAS, lane]
        work[s + Signal.knee + leg, lane] = work[Work.joint + 3 * leg + 1, lane]
        work[s + Signal.knee_rate + leg, lane] = work[Work.joint_rate + 3 * leg + 1, lane]
        work[s + Signal.stance + leg, lane] = on_ground(lane, leg, state)
        work[s + Signal.force_ham + leg, lane] = muscle[Muscle.force + m + HAM, lane]
        work[s + Signal.force_glu + leg, lane] = muscle[Muscle.force + m + GLU, lane]
        work[s + Signal.load + leg, lane] = state[State.load_filter + leg, lane]
    work[s + Signal.trunk, lane] = state[State.q + 2, lane]
    work[s + Signal.trunk_rate, lane] = state[State.qdot + 2, lane]


@ti.func
def exchange(lane, slot_long, slot_mid, slot_short, delay: Rows, work: Rows):
    """Put the present signals into their rings and take the delayed ones out, in place."""
    s = ti.static(Work.sensed)
    for i in ti.static(range(LONG_SIGNALS)):
        row = Delay.long + i * LONG_DELAY_TICKS + slot_long
        old = delay[row, lane]
        delay[row, lane] = work[s + i, lane]
        work[s + i, lane] = old
    for i in ti.static(range(MID_SIGNALS)):
        row = Delay.mid + i * MID_DELAY_TICKS + slot_mid
        old = delay[row, lane]
        delay[row, lane] = work[s + LONG_SIGNALS + i, lane]
        work[s + LONG_SIGNALS + i, lane] = old
    for i in ti.static(range(SHORT_SIGNALS)):
        row = Delay.short + i * SHORT_DELAY_TICKS + slot_short
        old = delay[row, lane]
        delay[row, lane] = work[s + LONG_SIGNALS + MID_SIGNALS + i, lane]
        work[s + LONG_SIGNALS + MID_SIGNALS + i, lane] = old
