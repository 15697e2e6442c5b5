"""Steps and their score: the determinants of gait M1..M5 of Antonova et al. 2016, in the kernel.

A step is swing -> strike -> stance -> take-off of one leg, scored at its committed
take-off. Contact is debounced: a foot takes off when contact has been lost for 0.1 s,
and strikes when it comes down after at least as long. A swing that began before the
simulation is not observed whole: neither the left leg's first stance nor the right
leg's first swing makes a step.
"""

import math

from taichi_nmm.kernel.backend import Rows, ti
from taichi_nmm.kernel.contact import ground_at_ankle, on_ground
from taichi_nmm.kernel.elementary import larger
from taichi_nmm.kernel.layout import (
    LEGS,
    MUSCLE_COUNT,
    MUSCLES_PER_LEG,
    Const,
    Gait,
    Muscle,
    State,
    Sums,
    Work,
)
from taichi_nmm.result import HUMAN_SPEED_MPS

DEBOUNCE_TICKS = 100.0  # 0.1 s
KNEE_FLEXION_LOW_RAD = math.radians(35.0)
KNEE_FLEXION_HIGH_RAD = math.radians(95.0)
TICKS_PER_SECOND = 1000.0


@ti.func
def latch(gait: Rows, row, lane, condition, value):
    """Remember `value` in a row of `gait` where `condition` holds."""
    gait[row, lane] = ti.select(condition, value, gait[row, lane])


@ti.func
def add(sums: Rows, row, lane, condition, value):
    """Add `value` where `condition` holds. Not by a factor of 0 or 1: 0 times NaN is NaN."""
    sums[row, lane] += ti.select(condition, value, 0.0)


@ti.func
def notice(lane, leg: Rows, state: Rows, gait: Rows, work: Rows):
    """Whether a leg strikes the ground at this tick, or its take-off is sure."""
    alive = state[State.active, lane] > 0.5
    down = alive & (on_ground(lane, leg, state) > 0.5)
    was_standing = gait[Gait.in_stance + leg, lane] > 0.5
    rested = gait[Gait.air_ticks + leg, lane] >= DEBOUNCE_TICKS
    strike = down & rested & (was_standing == False)  # noqa: E712
    takeoff = alive & was_standing & rested & (down == False)  # noqa: E712
    work[Work.strike + leg, lane] = ti.select(strike, 1.0, 0.0)
    work[Work.takeoff + leg, lane] = ti.select(takeoff, 1.0, 0.0)
    if ti.static(leg == 0):
        work[Work.event, lane] = 0.0
    latch(work, Work.event, lane, strike | takeoff, 1.0)


@ti.func
def note_events(lane, leg: Rows, tick, state: Rows, gait: Rows, sums: Rows, work: Rows):
    """Score the step of a leg that has left the ground, and begin the stance of one that strikes.

    Of what both legs share it changes the tick of the last strike alone.
    """
    strike, takeoff = (
        work[Work.strike + leg, lane] > 0.5,
        work[Work.takeoff + leg, lane] > 0.5,
    )
    score_step(lane, leg, takeoff & (gait[Gait.struck + leg, lane] > 0.5), gait, sums)
    latch(
        gait, Gait.tick_takeoff + leg, lane, takeoff, gait[Gait.tick_last + leg, lane]
    )
    for joint in ti.static(range(3)):
        latch(gait, Gait.torque_peak + 3 * leg + joint, lane, takeoff, 0.0)

    count_strike(lane, leg, strike, tick, gait, sums, work)
    took_off = ti.select(gait[Gait.tick_takeoff + leg, lane] > 0.0, 1.0, 0.0)
    com = work[Work.com_z, lane] - ground_at_ankle(lane, leg, work)
    latch(gait, Gait.struck + leg, lane, strike, took_off)
    latch(
        gait, Gait.knee_peak_swing + leg, lane, strike, gait[Gait.knee_peak + leg, lane]
    )
    latch(
        gait,
        Gait.ankle_strike + leg,
        lane,
        strike,
        work[Work.joint + 3 * leg + 2, lane],
    )
    latch(gait, Gait.com_strike + leg, lane, strike, com)
    latch(gait, Gait.com_mid + leg, lane, strike, 0.0)
    latch(gait, Gait.past_middle + leg, lane, strike, 0.0)
    latch(gait, Gait.hip_x_strike + leg, lane, strike, state[State.q + 0, lane])
    latch(gait, Gait.tick_strike + leg, lane, strike, tick)
    for row in ti.static(
        (
            Gait.trunk_sum,
            Gait.knee_peak_stance,
            Gait.vertical_peak,
            Gait.braking_peak,
            Gait.propulsion_peak,
        )
    ):
        latch(gait, row + leg, lane, strike, 0.0)
    latch(gait, Gait.in_stance + leg, lane, takeoff, 0.0)
    latch(gait, Gait.in_stance + leg, lane, strike, 1.0)


