"""Steps and their score: the determinants of gait M1..M5 of Antonova et al. 2016, in the kernel.

A step is swing -> strike -> stance -> take-off of one leg, scored at its committed
take-off. Contact is debounced: a foot takes off when contact has been lost for 0.1 s,
and strikes when it comes down after at least as long. A swing that began before the
simulation is not observed whole: neither the left leg's first stance nor the right
leg's first swing makes a step.
"""

import math

from taichi_nmm.kernel.backend import Rows, Static, ti
from taichi_nmm.kernel.contact import ground_at_ankle, on_ground
from taichi_nmm.kernel.elementary import larger, latch
from taichi_nmm.kernel.layout import (
    LEGS,
    MUSCLE_COUNT,
    MUSCLES_PER_LEG,
)
from taichi_nmm.result import HUMAN_SPEED_MPS

DEBOUNCE_TICKS = 100.0  # 0.1 s
KNEE_FLEXION_LOW_RAD = math.radians(35.0)
KNEE_FLEXION_HIGH_RAD = math.radians(95.0)
TICKS_PER_SECOND = 1000.0


@ti.func
def add(row: Rows, lane, condition, value):
    """Add `value` where `condition` holds. Not by a factor of 0 or 1: 0 times NaN is NaN."""
    row[lane] += ti.select(condition, value, 0.0)


@ti.func
def add_with_square(rows: Rows, lane, condition, value):
    """Add `value` and its square, of which a mean and a standard deviation are made."""
    add(rows[0], lane, condition, value)
    add(rows[1], lane, condition, value * value)


@ti.func
def notice(lane, leg: Static, state: Rows, gait: Rows, work: Rows):
    """Whether a leg strikes the ground at this tick, or its take-off is sure."""
    alive = state.active[lane] > 0.5
    down = alive & (on_ground(lane, leg, state) > 0.5)
    was_standing = gait.in_stance[leg, lane] > 0.5
    rested = gait.air_ticks[leg, lane] >= DEBOUNCE_TICKS
    strike = down & rested & (was_standing == False)  # noqa: E712
    takeoff = alive & was_standing & rested & (down == False)  # noqa: E712
    work.strike[leg, lane] = ti.select(strike, 1.0, 0.0)
    work.takeoff[leg, lane] = ti.select(takeoff, 1.0, 0.0)
    if ti.static(leg == 0):
        work.event[lane] = 0.0
    latch(work.event, lane, strike | takeoff, 1.0)


@ti.func
def note_events(
    lane, leg: Static, tick, state: Rows, gait: Rows, sums: Rows, work: Rows
):
    """Score the step of a leg that has left the ground, and begin the stance of one that strikes.

    Of what both legs share it changes the tick of the last strike alone.
    """
    strike = work.strike[leg, lane] > 0.5
    takeoff = work.takeoff[leg, lane] > 0.5
    score_step(lane, leg, takeoff & (gait.struck[leg, lane] > 0.5), gait, sums)
    latch(gait.tick_takeoff[leg], lane, takeoff, gait.tick_last[leg, lane])
    for joint in ti.static(range(3)):
        latch(gait.torque_peak[3 * leg + joint], lane, takeoff, 0.0)

    count_strike(lane, leg, strike, tick, gait, sums, work)
    took_off = ti.select(gait.tick_takeoff[leg, lane] > 0.0, 1.0, 0.0)
    com = work.com_z[lane] - ground_at_ankle(lane, leg, work)
    for begun, value in ti.static(
        (
            (gait.struck, took_off),
            (gait.knee_peak_swing, gait.knee_peak[leg, lane]),
            (gait.ankle_strike, work.joint[3 * leg + 2, lane]),
            (gait.com_strike, com),
            (gait.com_mid, 0.0),
            (gait.past_middle, 0.0),
            (gait.hip_x_strike, state.q[0, lane]),
            (gait.tick_strike, tick),
            (gait.trunk_sum, 0.0),
            (gait.knee_peak_stance, 0.0),
            (gait.vertical_peak, 0.0),
            (gait.braking_peak, 0.0),
            (gait.propulsion_peak, 0.0),
        )
    ):
        latch(begun[leg], lane, strike, value)
    latch(gait.in_stance[leg], lane, takeoff, 0.0)
    latch(gait.in_stance[leg], lane, strike, 1.0)


