"""`simulate`: a batch of walkers from gains, bodies and terrains to results.

The host's loop: launch a chunk of control ticks, drain the sums, drop the walkers that have ended,
report, repeat. Between chunks a run can be interrupted; no result depends on who else is in the
batch, on its order, on the chunks or on the number of threads.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taichi_nmm import backend
from taichi_nmm.batch import FIRST_SUM, WALKER_ROWS, advance
from taichi_nmm.body import Bodies
from taichi_nmm.constants import constant_rows
from taichi_nmm.errors import InputError
from taichi_nmm.initial import initial_rows
from taichi_nmm.muscle import ACTIVATION_TIME_S, muscle_table
from taichi_nmm.outcome import result_rows
from taichi_nmm.packs import Packs
from taichi_nmm.parameters import LOW_LEVEL_GAINS, gain_rows
from taichi_nmm.recorder import Recorder
from taichi_nmm.reflexes import LOAD_FILTER_S
from taichi_nmm.result import Result
from taichi_nmm.settings import CONTROL_TICK_S, Settings
from taichi_nmm.terrain import Terrain, flat

CHUNK_TICKS = 250  # 0.25 s: fallen walkers leave the packs this often
LONGEST_WALK_S = 10_000.0  # ticks stay whole numbers in float32

Progress = Callable[[float, int], None]


@dataclass(frozen=True, eq=False)
class Batch:
    """Checked input: n walkers, each with its gains, body and terrain.

    Attributes:
        gains: [n, 16].
        low_level: [n, 8].
        bodies: n of them.
        terrains: the different grounds.
        terrain_index: each walker's, [n].
    """

    gains: NDArray[np.float64]
    low_level: NDArray[np.float64]
    bodies: Bodies
    terrains: tuple[Terrain, ...]
    terrain_index: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.gains)


def simulate(
    gains: ArrayLike,
    *,
    duration_s: float = 5.0,
    bodies: Bodies | None = None,
    terrains: Terrain | Sequence[Terrain] | None = None,
    terrain_index: ArrayLike | None = None,
    low_level_gains: ArrayLike | None = None,
    settings: Settings | None = None,
    record: Sequence[int] = (),
    record_rate_hz: float = 100.0,
    progress: Progress | None = None,
) -> Result:
    """Simulate a batch of walkers until each falls or `duration_s` is over.

    Args:
        gains: [n, 16] or [16], in the order of `parameters.GAINS`.
        duration_s: how long a walker may walk, in whole control ticks of 1 ms.
        bodies: one for all or n of them; None is the nominal body.
        terrains: one for all, or several; None is flat ground.
        terrain_index: each walker's row of `terrains`, [n]; by default one terrain serves all, and
            n terrains serve a walker each.
        low_level_gains: [n, 8] or [8], in the order of `parameters.LOW_LEVEL_GAINS`.
        settings: precision, step, contact, machine.
        record: rows of the walkers whose `Trajectory` is wanted.
        record_rate_hz: samples a second of the trajectories; a divisor of 1000.
        progress: called between chunks with the simulated time in s and the walkers still up.

    Raises:
        InputError: a shape, a value or an index that cannot be used.
        KeyboardInterrupt: between chunks.
    """
    settings = settings or Settings()
    batch = _check(gains, bodies, terrains, terrain_index, low_level_gains)
    ticks = _ticks(duration_s)
    recorder = Recorder(record, record_rate_hz, len(batch))
    backend.start(settings)
    packs = _pack(batch)
    launch = _launcher(batch, settings)
    tick = 0
    while tick < ticks and packs.walkers.size:
        for part in recorder.parts(tick, min(CHUNK_TICKS, ticks - tick)):
            launch(packs, tick, part)
            tick += part
            recorder.sample(tick, packs)
        packs.drain()
        if progress is not None:
            progress(tick * CONTROL_TICK_S, packs.active)
        packs.compact()
    final, sums = packs.collect()
    rows = result_rows(final, sums, batch.bodies, duration_s)
    return Result(rows, recorder.trajectories(rows), backend.metadata())


def _check(
    gains: ArrayLike,
    bodies: Bodies | None,
    terrains: Terrain | Sequence[Terrain] | None,
    terrain_index: ArrayLike | None,
    low_level_gains: ArrayLike | None,
) -> Batch:
    rows = gain_rows(gains)
    count = len(rows)
    if low_level_gains is None:
        low_level_gains = [parameter.default for parameter in LOW_LEVEL_GAINS]
    low_level = gain_rows(low_level_gains, LOW_LEVEL_GAINS, "low_level_gains")
    if len(low_level) not in (1, count):
        raise InputError("low_level_gains.shape", low_level.shape, f"[{count}, 8] or [8]")
    bodies = bodies or Bodies.nominal()
    if len(bodies) not in (1, count):
        raise InputError("bodies", len(bodies), f"one body, or {count}: one a walker")
    grounds, index = _check_terrains(terrains, terrain_index, count)
    everyone = np.arange(count)
    return Batch(
        rows,
        low_level[everyone % len(low_level)],
        bodies.take(everyone % len(bodies)),
        grounds,
        index,
    )


def _check_terrains(
    terrains: Terrain | Sequence[Terrain] | None, terrain_index: ArrayLike | None, count: int
) -> tuple[tuple[Terrain, ...], NDArray[np.int32]]:
    if terrains is None:
        terrains = flat()
    grounds = (terrains,) if isinstance(terrains, Terrain) else tuple(terrains)
    if not grounds:
        raise InputError("terrains", "none", "at least one terrain")
    if terrain_index is None:
        if len(grounds) not in (1, count):
            allowed = f"one, or {count}: one a walker; else give terrain_index"
            raise InputError("terrains", len(grounds), allowed)
        return grounds, np.arange(count, dtype=np.int32) % np.int32(len(grounds))
    index = np.asarray(terrain_index)
    if index.shape != (count,) or index.dtype.kind not in "iu":
        raise InputError("terrain_index.shape", index.shape, f"[{count}] of whole numbers")
    if count and not (0 <= index.min() and index.max() < len(grounds)):
        raise InputError("terrain_index", int(index.max()), f"0 to {len(grounds) - 1}")
    return grounds, index.astype(np.int32)


def _ticks(duration_s: float) -> int:
    if not CONTROL_TICK_S <= duration_s <= LONGEST_WALK_S:
        raise InputError("duration_s", duration_s, f"{CONTROL_TICK_S} to {LONGEST_WALK_S:g}")
    return round(duration_s / CONTROL_TICK_S)


def _pack(batch: Batch) -> Packs:
    """The walkers at the start."""
    rows = np.zeros((len(batch), WALKER_ROWS))
    starts = np.array([initial_rows(terrain) for terrain in batch.terrains])
    rows[:, :FIRST_SUM] = starts[batch.terrain_index]
    constants = constant_rows(batch.gains, batch.low_level, batch.bodies)
    return Packs(rows, constants, batch.terrain_index, backend.lanes(), backend.real_dtype())


def _launcher(batch: Batch, settings: Settings) -> Callable[[Packs, int, int], None]:
    """The kernel with everything that stays the same from launch to launch."""
    real = backend.real_dtype()
    heights = np.array([terrain.height_m for terrain in batch.terrains], dtype=real)
    muscles = muscle_table().astype(real)
    step_s = settings.physics_step_s
    activation_blend = 1.0 - np.exp(-step_s / ACTIVATION_TIME_S)
    load_blend = 1.0 - np.exp(-step_s / LOAD_FILTER_S)

    def launch(packs: Packs, first_tick: int, ticks: int) -> None:
        advance(
            packs.lanes, packs.rows, packs.constants, packs.terrains, heights, muscles,
            first_tick, ticks, settings.substeps, step_s,
            settings.contact_relaxation_speed_mps, activation_blend, load_blend,
        )  # fmt: skip

    return launch


