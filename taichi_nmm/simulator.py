"""`simulate`: a batch of walkers from gains, bodies and terrains to results; `forward_dynamics`.

The host's loop: launch a chunk of control ticks, drain the sums, drop the walkers that
have ended, report, repeat; on a GPU walkers queue (`queue`). Between chunks a run can
be interrupted; no result depends on the other walkers of the batch, on its order, on
the chunks or on the number of threads.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from storage.inputs import checks
from storage.inputs.errors import InputError
from taichi_nmm.body import Bodies
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.entry_points import accelerate, advance
from taichi_nmm.kernel.layout import COORDINATES, LEGS
from taichi_nmm.kernel.muscle_table import muscle_table
from taichi_nmm.mujoco_engine import require_mujoco
from taichi_nmm.observation import LARGEST_ANGLE_RAD, require_within
from taichi_nmm.outcome import Part, Recorder, result_rows
from taichi_nmm.packs import Packs
from taichi_nmm.parameters import PUBLISHED_GAINS
from taichi_nmm.queue import LAUNCH_TICKS, SEATS, Queue
from taichi_nmm.result import Result
from taichi_nmm.settings import (
    CONTROL_TICK_S,
    OWN_ENGINE,
    Settings,
    settings_of_batch,
)
from taichi_nmm.terrain import Terrain
from taichi_nmm.walkers import (
    Batch,
    Schedule,
    Switch,
    blends,
    check_batch,
    constant_rows,
    start_rows,
)
from taichi_nmm.world import Worlds

LONGEST_WALK_S = 10_000.0  # ticks stay whole numbers in float32

Progress = Callable[[float, int], None]
Launch = Callable[[Packs, int, int], None]
"""Advances packs from a first control tick by so many."""
Walked = tuple[Iterable[Part], dict[str, Any]]
"""What is left of all walkers, and the engine's metadata."""


@checks.checked(
    duration_s=checks.number(),
    settings=checks.optional(checks.instance(Settings)),
    record_rate_hz=checks.number(),
    progress=checks.optional(checks.function),
)
def simulate(
    gains: ArrayLike,
    *,
    duration_s: float = 5.0,
    bodies: Bodies | None = None,
    terrains: Terrain | Sequence[Terrain] | None = None,
    terrain_index: ArrayLike | None = None,
    low_level_gains: ArrayLike | None = None,
    worlds: Worlds | None = None,
    switches: Sequence[Switch] = (),
    settings: Settings | None = None,
    record: Sequence[int] = (),
    record_rate_hz: float = 100.0,
    progress: Progress | None = None,
) -> Result:
    """Simulate a batch of walkers until each falls or `duration_s` is over.

    Args:
        gains: [n, gain] or [gain], in the order of `parameters.GAINS`.
        duration_s: how long a walker may walk, in whole control ticks of 1 ms.
        bodies: one for all or n of them; None is the nominal body.
        terrains: one for all, or several; None is flat ground.
        terrain_index: each walker's row of `terrains`, [n]; by default one terrain
            serves all, and n terrains serve a walker each.
        low_level_gains: [n, gain] or [gain], in the order of
            `parameters.LOW_LEVEL_GAINS`.
        worlds: one for all or n of them; None is the nominal world.
        switches: other gains later on, one switch after another.
        settings: precision, step, contact, machine; None is `Settings()`.
        record: rows of the walkers that get a `Trajectory`.
        record_rate_hz: samples a second of the trajectories; a divisor of 1000.
        progress: called between chunks with the simulated time in s and the walkers
            still up; on a GPU that more walkers queue for than it takes at once, with
            the share of them that are done, as a time.

    Raises:
        InputError: a shape, a value or an index that cannot be used.
        KeyboardInterrupt: between chunks.
    """
    settings = Settings() if settings is None else settings
    batch = check_batch(gains, bodies, terrains, terrain_index, low_level_gains, worlds)
    settings = settings_of_batch(settings, len(batch))
    if not CONTROL_TICK_S <= duration_s <= LONGEST_WALK_S:
        raise InputError(
            "duration_s", duration_s, f"{CONTROL_TICK_S} to {LONGEST_WALK_S:g}"
        )
    ticks = round(duration_s / CONTROL_TICK_S)
    recorder = Recorder(record, record_rate_hz, batch, settings)
    schedule = Schedule(batch, settings, switches)
    walks = _walks_queued if _takes_queue(settings) else _walks_packed
    parts, metadata = walks(
        batch, settings, ticks, schedule, recorder, progress or _silent
    )
    rows = result_rows(parts, len(batch), batch.bodies, duration_s)
    return Result(rows, recorder.trajectories(), metadata)


def _silent(now_s: float, up: int) -> None:
    """Report nothing."""


def _takes_queue(settings: Settings) -> bool:
    """Whether walkers queue on a GPU, which is started then."""
    if settings.engine != OWN_ENGINE:
        return False
    backend.start(settings)
    return backend.is_gpu()


def _walks_queued(
    batch: Batch,
    settings: Settings,
    ticks: int,
    schedule: Schedule,
    recorder: Recorder,
    progress: Progress,
) -> Walked:
    """All walks on a GPU."""
    count, duration_s = len(batch), ticks * CONTROL_TICK_S
    at_once = bool(recorder.walkers) or not schedule.is_constant
    queue = Queue(batch, settings, ticks, at_once)
    up = count
    while up and at_once and queue.tick < ticks:
        chunk = LAUNCH_TICKS
        if not schedule.is_constant:
            rows, chunk = schedule.at(queue.tick)
            queue.set_constants(rows)
        for part in recorder.parts(queue.tick, min(chunk, ticks - queue.tick)):
            up = queue.advance(part)
            recorder.sample(queue.tick, queue.rows_of)
        progress(queue.tick * CONTROL_TICK_S, up)
    while up:
        up = queue.advance()
        walked_s = (1.0 - up / count) * duration_s
        if count <= SEATS:  # all began together
            walked_s = min(queue.tick * CONTROL_TICK_S, duration_s)
        progress(walked_s, up)
    return queue.collect(), backend.metadata()


