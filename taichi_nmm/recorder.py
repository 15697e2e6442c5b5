"""Trajectories of chosen walkers, sampled between launches."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from taichi_nmm import checks
from taichi_nmm.errors import InputError
from taichi_nmm.kernel.layout import (
    COORDINATES,
    FIRST_EVENT,
    FIRST_FIBRE,
    FIRST_SUM,
    LEGS,
    MUSCLE_COUNT,
    WALKER_ROWS,
    Gait,
    Muscle,
    State,
    Sums,
)
from taichi_nmm.kernel.muscle_table import FMAX_N
from taichi_nmm.packs import Packs
from taichi_nmm.result import EVENT_DTYPE, EVENT_KINDS, Trajectory
from taichi_nmm.settings import CONTROL_TICK_S

TICKS_PER_SECOND = round(1.0 / CONTROL_TICK_S)


class Recorder:
    """Cuts the chunks at the sample times and keeps the rows of the walkers asked for."""

    def __init__(self, walkers: Sequence[int], rate_hz: float, count: int) -> None:
        walkers = checks.row_numbers("record", walkers, count).tolist()
        if not 0 < rate_hz <= TICKS_PER_SECOND or TICKS_PER_SECOND % rate_hz:
            raise InputError("record_rate_hz", rate_hz, f"a divisor of {TICKS_PER_SECOND}")
        self._walkers = tuple(walkers)
        self._interval = round(TICKS_PER_SECOND / rate_hz)
        self._samples: dict[int, list[tuple[int, NDArray[np.float64]]]] = {
            walker: [] for walker in self._walkers
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
        """Keep the rows of the recorded walkers when `tick` is a sample time, and their end."""
        for walker in self._walkers:
            seat = packs.lane_of(walker)
            if seat is None:
                continue
            rows = packs.rows[seat[0], :, seat[1]].astype(np.float64)
            last = rows[State.end_tick]
            due = tick % self._interval == 0
            if due and last >= tick:
                self._samples[walker].append((tick, rows))

    def trajectories(self, results: NDArray[np.void]) -> tuple[Trajectory, ...]:
        """The trajectories, in the order in which the walkers were asked for."""
        return tuple(
            _trajectory(walker, self._samples[walker], self._interval) for walker in self._walkers
        )


def _trajectory(
    walker: int, samples: list[tuple[int, NDArray[np.float64]]], interval: int
) -> Trajectory:
    ticks = np.array([tick for tick, _ in samples], dtype=np.float64)
    # Empty for a walker that diverged before the first sample.
    rows = np.array([row for _, row in samples]).reshape(-1, WALKER_ROWS)
    q = rows[:, State.q : State.q + COORDINATES]
    angles = q[:, 2:]
    joints = [
        angles[:, [1, 2, 3]] - angles[:, [0, 1, 2]],
        angles[:, [4, 5, 6]] - angles[:, [0, 4, 5]],
    ]
    fibres = rows[:, FIRST_FIBRE:]
    force = fibres[:, Muscle.force : Muscle.force + MUSCLE_COUNT] * np.tile(FMAX_N, LEGS)
    touching = rows[:, State.touching : State.touching + 2 * LEGS].reshape(-1, LEGS, 2)
    return Trajectory(
        walker=walker,
        time_s=ticks * CONTROL_TICK_S,
        q=q,
        qdot=rows[:, State.qdot : State.qdot + COORDINATES],
        joint_rad=np.concatenate(joints, axis=1),
        activation=fibres[:, Muscle.activation : Muscle.activation + MUSCLE_COUNT],
        muscle_force_n=force,
        ground_force_n=_mean_forces(rows, interval),
        stance=np.any(touching > 0.5, axis=2, keepdims=False),
        events=_events(rows),
    )


def _mean_forces(rows: NDArray[np.float64], interval: int) -> NDArray[np.float64]:
    """Forces over each sample interval, from the running impulses (drained at every chunk)."""
    first = FIRST_SUM + Sums.impulse
    impulse = rows[:, first : first + 2 * LEGS]
    ticks = rows[:, FIRST_SUM + Sums.ticks]
    before = np.vstack([np.zeros((1, 2 * LEGS)), impulse])[:-1]
    restarted = np.diff(ticks, prepend=0.0) <= 0
    before[restarted] = 0.0
    return (impulse - before) / (interval * CONTROL_TICK_S)


def _events(rows: NDArray[np.float64]) -> NDArray[np.void]:
    """Strikes and take-offs, from the ticks that the legs remember."""
    events = []
    for kind, row in enumerate((Gait.tick_strike, Gait.tick_takeoff)):
        for side in range(LEGS):
            remembered = np.unique(rows[:, FIRST_EVENT + row + side])
            events += [(tick * CONTROL_TICK_S, side, kind) for tick in remembered if tick > 0]
    assert len(EVENT_KINDS) == 2
    return np.sort(np.array(events, dtype=EVENT_DTYPE), order="time_s")