@ti.func
def follow_leg(lane, leg: Rows, tick, state: Rows, const: Rows, gait: Rows, work: Rows):
    """Mid-stance, peaks and latest values of one leg."""
    alive = state[State.active, lane] > 0.5
    down = alive & (on_ground(lane, leg, state) > 0.5)
    knee = work[Work.joint + 3 * leg + 1, lane]
    com = work[Work.com_z, lane] - ground_at_ankle(lane, leg, work)
    middle = (
        alive
        & (gait[Gait.in_stance + leg, lane] > 0.5)
        & (gait[Gait.past_middle + leg, lane] < 0.5)
        & (state[State.q + 0, lane] >= work[Work.ankle_x + leg, lane])
    )
    latch(gait, Gait.com_mid + leg, lane, middle, com)
    latch(gait, Gait.past_middle + leg, lane, middle, 1.0)
    follow_contact(lane, leg, tick, down, com, state, const, gait, work)
    highest = larger(gait[Gait.knee_peak + leg, lane], knee)
    gait[Gait.knee_peak + leg, lane] = ti.select(down, knee, highest)
    latch(gait, Gait.ankle_last + leg, lane, down, work[Work.joint + 3 * leg + 2, lane])
    air = ti.select(down, 0.0, gait[Gait.air_ticks + leg, lane] + 1.0)
    latch(gait, Gait.air_ticks + leg, lane, alive, air)


@ti.func
def follow_contact(
    lane, leg: Rows, tick, down, com, state: Rows, const: Rows, gait: Rows, work: Rows
):
    """While a foot is on the ground: keep the latest values and the peaks of the stance."""
    latch(gait, Gait.com_last + leg, lane, down, com)
    latch(gait, Gait.hip_x_last + leg, lane, down, state[State.q + 0, lane])
    latch(gait, Gait.tick_last + leg, lane, down, tick)
    add(gait, Gait.trunk_sum + leg, lane, down, state[State.q + 2, lane])
    # Filtered forces over the weight of the HAT, turned into body weights.
    to_body_weights = const[Const.hat_weight, lane] / body_weight(lane, const)
    load = state[State.load_filter + leg, lane] + (
        const[Const.leg_weight + leg, lane] / const[Const.hat_weight, lane]
    )
    push = state[State.push_filter + leg, lane] * to_body_weights
    knee = work[Work.joint + 3 * leg + 1, lane]
    raise_to(gait, Gait.vertical_peak + leg, lane, down, load * to_body_weights)
    raise_to(gait, Gait.braking_peak + leg, lane, down, 0.0 - push)
    raise_to(gait, Gait.propulsion_peak + leg, lane, down, push)
    raise_to(gait, Gait.knee_peak_stance + leg, lane, down, knee)


@ti.func
def follow_torques(lane, gait: Rows, work: Rows):
    """Peaks of the joint torques, before stops add theirs. Who has fallen is scored no more."""
    for joint in ti.static(range(3 * LEGS)):
        torque, row = (
            work[Work.joint_torque + joint, lane],
            ti.static(Gait.torque_peak + joint),
        )
        gait[row, lane] = larger(gait[row, lane], larger(torque, 0.0 - torque))


