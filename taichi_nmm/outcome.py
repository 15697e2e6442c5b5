"""From the kernel's rows to result rows and recorded trajectories."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.inputs import checks
from storage.inputs.errors import InputError
from taichi_nmm.body import GRAVITY_MPS2, Bodies
from taichi_nmm.kernel import joints as stops
from taichi_nmm.kernel.layout import LEGS, RINGS, Ends, State, Sums, WalkerRows
from taichi_nmm.kernel.muscle_table import (
    FMAX_N,
    OPTIMAL_LENGTH_M,
    TORQUES_NM,
    VMAX_PER_S,
)
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
from taichi_nmm.walkers import Batch, ticks_of

Array = NDArray[np.float64]
Part = tuple[NDArray[Any], Array]
"""`layout.Ends`, [k, Ends.count], and summed rows, [k, Sums.count], of k walkers."""

# Of a thread's turn. The nearer caches hold half as many, but the interpreter is one.
ROWS_AT_ONCE, THREADS = 8192, 8
TICKS_PER_SECOND = round(1.0 / CONTROL_TICK_S)


def result_rows(
    parts: Iterable[Part], count: int, bodies: Bodies, duration_s: float
) -> NDArray[np.void]:
    """Result rows of n walkers.

    A quotient over nothing (no step, no distance) is zero.

    Args:
        parts: of all walkers, one after the other; NaN in the sums of a walker that
            diverged counts as 0.
        count: n.
        bodies: n of them, or one of all.
        duration_s: that was asked for.
    """
    rows = np.empty(count, dtype=RESULT_DTYPE)
    mass = np.broadcast_to(bodies.mass_kg.sum(axis=1), count)
    first, filled = 0, []
    with ThreadPoolExecutor(THREADS) as pool:
        for final, sums in parts:
            for start in range(0, len(final), ROWS_AT_ONCE):
                some = slice(start, start + ROWS_AT_ONCE)
                place = slice(first, first + len(final[some]))
                given = rows[place], final[some], sums[some], mass[place], duration_s
                filled.append(pool.submit(_fill, *given))
                first = place.stop
    for each in filled:
        each.result()
    return rows


def _fill(
    rows: NDArray[np.void],
    final: NDArray[Any],
    sums: Array,
    mass: Array,
    duration_s: float,
) -> None:
    """Compute the columns of some rows, of walkers of a mass in kg, [n]."""
    state = Ends.of(final.T)
    # A diverged walker's last numbers may be NaN; finite sums are kept.
    total = Sums.of(np.nan_to_num(sums, nan=0.0, posinf=0.0, neginf=0.0).T)
    rows["end_reason"] = state.end_reason.astype(np.uint8)
    ticks = np.round(state.end_tick.astype(np.float64))
    rows["duration_s"] = ticks * CONTROL_TICK_S
    rows["hip_x_m"] = state.end_x
    rows["hip_z_m"] = state.end_z
    rows["distance_m"] = rows["hip_x_m"]
    rows["mean_speed_mps"] = _quotient(rows["distance_m"], rows["duration_s"])
    work = mass * np.maximum(rows["distance_m"], 0.0)
    rows[OF_MUSCLES] = _quotient(total.metabolic_energy, work)
    rows[ENERGY] = _quotient(total.metabolic_energy + total.motor_energy, work)
    rows["survived_fraction"] = rows["duration_s"] / duration_s
    rows["step_count"] = np.round(total.steps).astype(np.int32)
    for column, name in COLUMNS["sums"].items():
        rows[column] = getattr(total, name)
    for over, columns in COLUMNS["means"].items():
        for column, name in columns.items():
            rows[column] = _quotient(getattr(total, name), getattr(total, over))
    binary = rows["m1_sum"] + rows["m2_sum"] + rows["m3_sum"] + rows["m4_sum"]
    rows["phi_printed"] = binary + rows["m5_sum_mps"]
    rows["phi_corrected"] = binary + rows["m5_corrected_sum"]
    _summary(rows, total, mass * GRAVITY_MPS2)


def _summary(rows: NDArray[np.void], total: Any, weight_n: Array) -> None:
    """The columns of whole walks; `total` are named rows of `Sums`, [row, n]."""
    for name, of in COLUMNS["moments"].items():
        values, squares = getattr(total, name)
        count = getattr(total, of["over"])
        mean = _quotient(values, count)
        variance = _quotient(squares, count) - mean**2
        rows[of["sd"]] = np.sqrt(np.maximum(variance, 0.0))
        if "mean" in of:
            rows[of["mean"]] = mean
    vertical = total.impulse[1] + total.impulse[3]
    rows["grf_vertical_mean_bw"] = _quotient(vertical, weight_n * rows["duration_s"])
    for muscle, activation in zip(MUSCLES, total.activation, strict=True):
        column = f"activation_{muscle.lower()}_mean"
        rows[column] = _quotient(activation, total.ticks)
    rows["step_length_asymmetry"] = _asymmetry(
        total.step_length[0],
        total.strikes,
        left=total.left_step_length,
        left_count=total.left_strikes,
    )
    rows["step_duration_asymmetry"] = _asymmetry(
        total.step_duration[0],
        total.step_durations,
        left=total.left_step_duration,
        left_count=total.left_step_durations,
    )
    deviations = [
        (rows[name] - mean) / sd for name, (mean, sd) in COLUMNS["human"].items()
    ]
    rows["human_deviation"] = np.sqrt(np.mean(np.square(deviations), axis=0))


def _asymmetry(both: Array, count: Array, left: Array, left_count: Array) -> Array:
    """(left - right) / (left + right) of the means, from sums of both legs and of the left."""
    left_mean = _quotient(left, left_count)
    right_mean = _quotient(both - left, count - left_count)
    return _quotient(left_mean - right_mean, left_mean + right_mean)


def _quotient(a: Array, b: Array) -> Array:
    return np.divide(a, b, out=np.zeros(len(a)), where=b > 0)


OPTIMAL_M = np.tile(OPTIMAL_LENGTH_M, LEGS)
FASTEST_PER_S = np.tile(VMAX_PER_S, LEGS)


class Recorder:
    """Cuts chunks of ticks at the sample times, and keeps the rows of chosen walkers there."""

    def __init__(
        self, walkers: Sequence[int], rate_hz: float, batch: Batch, settings: Settings
    ) -> None:
        self.walkers = tuple(checks.row_numbers("record", walkers, len(batch)).tolist())
        self._settings, self._worlds = settings, batch.worlds
        if not 0 < rate_hz <= TICKS_PER_SECOND or TICKS_PER_SECOND % rate_hz:
            raise InputError(
                "record_rate_hz", rate_hz, f"a divisor of {TICKS_PER_SECOND}"
            )
        self._interval = round(TICKS_PER_SECOND / rate_hz)
        self._samples: dict[int, dict[int, Array]] = {
            walker: {} for walker in self.walkers
        }

    def parts(self, tick: int, ticks: int) -> Iterator[int]:
        """Lengths into which a chunk that starts at `tick` is cut."""
        end = tick + ticks
        while tick < end:
            part = end - tick
            if self.walkers:
                part = min(part, self._interval - tick % self._interval)
            yield part
            tick += part

    def sample(self, tick: int, rows_of: Callable[[int], NDArray[Any] | None]) -> None:
        """At a sample time, keep the rows of the recorded walkers that are up."""
        if tick % self._interval:
            return
        for walker, samples in self._samples.items():
            found = rows_of(walker)
            if found is not None and found[State.end_tick] >= tick:
                samples[tick] = found.astype(np.float64)

    def trajectories(self) -> tuple[Trajectory, ...]:
        """The trajectories, in the order of `walkers`."""
        return tuple(map(self._trajectory, self.walkers))

    def _trajectory(self, walker: int) -> Trajectory:
        # Empty for a walker that diverged before the first sample.
        samples = self._samples[walker]
        rows = np.array(list(samples.values())).reshape(-1, WalkerRows.count)
        ticks = np.array(list(samples), dtype=np.int64)
        walk = WalkerRows.of(rows.T)  # [row, t]
        state, fibres = walk.state, walk.fibres
        q = state.q.T
        swing = np.stack([state.hip_torque, state.knee_torque], axis=1)
        world = walker % len(self._worlds)
        optimal_m = OPTIMAL_M * self._worlds.optimal_length[world]
        prosthesis = self._worlds.prosthesis[world]
        return Trajectory(
            walker=walker,
            time_s=ticks.astype(np.float64) * CONTROL_TICK_S,
            q=q,
            qdot=state.qdot.T,
            joint_rad=q[:, 3:] - q[:, [2, 3, 4, 2, 6, 7]],
            activation=fibres.activation.T,
            muscle_force_n=fibres.force.T * np.tile(FMAX_N, LEGS),
            ground_force_n=_mean_forces(walk.sums, self._interval),
            joint_torque_nm=_joint_torques(state, fibres, self._settings, prosthesis),
            swing_torque_nm=swing.reshape(2 * LEGS, -1).T,
            device_torque_nm=state.device_torque.T,
            push_n=_mean_push(self._worlds.push[[world]], ticks, self._interval),
            fibre_length_m=fibres.length.T * optimal_m,
            fibre_velocity_mps=fibres.velocity.T * optimal_m * FASTEST_PER_S,
            delayed=_delayed(walk.delay, ticks),
            stance=state.touching.reshape(LEGS, 2, -1).max(axis=1).T > 0.5,
            events=_events(walk.events),
            prosthesis=prosthesis.any(axis=1),
            push=self._worlds.push[world],
            slip=self._worlds.slip[world],
        )


def _delayed(delay: Any, ticks: NDArray[np.int64]) -> Array:
    """What the next tick takes out of the delay rings after so many ticks, [t, Signal.count]."""
    samples = np.arange(len(ticks))
    found = [
        delay[row + signal * late + ticks % late, samples]
        for _, signals, late, row in RINGS
        for signal in range(signals)
    ]
    return np.stack(found, axis=1)


def _mean_forces(sums: Any, interval: int) -> Array:
    """Forces over each sample interval, from the running impulses (drained at every chunk)."""
    impulse = sums.impulse.T
    before = np.vstack([np.zeros((1, 2 * LEGS)), impulse])[:-1]
    restarted = np.diff(sums.ticks, prepend=0.0) <= 0
    before[restarted] = 0.0
    return np.asarray((impulse - before) / (interval * CONTROL_TICK_S))


def _mean_push(push: Array, ticks: NDArray[np.int64], interval: int) -> Array:
    """Force of a push of `Worlds`, [1, 3], over the intervals before these ticks, [t, 1]."""
    begin, end = ticks_of(push)
    within = np.minimum(ticks, end) - np.maximum(ticks - interval, begin)
    share = np.maximum(within, 0.0) / interval
    return np.asarray((push[0, 2] * share)[:, None])


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


def _joint_torques(
    state: Any, fibres: Any, settings: Settings, prosthesis: Array
) -> Array:
    """Torques of the last physics step, from the pose before it: `kernel.joints`, [t, 6].

    `prosthesis` is the walker's own of `Worlds`, [2, 3].
    """
    links = [[2, 3, 4, 5], [2, 6, 7, 8]]
    step_s = settings.physics_step_s
    rates = state.qdot.T
    angle = np.diff((state.q.T - step_s * rates)[:, links])  # [t, leg, 3]
    rate = np.diff(rates[:, links])
    force = fibres.force.T.reshape(-1, LEGS, len(MUSCLES))
    hip, knee_cosine, knee_sine, ankle_cosine, ankle_sine = np.moveaxis(
        force @ TORQUES_NM, -1, 0
    )
    bent, turned = angle[..., stops.KNEE], angle[..., stops.ANKLE]
    knee = knee_cosine * np.cos(bent) + knee_sine * np.sin(bent)
    ankle = ankle_cosine * np.cos(turned) + ankle_sine * np.sin(turned)
    stiffness, damping, rest_rad = prosthesis.T
    ankle += stiffness * (rest_rad - turned) - damping * rate[..., stops.ANKLE]
    weight = state.stance_weight.T
    hip = weight * hip + state.hip_torque.T
    knee = weight * knee + state.knee_torque.T
    torque = np.stack([hip, knee, ankle], axis=-1)
    torque += state.device_torque.T.reshape(torque.shape)
    if settings.engine == OWN_ENGINE:
        beyond = np.clip(angle, LOWEST_RAD, HIGHEST_RAD) - angle
        stop = beyond - (np.abs(beyond) / YIELD_RADPS + step_s * IMPLICIT) * rate
        torque += stops.STOP_STIFFNESS_NMPRAD * np.where(stop * beyond > 0.0, stop, 0.0)
    return np.asarray(torque.reshape(-1, 3 * LEGS))


def _events(gait: Any) -> NDArray[np.void]:
    """Strikes and take-offs, from the ticks that the legs remember."""
    events = []
    for kind, rows in enumerate((gait.tick_strike, gait.tick_takeoff)):
        for side, remembered in enumerate(rows):
            ticks = np.unique(remembered)
            events += [
                (tick * CONTROL_TICK_S, side, kind) for tick in ticks if tick > 0
            ]
    return np.sort(np.array(events, dtype=EVENT_DTYPE), order="time_s")