@ti.func
def follow_leg(
    lane, leg: Static, tick, state: Rows, const: Rows, gait: Rows, work: Rows
):
    """Mid-stance, peaks and latest values of one leg."""
    alive = state.active[lane] > 0.5
    down = alive & (on_ground(lane, leg, state) > 0.5)
    knee = work.joint[3 * leg + 1, lane]
    com = work.com_z[lane] - ground_at_ankle(lane, leg, work)
    middle = (
        alive
        & (gait.in_stance[leg, lane] > 0.5)
        & (gait.past_middle[leg, lane] < 0.5)
        & (state.q[0, lane] >= work.ankle_x[leg, lane])
    )
    latch(gait.com_mid[leg], lane, middle, com)
    latch(gait.past_middle[leg], lane, middle, 1.0)
    follow_contact(lane, leg, tick, down, com, state, const, gait, work)
    highest = larger(gait.knee_peak[leg, lane], knee)
    gait.knee_peak[leg, lane] = ti.select(down, knee, highest)
    latch(gait.ankle_last[leg], lane, down, work.joint[3 * leg + 2, lane])
    air = ti.select(down, 0.0, gait.air_ticks[leg, lane] + 1.0)
    latch(gait.air_ticks[leg], lane, alive, air)


@ti.func
def follow_contact(
    lane, leg: Static, tick, down, com, state: Rows, const: Rows, gait: Rows, work: Rows
):
    """While a foot is on the ground: keep the latest values and the peaks of the stance."""
    latch(gait.com_last[leg], lane, down, com)
    latch(gait.hip_x_last[leg], lane, down, state.q[0, lane])
    latch(gait.tick_last[leg], lane, down, tick)
    add(gait.trunk_sum[leg], lane, down, state.q[2, lane])
    # Filtered forces over the weight of the HAT, turned into body weights.
    to_body_weights = const.hat_weight[lane] / body_weight(lane, const)
    load = state.load_filter[leg, lane] + (
        const.leg_weight[leg, lane] / const.hat_weight[lane]
    )
    push = state.push_filter[leg, lane] * to_body_weights
    knee = work.joint[3 * leg + 1, lane]
    raise_to(gait.vertical_peak[leg], lane, down, load * to_body_weights)
    raise_to(gait.braking_peak[leg], lane, down, 0.0 - push)
    raise_to(gait.propulsion_peak[leg], lane, down, push)
    raise_to(gait.knee_peak_stance[leg], lane, down, knee)


@ti.func
def follow_torques(lane, gait: Rows, work: Rows):
    """Peaks of the joint torques, before stops add theirs. Who has fallen is scored no more."""
    for joint in ti.static(range(3 * LEGS)):
        torque = work.joint_torque[joint, lane]
        size = larger(torque, 0.0 - torque)
        gait.torque_peak[joint, lane] = larger(gait.torque_peak[joint, lane], size)


@ti.func
def raise_to(row: Rows, lane, condition, value):
    """Keep the larger of a row and `value` where `condition` holds."""
    latch(row, lane, condition, larger(row[lane], value))


@ti.func
def body_weight(lane, const: Rows):
    """Weight of the whole body, N."""
    return (
        const.hat_weight[lane] + const.leg_weight[0, lane] + const.leg_weight[1, lane]
    )


@ti.func
def count_strike(lane, leg: Static, strike, tick, gait: Rows, sums: Rows, work: Rows):
    """Length and duration of the step that this strike ends.

    The length is from the other ankle forwards to that of the foot that strikes. The
    other has rolled over its ball, so people's length, from strike to strike of the
    heels (speed over step rate), is larger: by 5 cm in the published gait.
    """
    length = work.ankle_x[leg, lane] - work.ankle_x[1 - leg, lane]
    add(sums.strikes, lane, strike, 1.0)
    add_with_square(sums.step_length, lane, strike, length)
    before = gait.last_strike_tick[lane]
    timed = strike & (before >= 0.0)
    duration = (tick - before) * (1.0 / TICKS_PER_SECOND)
    add(sums.step_durations, lane, timed, 1.0)
    add_with_square(sums.step_duration, lane, timed, duration)
    if ti.static(leg == 0):
        add(sums.left_strikes, lane, strike, 1.0)
        add(sums.left_step_length, lane, strike, length)
        add(sums.left_step_durations, lane, timed, 1.0)
        add(sums.left_step_duration, lane, timed, duration)
    latch(gait.last_strike_tick, lane, strike, tick)