@ti.func
def raise_to(gait: Rows, row, lane, condition, value):
    """Keep the larger of a row and `value` where `condition` holds."""
    latch(gait, row, lane, condition, larger(gait[row, lane], value))


@ti.func
def body_weight(lane, const: Rows):
    """Weight of the whole body, N."""
    return (
        const[Const.hat_weight, lane]
        + const[Const.leg_weight + 0, lane]
        + const[Const.leg_weight + 1, lane]
    )


@ti.func
def count_strike(lane, leg: Rows, strike, tick, gait: Rows, sums: Rows, work: Rows):
    """Length and duration of the step that this strike ends."""
    length = work[Work.ankle_x + leg, lane] - work[Work.ankle_x + 1 - leg, lane]
    add(sums, Sums.strikes, lane, strike, 1.0)
    add(sums, Sums.step_length, lane, strike, length)
    add(sums, Sums.step_length_squared, lane, strike, length * length)
    before = gait[Gait.last_strike_tick, lane]
    timed = strike & (before >= 0.0)
    duration = (tick - before) * (1.0 / TICKS_PER_SECOND)
    add(sums, Sums.step_durations, lane, timed, 1.0)
    add(sums, Sums.step_duration, lane, timed, duration)
    add(sums, Sums.step_duration_squared, lane, timed, duration * duration)
    if ti.static(leg == 0):
        add(sums, Sums.left_strikes, lane, strike, 1.0)
        add(sums, Sums.left_step_length, lane, strike, length)
        add(sums, Sums.left_step_durations, lane, timed, 1.0)
        add(sums, Sums.left_step_duration, lane, timed, duration)
    latch(gait, Gait.last_strike_tick, lane, strike, tick)


@ti.func
def score_step(lane, leg: Rows, scored, gait: Rows, sums: Rows):
    """M1..M5 of a finished step, added to the walker's sums."""
    swing_peak = gait[Gait.knee_peak_swing + leg, lane]
    m1 = (swing_peak > KNEE_FLEXION_LOW_RAD) & (swing_peak < KNEE_FLEXION_HIGH_RAD)
    strike, takeoff = (
        gait[Gait.ankle_strike + leg, lane],
        gait[Gait.ankle_last + leg, lane],
    )
    m2 = (strike < 0.0) & (takeoff > 0.0)
    middle = gait[Gait.com_mid + leg, lane]
    m3 = (
        (gait[Gait.past_middle + leg, lane] > 0.5)
        & (gait[Gait.com_strike + leg, lane] < middle)
        & (gait[Gait.com_last + leg, lane] < middle)
    )
    m4 = gait[Gait.trunk_sum + leg, lane] > 0.0
    ticks = larger(
        gait[Gait.tick_last + leg, lane] - gait[Gait.tick_strike + leg, lane], 1.0
    )
    progress = gait[Gait.hip_x_last + leg, lane] - gait[Gait.hip_x_strike + leg, lane]
    difference = progress * TICKS_PER_SECOND / ticks - HUMAN_SPEED_MPS
    deviation = larger(difference, 0.0 - difference)
    add(sums, Sums.steps, lane, scored, 1.0)
    add(sums, Sums.m1, lane, scored & m1, 1.0)
    add(sums, Sums.m2, lane, scored & m2, 1.0)
    add(sums, Sums.m3, lane, scored & m3, 1.0)
    add(sums, Sums.m4, lane, scored & m4, 1.0)
    add(sums, Sums.m5, lane, scored, deviation)
    add(sums, Sums.m5_corrected, lane, scored, larger(1.0 - deviation, 0.0))
    add(sums, Sums.knee_peak_swing, lane, scored, swing_peak)
    add(
        sums,
        Sums.knee_peak_stance,
        lane,
        scored,
        gait[Gait.knee_peak_stance + leg, lane],
    )
    add(sums, Sums.ankle_strike, lane, scored, strike)
    add(sums, Sums.ankle_takeoff, lane, scored, takeoff)
    add(sums, Sums.vertical_peak, lane, scored, gait[Gait.vertical_peak + leg, lane])
    add(sums, Sums.braking_peak, lane, scored, gait[Gait.braking_peak + leg, lane])
    add(
        sums, Sums.propulsion_peak, lane, scored, gait[Gait.propulsion_peak + leg, lane]
    )
    for joint in ti.static(range(3)):
        peak = gait[Gait.torque_peak + 3 * leg + joint, lane]
        add(sums, Sums.hip_torque_peak + joint, lane, scored, peak)