def _walks_packed(
    batch: Batch,
    settings: Settings,
    ticks: int,
    schedule: Schedule,
    recorder: Recorder,
    progress: Progress,
) -> Walked:
    """All walks on the processor."""
    launch, packs, engine = _start(batch, settings)
    tick = 0
    while tick < ticks and packs.walkers.size:
        chunk = schedule.set_constants(packs, tick)
        for part in recorder.parts(tick, min(chunk, ticks - tick)):
            launch(packs, tick, part)
            tick += part
            recorder.sample(tick, packs.rows_of)
        packs.drain()
        progress(tick * CONTROL_TICK_S, int(np.count_nonzero(packs.up())))
        packs.compact()
    return [packs.collect()], engine()


def _start(
    batch: Batch, settings: Settings
) -> tuple[Launch, Packs, Callable[[], dict[str, Any]]]:
    """The function that advances packs, the walkers at the start, and the engine's metadata."""
    if settings.engine == OWN_ENGINE:
        return launcher(batch, settings), start_packs(batch, settings), backend.metadata
    require_mujoco()
    from taichi_nmm.mujoco_engine import engine

    backend.start(settings.on_processor())
    batch = batch.each()
    packs = start_packs(batch, settings)
    return (
        engine.launcher(batch, settings, packs),
        packs,
        lambda: engine.metadata(settings),
    )


def start_packs(batch: Batch, settings: Settings) -> Packs:
    """The walkers at the start. The backend runs already: it sets lanes and precision."""
    rows, starts = start_rows(batch)
    constants = constant_rows(batch, settings)
    return Packs(rows, constants, batch.terrain_index, starts=starts)


def launcher(batch: Batch, settings: Settings) -> Launch:
    """The kernel with everything that stays the same from launch to launch."""
    real = backend.real_dtype()
    heights = np.array([terrain.height_m for terrain in batch.terrains], dtype=real)
    step_s = settings.physics_step_s
    rough = int(heights.any())
    muscles = muscle_table(step_s).astype(real)
    activation_blend, load_blend = blends(step_s)

    bound: tuple[NDArray[Any], backend.BoundKernel] | None = None

    def launch(packs: Packs, first_tick: int, ticks: int) -> None:
        nonlocal bound
        if bound is None or bound[0] is not packs.rows:
            # In the order of the kernel's own parameters.
            kernel = backend.BoundKernel(
                advance,
                packs.lanes,
                packs.rows,
                packs.constants,
                packs.terrains,
                heights,
                muscles,
                first_tick,
                ticks,
                settings.substeps,
                step_s,
                activation_blend,
                load_blend,
                rough,
            )
            bound = packs.rows, kernel
        bound[1].launch(first_tick=first_tick, ticks=ticks)

    return launch


def forward_dynamics(
    q: ArrayLike, qdot: ArrayLike, joint_torque: ArrayLike, bodies: Bodies | None = None
) -> NDArray[np.float64]:
    """Accelerations of a batch of states without contact, by the kernel's own functions, [n, 9].

    Args:
        q: hip x, z and the angles of HAT, thigh, shank, foot left, then right, [n, 9].
        qdot: their rates, [n, 9].
        joint_torque: left hip, knee, ankle, right hip, knee, ankle, N m, [n, 6];
            positive turns the child clockwise.
        bodies: one for all or n of them; None is the nominal body.

    Raises:
        InputError: a shape that does not fit; a number that is not finite, or so large
            that sines of angles are noise, or accelerations no numbers.
    """
    angles = _matrix("q", q, COORDINATES)
    require_within("q: angles in rad", angles[:, 2:], LARGEST_ANGLE_RAD)
    count = len(angles)
    rates = _matrix("qdot", qdot, COORDINATES, count)
    torques = _matrix("joint_torque", joint_torque, 3 * LEGS, count)
    batch = check_batch(np.tile(PUBLISHED_GAINS, (count, 1)), bodies)
    settings = Settings(precision="float64", arch="cpu")
    backend.start(settings)
    packs = Packs(np.hstack([angles, rates]), constant_rows(batch, settings))
    accelerations = np.zeros((len(packs.rows), COORDINATES, packs.lanes))
    backend.launch(
        accelerate,
        packs.lanes,
        packs.rows,
        packs.fold(torques),
        packs.constants,
        accelerations,
    )
    found = packs.unfold(accelerations)
    broken = np.flatnonzero(~np.isfinite(found).all(axis=1))
    if len(broken):
        row = int(broken[0])
        rate, torque = np.abs(rates[row]).max(), np.abs(torques[row]).max()
        name, largest = ("qdot", rate) if rate > torque else ("joint_torque", torque)
        raise InputError(
            f"{name}[{row}]", float(largest), "numbers whose accelerations are finite"
        )
    return found


def _matrix(
    name: str, values: ArrayLike, columns: int, rows: int | None = None
) -> NDArray[np.float64]:
    matrix = checks.numbers(name, values)
    count = "n" if rows is None else str(rows)
    fits = matrix.ndim == 2 and len(matrix) > 0 and matrix.shape[1] == columns
    if not fits or (rows is not None and len(matrix) != rows):
        raise InputError(f"{name}.shape", matrix.shape, f"[{count}, {columns}]")
    return checks.finite(name, matrix)
