"""Swing-leg placement: hip and knee torques that fold the leg, swing it, stop it and put it down.

Source: Desai & Geyer 2012, 2013, as in the walker T. Legs' phases FLEX, HOLD, STOP,
EXTEND. Angles and rates of the leg are present ones; only the stance flags are delayed.
"""

import math

from taichi_nmm.kernel.backend import Rows, Static, ti
from taichi_nmm.kernel.elementary import larger, smaller
from taichi_nmm.kernel.layout import LEGS

FLEX, HOLD, STOP, EXTEND = 0.0, 1.0, 2.0, 3.0

THRESHOLD_RAD = math.radians(8.0)  # how long before its target the leg is stopped
LARGEST_LEG_RATE_RADPS = 10.0
LANDING_LENGTH_M = 1.0
RATE_FREE_TICKS = 100.0  # the filtered leg rate is taken as zero for the first 0.1 s


@ti.func
def leg_rates(lane, tick, state: Rows, const: Rows, work: Rows):
    """Rate of the leg angle through a first-order filter, w (alpha - y) with y' = w (alpha - y)."""
    settled = ti.select(tick > RATE_FREE_TICKS, 1.0, 0.0)
    for leg in ti.static(range(LEGS)):
        lag = work.leg_angle[leg, lane] - state.leg_angle_filter[leg, lane]
        work.leg_angle_rate[leg, lane] = settled * const.w_filter[lane] * lag
        state.leg_angle_filter[leg, lane] += const.leg_angle_blend[lane] * lag


@ti.func
def next_phase(phase, stance, other_stance, length, clearance, angle, threshold, rate):
    """The phase that follows `phase` at this tick, by at most one transition; FLEX in stance."""
    clears = (phase == FLEX) & (length < clearance) & (other_stance > 0.5)
    near = (phase == HOLD) & (angle < threshold)
    turned = (phase == STOP) & (rate >= 0.0)
    moved = ti.select(
        clears, HOLD, ti.select(near, STOP, ti.select(turned, EXTEND, phase))
    )
    return ti.select(stance > 0.5, FLEX, moved)


@ti.func
def hold_torque(knee_rate, leg_rate, error, k_hold_1, k_hold_2):
    """Knee torque that keeps the folded leg folded, `error` = leg angle less its target."""
    extending = larger(0.0 - k_hold_2 * knee_rate * error * (leg_rate - knee_rate), 0.0)
    extending = ti.select(knee_rate < leg_rate, extending, 0.0)
    return ti.select(knee_rate >= 0.0, 0.0 - k_hold_1 * knee_rate, extending)


@ti.func
def place_legs(lane, state: Rows, const: Rows, work: Rows):
    """Ideal hip and knee torques of both legs, weighted by their share of swing control."""
    left_hip, left_knee = swing_torques(lane, 0, state, const, work)
    right_hip, right_knee = swing_torques(lane, 1, state, const, work)
    left_weight = state.stance_weight[0, lane]
    right_weight = state.stance_weight[1, lane]
    # The stance hip carries the reaction of a leg in the air, so that the trunk does
    # not.
    stance = work.sensed.stance
    left_carries = ti.select(stance[1, lane] > 0.5, 0.0, 0.0 - right_hip)
    right_carries = ti.select(stance[0, lane] > 0.5, 0.0, 0.0 - left_hip)
    state.hip_torque[0, lane] = (
        left_weight * left_carries + (1.0 - left_weight) * left_hip
    )
    state.hip_torque[1, lane] = (
        right_weight * right_carries + (1.0 - right_weight) * right_hip
    )
    state.knee_torque[0, lane] = (1.0 - left_weight) * left_knee
    state.knee_torque[1, lane] = (1.0 - right_weight) * right_knee


@ti.func
def swing_torques(lane, leg: Static, state: Rows, const: Rows, work: Rows):
    """Ideal hip and knee torque of one leg in swing; moves its phase on."""
    stance = work.sensed.stance
    angle, rate = (
        work.leg_angle[leg, lane],
        work.leg_angle_rate[leg, lane],
    )
    length = work.leg_length[leg, lane]
    ahead = work.com_x[lane] - work.ankle_x[1 - leg, lane]
    target = (
        const.alpha_0[leg, lane]
        - const.C_d[leg, lane] * ahead
        - const.C_v[leg, lane] * work.com_speed[lane]
    )
    threshold = target + THRESHOLD_RAD
    phase = next_phase(
        state.swing_phase[leg, lane],
        stance[leg, lane],
        stance[1 - leg, lane],
        length,
        const.l_clr[leg, lane],
        angle,
        threshold,
        rate,
    )
    state.swing_phase[leg, lane] = phase
    near = (angle < threshold) & (rate < LARGEST_LEG_RATE_RADPS)
    braking = (
        const.k_stop[lane] * (threshold - angle) * (1.0 - rate / LARGEST_LEG_RATE_RADPS)
    )
    stop = ti.select(near, braking, 0.0)
    stop -= ti.select(
        phase == EXTEND, const.k_ext[lane] * (LANDING_LENGTH_M - length), 0.0
    )
    stop = ti.select(phase >= STOP, stop, 0.0)
    knee_rate = work.joint_rate[3 * leg + 1, lane]
    hold = hold_torque(
        knee_rate,
        rate,
        angle - target,
        const.k_hold_1[lane],
        const.k_hold_2[lane],
    )
    flex = 0.0 - const.k_flex[lane] * smaller(rate, 0.0)
    hip = (
        const.Kp_swing[leg, lane] * (target - angle)
        - const.Kd_swing[leg, lane] * rate
        + 2.0 * stop
    )
    knee = ti.select(phase == FLEX, flex, hold + stop)
    return hip, knee