@ti.func
def add_up_posture(lane, state: Rows, muscle: Rows, sums: Rows, work: Rows):
    """Sums over time of a walker that is up: trunk, hip height and speed, support, activations."""
    up = state[State.active, lane] > 0.5
    trunk, speed = state[State.q + 2, lane], state[State.qdot + 0, lane]
    height = state[State.q + 1, lane] - work[Work.ground_hip, lane]
    left, right = on_ground(lane, 0, state), on_ground(lane, 1, state)
    add(sums, Sums.ticks, lane, up, 1.0)
    add(sums, Sums.trunk, lane, up, trunk)
    add(sums, Sums.trunk_squared, lane, up, trunk * trunk)
    add(sums, Sums.hip_height, lane, up, height)
    add(sums, Sums.hip_height_squared, lane, up, height * height)
    add(sums, Sums.hip_speed, lane, up, speed)
    add(sums, Sums.hip_speed_squared, lane, up, speed * speed)
    add(sums, Sums.double_support, lane, up, left * right)
    add(sums, Sums.flight, lane, up, (1.0 - left) * (1.0 - right))
    squared, cubed = 0.0, 0.0
    for m in ti.static(range(MUSCLES_PER_LEG)):
        a = muscle[Muscle.activation + m, lane]
        b = muscle[Muscle.activation + MUSCLES_PER_LEG + m, lane]
        add(sums, Sums.activation + m, lane, up, 0.5 * (a + b))
        squared += a * a + b * b
        cubed += a * a * a + b * b * b
    add(sums, Sums.activation_squared, lane, up, squared * (1.0 / MUSCLE_COUNT))
    add(sums, Sums.activation_cubed, lane, up, cubed * (1.0 / MUSCLE_COUNT))


@ti.func
def add_up_motors(lane, state: Rows, sums: Rows, work: Rows):
    """Positive work of ideal torques and exoskeleton at each joint by itself, in the last tick."""
    up, power_w = state[State.active, lane] > 0.5, 0.0
    for leg in ti.static(range(LEGS)):
        for joint in ti.static(range(3)):
            torque = state[State.device_torque + 3 * leg + joint, lane]
            if ti.static(joint < 2):
                torque += state[
                    ti.static((State.hip_torque, State.knee_torque)[joint]) + leg, lane
                ]
            power_w += larger(
                torque * work[Work.joint_rate + 3 * leg + joint, lane], 0.0
            )
    add(sums, Sums.motor_energy, lane, up, power_w * (1.0 / TICKS_PER_SECOND))


@ti.func
def add_up_forces(lane, step_s, state: Rows, sums: Rows, work: Rows):
    """Impulses of the ground and metabolic energy over one physics step."""
    up = state[State.active, lane] > 0.5
    power_w = 0.0
    for m in ti.static(range(MUSCLE_COUNT)):
        power_w += work[Work.metabolic_power + m, lane]
    add(sums, Sums.metabolic_energy, lane, up, step_s * power_w)
    for i in ti.static(range(2 * LEGS)):
        add(
            sums,
            Sums.impulse + i,
            lane,
            up,
            step_s * state[State.ground_force + i, lane],
        )
