"""The kernels that the host launches: packs side by side, one pack a task of the parallel loop.

A pack's rows live in NumPy arrays [pack, row, lane] between launches and in local arrays within
one, since only local arrays let the compiler vectorise (`backend`).
"""

from taichi_nmm.kernel import dynamics, kinematics, walker
from taichi_nmm.kernel.backend import Array, Rows, local_rows, ti
from taichi_nmm.kernel.layout import (
    COORDINATES,
    FIRST_DELAY,
    FIRST_EVENT,
    FIRST_FIBRE,
    FIRST_SUM,
    MUSCLES_PER_LEG,
    RINGS,
    Const,
    Delay,
    Gait,
    Muscle,
    State,
    Sums,
    Work,
)
from taichi_nmm.kernel.muscle_table import TABLE_COLUMNS

PACKS_PER_TASK = 1  # of the CPU's thread pool; packs are few and long


@ti.func
def load(packs: Rows, p, first: Rows, count: Rows, lanes: Rows):
    """A block of a pack's rows in a local array."""
    rows = local_rows(count, lanes)
    for row in range(count):
        for lane in range(lanes):
            rows[row, lane] = packs[p, first + row, lane]
    return rows


@ti.func
def load_table(muscles: Rows):
    """The muscles' constants in a local array."""
    table = local_rows(MUSCLES_PER_LEG, TABLE_COLUMNS)
    for m in ti.static(range(MUSCLES_PER_LEG)):
        for c in ti.static(range(TABLE_COLUMNS)):
            table[m, c] = muscles[m, c]
    return table


@ti.func
def load_terrains(terrains: Rows, p, lanes: Rows):
    """The ground of each lane."""
    terrain = ti.Vector.zero(ti.i32, lanes)
    for lane in range(lanes):
        terrain[lane] = terrains[p, lane]
    return terrain


@ti.func
def save(packs: Rows, p, first: Rows, count: Rows, lanes: Rows, source: Rows):
    """Copy a local array back into a block of a pack's rows."""
    for row in range(count):
        for lane in range(lanes):
            packs[p, first + row, lane] = source[row, lane]


@ti.func
def load_slots(packs: Rows, p, tick, lanes: Rows):
    """A local array of a pack's delay rings, with the slots that a tick exchanges."""
    delay = local_rows(Delay.count, lanes)
    for lane in range(lanes):
        for _signal, count, ticks, first in ti.static(RINGS):
            for i in ti.static(range(count)):
                row = first + i * ticks + ti.raw_mod(tick, ticks)
                delay[row, lane] = packs[p, FIRST_DELAY + row, lane]
    return delay


@ti.func
def save_slots(packs: Rows, p, tick, lanes: Rows, delay: Rows):
    """Copy them back."""
    for lane in range(lanes):
        for _signal, count, ticks, first in ti.static(RINGS):
            for i in ti.static(range(count)):
                row = first + i * ticks + ti.raw_mod(tick, ticks)
                packs[p, FIRST_DELAY + row, lane] = delay[row, lane]


@ti.kernel
def advance(
    lanes: Rows,
    packs: Array,
    constants: Array,
    terrains: Array,
    heights: Array,
    muscles: Array,
    first_tick: int,
    ticks: int,
    substeps: int,
    step_s: float,
    activation_blend: float,
    load_blend: float,
    rough: int,
):
    """Advance all packs by `ticks` control ticks; `rough` is 0 where all terrains have height 0.

    packs [p, WALKER_ROWS, lanes], constants [p, Const.count, lanes], terrains [p, lanes] (rows of
    `heights` [terrain, node]), muscles [7, TABLE_COLUMNS].
    """
    ti.loop_config(block_dim=PACKS_PER_TASK)
    for p in range(packs.shape[0]):
        work = local_rows(Work.count, lanes)
        table = load_table(muscles)
        state = load(packs, p, 0, State.count, lanes)
        fibres = load(packs, p, FIRST_FIBRE, Muscle.count, lanes)
        delay = load(packs, p, FIRST_DELAY, Delay.count, lanes)
        events = load(packs, p, FIRST_EVENT, Gait.count, lanes)
        sums = load(packs, p, FIRST_SUM, Sums.count, lanes)
        const = load(constants, p, 0, Const.count, lanes)
        terrain = load_terrains(terrains, p, lanes)
        for tick in range(first_tick, first_tick + ticks):
            walker.step(
                tick, substeps, step_s, activation_blend, load_blend, rough,
                lanes, terrain, heights, table,
                state, fibres, delay, events, sums, const, work,
            )  # fmt: skip
        save(packs, p, 0, State.count, lanes, state)
        save(packs, p, FIRST_FIBRE, Muscle.count, lanes, fibres)
        save(packs, p, FIRST_DELAY, Delay.count, lanes, delay)
        save(packs, p, FIRST_EVENT, Gait.count, lanes, events)
        save(packs, p, FIRST_SUM, Sums.count, lanes, sums)


@ti.kernel
def accelerate(
    lanes: Rows,
    states: Array,
    torques: Array,
    constants: Array,
    accelerations: Array,
):
    """Accelerations of walkers in the air: `dynamics.solve` with the generalised forces alone.

    states [p, 18, lanes] (q, then qdot), torques [p, 6, lanes], accelerations [p, 9, lanes].
    """
    ti.loop_config(block_dim=PACKS_PER_TASK)
    for p in range(states.shape[0]):
        work = local_rows(Work.count, lanes)
        state = load(states, p, 0, 2 * COORDINATES, lanes)
        const = load(constants, p, 0, Const.count, lanes)
        for lane in range(lanes):
            for i in ti.static(range(6)):
                work[Work.joint_torque + i, lane] = torques[p, i, lane]
        for lane in range(lanes):
            kinematics.directions(lane, state, work)
            dynamics.momentum_after_free_step(lane, 1.0, 0.0, state, const, work)
            dynamics.solve(lane, 1.0, const, work)
        for lane in range(lanes):
            for i in ti.static(range(COORDINATES)):
                accelerations[p, i, lane] = work[Work.new_qdot + i, lane]
