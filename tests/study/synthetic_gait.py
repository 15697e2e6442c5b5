"""A walk that was never simulated: the published human joint curves, played left and right."""

import numpy as np

from study.pictures.gait_cycle import PANELS
from study.pictures.stick_figure import leg
from taichi_nmm.result import EVENT_DTYPE, Trajectory

STRIDE_S = 1.1
SPEED_MPS = 1.3
TRUNK_RAD = 0.09
TAKE_OFF_PERCENT = 60.0
BODY_WEIGHT_N = 785.0
NOTHING = {
    "muscle_force_n": 14,
    "joint_torque_nm": 6,
    "swing_torque_nm": 4,
    "device_torque_nm": 6,
    "push_n": 1,
    "fibre_velocity_mps": 14,
    "delayed": 22,
}


def walk(duration_s=8.0, rate_hz=100.0):
    """Left heel strikes at 0, STRIDE_S, 2 STRIDE_S, ...; the right leg is half a stride later."""
    time_s = np.arange(1, round(duration_s * rate_hz) + 1) / rate_hz
    percents = [100.0 * ((time_s / STRIDE_S + shift) % 1.0) for shift in (0.0, 0.5)]
    legs = [_leg_angles(percent) for percent in percents]
    trunk = np.full_like(time_s, TRUNK_RAD)
    q = np.column_stack([SPEED_MPS * time_s, 0.0 * time_s, trunk, *legs[0], *legs[1]])
    lowest = [
        np.minimum(leg(q, side).heel, leg(q, side).ball)[:, 1] for side in range(2)
    ]
    q[:, 1] = -np.minimum(*lowest)
    stance = np.column_stack([percent < TAKE_OFF_PERCENT for percent in percents])
    joints = [(hip - TRUNK_RAD, knee - hip, foot - knee) for hip, knee, foot in legs]
    return Trajectory(
        walker=0,
        time_s=time_s,
        q=q,
        qdot=np.gradient(q, time_s, axis=0),
        joint_rad=np.column_stack([*joints[0], *joints[1]]),
        activation=np.column_stack([_activations(percent) for percent in percents]),
        ground_force_n=np.column_stack([_force(percent) for percent in percents]),
        fibre_length_m=np.full((len(time_s), 14), 0.05),
        stance=stance,
        events=_events(duration_s),
        prosthesis=np.zeros(2, dtype=bool),
        push=np.zeros(3),
        slip=np.zeros(3),
        **{name: np.zeros((len(time_s), count)) for name, count in NOTHING.items()},
    )


def _leg_angles(percent):
    """Absolute angles of thigh, shank and foot."""
    hip = np.deg2rad(PANELS["hip_flexion_deg"].at(percent)[0])
    knee = np.deg2rad(PANELS["knee_flexion_deg"].at(percent)[0])
    ankle = np.deg2rad(PANELS["dorsiflexion_deg"].at(percent)[0])
    thigh = TRUNK_RAD - hip
    return thigh, thigh + knee, thigh + knee - ankle


def _activations(percent):
    """Seven bumps, one after the other."""
    peaks = 100.0 * np.arange(7) / 7.0
    return np.exp(-(((percent[:, None] - peaks) / 12.0) ** 2))


def _force(percent):
    forward = PANELS["forward_bw"].at(percent)[0]
    up = PANELS["vertical_bw"].at(percent)[0]
    return BODY_WEIGHT_N * np.column_stack([forward, up])


def _events(duration_s):
    events = []
    for side, shift in enumerate((0.0, 0.5)):
        for stride in range(-1, round(duration_s / STRIDE_S) + 1):
            strike = (stride - shift) * STRIDE_S
            events += [
                (strike, side, 0),
                (strike + STRIDE_S * TAKE_OFF_PERCENT / 100.0, side, 1),
            ]
    inside = [event for event in events if 0.0 < event[0] <= duration_s]
    return np.sort(np.array(inside, dtype=EVENT_DTYPE), order="time_s")


WALK, GLIMPSE = walk(), walk(0.3)  # the second is too short for a stride
