"""From the kernel's rows to result rows and recorded trajectories."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.inputs import checks
from storage.inputs.errors import InputError
from taichi_nmm.body import GRAVITY_MPS2, Bodies
from taichi_nmm.kernel import joints as stops
from taichi_nmm.kernel.layout import (
    COORDINATES,
    FIRST_DELAY,
    FIRST_EVENT,
    FIRST_FIBRE,
    FIRST_SUM,
    LEGS,
    MUSCLE_COUNT,
    RINGS,
    WALKER_ROWS,
    Gait,
    Muscle,
    State,
    Sums,
)
from taichi_nmm.kernel.muscle_table import (
    FMAX_N,
    OPTIMAL_LENGTH_M,
    TORQUES_NM,
    VMAX_PER_S,
)
from taichi_nmm.packs import Packs
from taichi_nmm.result import (
    COLUMNS,
    ENERGY,
    EVENT_DTYPE,
    MUSCLES,
    OF_MUSCLES,
    RESULT_DTYPE,
    Trajectory,
)
from taichi_nmm.settings import CONTROL_TICK_S, OWN_ENGINE, Settings
from taichi_nmm.world import Worlds

Array = NDArray[np.float64]

TICKS_PER_SECOND = round(1.0 / CONTROL_TICK_S)


def result_rows(
    final: NDArray[Any], sums: Array, bodies: Bodies, duration_s: float
) -> NDArray[np.void]:
    """Result rows of n walkers.

    A quotient over nothing (no step, no distance) is zero.

    Args:
        final: state rows, [n, State.count].
        sums: summed rows, [n, Sums.count]; NaN of a walker that diverged counts as 0.
        bodies: n of them.
        duration_s: that was asked for.
    """
    rows = np.zeros(len(final), dtype=RESULT_DTYPE)
    # A diverged walker's last numbers may be NaN; finite sums are kept.
    sums = np.nan_to_num(sums, nan=0.0, posinf=0.0, neginf=0.0)
    rows["end_reason"] = final[:, State.end_reason].astype(np.uint8)
    rows["duration_s"] = (
        np.round(final[:, State.end_tick].astype(np.float64)) * CONTROL_TICK_S
    )
    rows["hip_x_m"] = final[:, State.end_x]
    rows["hip_z_m"] = final[:, State.end_z]
    rows["distance_m"] = rows["hip_x_m"]
    rows["mean_speed_mps"] = _quotient(rows["distance_m"], rows["duration_s"])
    mass = bodies.mass_kg.sum(axis=1)
    work = mass * np.maximum(rows["distance_m"], 0.0)
    energy, motors = sums[:, Sums.metabolic_energy], sums[:, Sums.motor_energy]
    rows[OF_MUSCLES] = _quotient(energy, work)
    rows[ENERGY] = _quotient(energy + motors, work)
    rows["survived_fraction"] = rows["duration_s"] / duration_s
    steps = sums[:, Sums.steps]
    rows["step_count"] = np.round(steps).astype(np.int32)
    for column, name in COLUMNS["sums"].items():
        rows[column] = sums[:, getattr(Sums, name)]
    for column, name in COLUMNS["step_means"].items():
        rows[column] = _quotient(sums[:, getattr(Sums, name)], steps)
    binary = rows["m1_sum"] + rows["m2_sum"] + rows["m3_sum"] + rows["m4_sum"]
    rows["phi_printed"] = binary + rows["m5_sum_mps"]
    rows["phi_corrected"] = binary + rows["m5_corrected_sum"]
    _summary(rows, sums, mass * GRAVITY_MPS2)
    return rows


def _summary(rows: NDArray[np.void], sums: Array, weight_n: Array) -> None:
    ticks = sums[:, Sums.ticks]
    for name, of in COLUMNS["moments"].items():
        row, count = getattr(Sums, name), sums[:, getattr(Sums, of["over"])]
        mean = _quotient(sums[:, row], count)
        square = _quotient(
            sums[:, row + 1], count
        )  # the row after a sum holds its squares
        rows[of["sd"]] = np.sqrt(np.maximum(square - mean**2, 0.0))
        if "mean" in of:
            rows[of["mean"]] = mean
    for column, name in COLUMNS["tick_means"].items():
        rows[column] = _quotient(sums[:, getattr(Sums, name)], ticks)
    vertical = sums[:, Sums.impulse + 1] + sums[:, Sums.impulse + 3]
    rows["grf_vertical_mean_bw"] = _quotient(vertical, weight_n * rows["duration_s"])
    for m, muscle in enumerate(MUSCLES):
        rows[f"activation_{muscle.lower()}_mean"] = _quotient(
            sums[:, Sums.activation + m], ticks
        )
    for name, number in (
        ("step_length", "strikes"),
        ("step_duration", "step_durations"),
    ):
        (total, count), (left, lefts) = (
            (sums[:, getattr(Sums, side + name)], sums[:, getattr(Sums, side + number)])
            for side in ("", "left_")
        )
        left, right = _quotient(left, lefts), _quotient(total - left, count - lefts)
        rows[f"{name}_asymmetry"] = _quotient(left - right, left + right)
    deviations = [
        (rows[name] - mean) / sd for name, (mean, sd) in COLUMNS["human"].items()
    ]
    rows["human_deviation"] = np.sqrt(np.mean(np.square(deviations), axis=0))


def _quotient(a: Array, b: Array) -> Array:
    return np.divide(a, b, out=np.zeros(len(a)), where=b > 0)


OPTIMAL_M, FASTEST_PER_S = np.tile(OPTIMAL_LENGTH_M, LEGS), np.tile(VMAX_PER_S, LEGS)


class Recorder:
    """Cuts chunks of ticks at the sample times, and keeps the rows of chosen walkers there."""

    def __init__(
        self, walkers: Sequence[int], rate_hz: float, worlds: Worlds, settings: Settings
    ) -> None:
        self._walkers = tuple(
            checks.row_numbers("record", walkers, len(worlds)).tolist()
        )
        self._settings, self._worlds = settings, worlds
        if not 0 < rate_hz <= TICKS_PER_SECOND or TICKS_PER_SECOND % rate_hz:
            raise InputError(
                "record_rate_hz", rate_hz, f"a divisor of {TICKS_PER_SECOND}"
            )
        self._interval = round(TICKS_PER_SECOND / rate_hz)
        self._samples: dict[int, dict[int, Array]] = {
            walker: {} for walker in self._walkers
        }

    def parts(self, tick: int, ticks: int) -> Iterator[int]:
        """Lengths into which a chunk that starts at `tick` is cut."""
        end = tick + ticks
        while tick < end:
            part = end - tick
            if self._walkers:
                part = min(part, self._interval - tick % self._interval)
            yield part
            tick += part

    def sample(self, tick: int, packs: Packs) -> None:
        """At a sample time, keep the rows of the recorded walkers that are up."""
        if tick % self._interval:
            return
        for walker, samples in self._samples.items():
            seat = packs.lane_of(walker)
            if seat is None:
                continue
            rows = packs.rows[seat[0], :, seat[1]].astype(np.float64)
            if rows[State.end_tick] >= tick:
                samples[tick] = rows

    def trajectories(self) -> tuple[Trajectory, ...]:
        """The trajectories, in the order of `walkers`."""
        return tuple(map(self._trajectory, self._walkers))

    def _trajectory(self, walker: int) -> Trajectory:
        # Empty for a walker that diverged before the first sample.
        samples = self._samples[walker]
        rows = np.array(list(samples.values())).reshape(-1, WALKER_ROWS)
        q, fibres = rows[:, State.q : State.q + COORDINATES], rows[:, FIRST_FIBRE:]
        touching = rows[:, State.touching : State.touching + 2 * LEGS].reshape(
            -1, LEGS, 2
        )
        activation, length, velocity, force = (
            fibres[:, first : first + MUSCLE_COUNT]
            for first in (
                Muscle.activation,
                Muscle.length,
                Muscle.velocity,
                Muscle.force,
            )
        )
        swing = [
            row + side
            for side in range(LEGS)
            for row in (State.hip_torque, State.knee_torque)
        ]
        optimal_m = OPTIMAL_M * self._worlds.optimal_length[walker]
        return Trajectory(
            walker=walker,
            time_s=np.array(list(samples), dtype=np.float64) * CONTROL_TICK_S,
            q=q,
            qdot=rows[:, State.qdot : State.qdot + COORDINATES],
            joint_rad=q[:, 3:] - q[:, [2, 3, 4, 2, 6, 7]],
            activation=activation,
            muscle_force_n=force * np.tile(FMAX_N, LEGS),
            ground_force_n=_mean_forces(rows, self._interval),
            joint_torque_nm=_joint_torques(
                rows, self._settings, self._worlds.prosthesis[walker]
            ),
            swing_torque_nm=rows[:, swing],
            device_torque_nm=rows[:, State.device_torque :][:, : 3 * LEGS],
            fibre_length_m=length * optimal_m,
            fibre_velocity_mps=velocity * optimal_m * FASTEST_PER_S,
            delayed=_delayed(rows, np.array(list(samples), dtype=np.int64)),
            stance=np.any(touching > 0.5, axis=2),
            events=_events(rows),
        )


def _delayed(rows: Array, ticks: NDArray[np.int64]) -> Array:
    """What the next tick takes out of the delay rings after so many ticks, [t, Signal.count]."""
    slots = [
        FIRST_DELAY + row + signal * delay_ticks + ticks % delay_ticks
        for _, signals, delay_ticks, row in RINGS
        for signal in range(signals)
    ]
    return np.take_along_axis(rows, np.stack(slots, axis=1), axis=1)


def _mean_forces(rows: Array, interval: int) -> Array:
    """Forces over each sample interval, from the running impulses (drained at every chunk)."""
    first = FIRST_SUM + Sums.impulse
    impulse = rows[:, first : first + 2 * LEGS]
    ticks = rows[:, FIRST_SUM + Sums.ticks]
    before = np.vstack([np.zeros((1, 2 * LEGS)), impulse])[:-1]
    restarted = np.diff(ticks, prepend=0.0) <= 0
    before[restarted] = 0.0
    return (impulse - before) / (interval * CONTROL_TICK_S)


# Of hip, knee and ankle: where the stops begin, how fast they give way, which are
# implicit.
LOWEST_RAD = np.array(
    [-np.inf, stops.KNEE_STRAIGHTEST_RAD, stops.ANKLE_DORSIFLEXION_LIMIT_RAD]
)
HIGHEST_RAD = np.array(
    [stops.HIP_EXTENSION_LIMIT_RAD, np.inf, stops.ANKLE_PLANTARFLEXION_LIMIT_RAD]
)
YIELD_RADPS = np.array([stops.HIP_RELAXATION_RADPS, *[stops.STOP_RELAXATION_RADPS] * 2])
IMPLICIT = np.array([0.0, 1.0, 1.0])


def _joint_torques(rows: Array, settings: Settings, prosthesis: Array) -> Array:
    """Torques of the last physics step, from the pose before it: `kernel.joints`, [t, 6].

    `prosthesis` is the walker's own of `Worlds`, [2, 3].
    """
    q, rates = (rows[:, first : first + COORDINATES] for first in (State.q, State.qdot))
    links, step_s = [[2, 3, 4, 5], [2, 6, 7, 8]], settings.physics_step_s
    angle, rate = (
        np.diff(each[:, links]) for each in (q - step_s * rates, rates)
    )  # [t, leg, 3]
    first = FIRST_FIBRE + Muscle.force
    force = rows[:, first : first + MUSCLE_COUNT].reshape(-1, LEGS, len(MUSCLES))
    hip, *rest = np.moveaxis(force @ TORQUES_NM, -1, 0)
    knee, ankle = (
        cosine * np.cos(angle[..., joint]) + sine * np.sin(angle[..., joint])
        for joint, cosine, sine in ((stops.KNEE, *rest[:2]), (stops.ANKLE, *rest[2:]))
    )
    weight, ideal_hip, ideal_knee = (
        rows[:, first : first + LEGS]
        for first in (State.stance_weight, State.hip_torque, State.knee_torque)
    )
    stiffness, damping, rest_rad = prosthesis.T
    ankle += (
        stiffness * (rest_rad - angle[..., stops.ANKLE])
        - damping * rate[..., stops.ANKLE]
    )
    torque = np.stack([weight * hip + ideal_hip, weight * knee + ideal_knee, ankle], -1)
    torque += rows[:, State.device_torque :][:, : 3 * LEGS].reshape(torque.shape)
    if settings.engine == OWN_ENGINE:
        beyond = np.clip(angle, LOWEST_RAD, HIGHEST_RAD) - angle
        stop = beyond - (np.abs(beyond) / YIELD_RADPS + step_s * IMPLICIT) * rate
        torque += stops.STOP_STIFFNESS_NMPRAD * np.where(stop * beyond > 0.0, stop, 0.0)
    return np.asarray(torque.reshape(-1, 3 * LEGS))


def _events(rows: Array) -> NDArray[np.void]:
    """Strikes and take-offs, from the ticks that the legs remember."""
    events = []
    for kind, row in enumerate((Gait.tick_strike, Gait.tick_takeoff)):
        for side in range(LEGS):
            remembered = np.unique(rows[:, FIRST_EVENT + row + side])
            events += [
                (tick * CONTROL_TICK_S, side, kind) for tick in remembered if tick > 0
            ]
    return np.sort(np.array(events, dtype=EVENT_DTYPE), order="time_s")