@ti.func
def score_step(lane, leg: Static, scored, gait: Rows, sums: Rows):
    """M1..M5 of a finished step, and its peaks, added to the walker's sums."""
    swing_peak = gait.knee_peak_swing[leg, lane]
    m1 = (swing_peak > KNEE_FLEXION_LOW_RAD) & (swing_peak < KNEE_FLEXION_HIGH_RAD)
    strike = gait.ankle_strike[leg, lane]
    takeoff = gait.ankle_last[leg, lane]
    m2 = (strike < 0.0) & (takeoff > 0.0)
    middle = gait.com_mid[leg, lane]
    m3 = (
        (gait.past_middle[leg, lane] > 0.5)
        & (gait.com_strike[leg, lane] < middle)
        & (gait.com_last[leg, lane] < middle)
    )
    m4 = gait.trunk_sum[leg, lane] > 0.0
    ticks = larger(gait.tick_last[leg, lane] - gait.tick_strike[leg, lane], 1.0)
    progress = gait.hip_x_last[leg, lane] - gait.hip_x_strike[leg, lane]
    difference = progress * TICKS_PER_SECOND / ticks - HUMAN_SPEED_MPS
    deviation = larger(difference, 0.0 - difference)
    add(sums.steps, lane, scored, 1.0)
    add(sums.m1, lane, scored & m1, 1.0)
    add(sums.m2, lane, scored & m2, 1.0)
    add(sums.m3, lane, scored & m3, 1.0)
    add(sums.m4, lane, scored & m4, 1.0)
    for total, value in ti.static(
        (
            (sums.m5, deviation),
            (sums.m5_corrected, larger(1.0 - deviation, 0.0)),
            (sums.knee_peak_swing, swing_peak),
            (sums.knee_peak_stance, gait.knee_peak_stance[leg, lane]),
            (sums.ankle_strike, strike),
            (sums.ankle_takeoff, takeoff),
            (sums.vertical_peak, gait.vertical_peak[leg, lane]),
            (sums.braking_peak, gait.braking_peak[leg, lane]),
            (sums.propulsion_peak, gait.propulsion_peak[leg, lane]),
            (sums.hip_torque_peak, gait.torque_peak[3 * leg, lane]),
            (sums.knee_torque_peak, gait.torque_peak[3 * leg + 1, lane]),
            (sums.ankle_torque_peak, gait.torque_peak[3 * leg + 2, lane]),
        )
    ):
        add(total, lane, scored, value)


@ti.func
def add_up_posture(lane, state: Rows, muscle: Rows, sums: Rows, work: Rows):
    """Sums over time of a walker that is up: trunk, hip height and speed, support, activations."""
    up = state.active[lane] > 0.5
    left = on_ground(lane, 0, state)
    right = on_ground(lane, 1, state)
    add(sums.ticks, lane, up, 1.0)
    add_with_square(sums.trunk, lane, up, state.q[2, lane])
    height = state.q[1, lane] - work.ground_hip[lane]
    add_with_square(sums.hip_height, lane, up, height)
    add_with_square(sums.hip_speed, lane, up, state.qdot[0, lane])
    add(sums.double_support, lane, up, left * right)
    add(sums.flight, lane, up, (1.0 - left) * (1.0 - right))
    squared = 0.0
    cubed = 0.0
    for m in ti.static(range(MUSCLES_PER_LEG)):
        a = muscle.activation[m, lane]
        b = muscle.activation[MUSCLES_PER_LEG + m, lane]
        add(sums.activation[m], lane, up, 0.5 * (a + b))
        squared += a * a + b * b
        cubed += a * a * a + b * b * b
    add(sums.activation_squared, lane, up, squared * (1.0 / MUSCLE_COUNT))
    add(sums.activation_cubed, lane, up, cubed * (1.0 / MUSCLE_COUNT))


@ti.func
def add_up_motors(lane, state: Rows, sums: Rows, work: Rows):
    """Positive work of ideal torques and exoskeleton at each joint by itself, in the last tick."""
    up = state.active[lane] > 0.5
    power_w = 0.0
    for leg in ti.static(range(LEGS)):
        for joint in ti.static(range(3)):
            torque = state.device_torque[3 * leg + joint, lane]
            if ti.static(joint == 0):
                torque += state.hip_torque[leg, lane]
            if ti.static(joint == 1):
                torque += state.knee_torque[leg, lane]
            power_w += larger(torque * work.joint_rate[3 * leg + joint, lane], 0.0)
    add(sums.motor_energy, lane, up, power_w * (1.0 / TICKS_PER_SECOND))


@ti.func
def add_up_forces(lane, step_s, state: Rows, sums: Rows, work: Rows):
    """Impulses of the ground and metabolic energy over one physics step."""
    up = state.active[lane] > 0.5
    power_w = 0.0
    for m in ti.static(range(MUSCLE_COUNT)):
        power_w += work.metabolic_power[m, lane]
    add(sums.metabolic_energy, lane, up, step_s * power_w)
    for i in ti.static(range(2 * LEGS)):
        add(
            sums.impulse[i],
            lane,
            up,
            step_s * state.ground_force[i, lane],
        )
