"""The kernels that the host launches: packs side by side, in turns of the parallel loop.

A pack's rows live in NumPy arrays [pack, row, lane] between launches and in local
arrays within one, since only local arrays let the compiler vectorise (`backend`).
"""

from taichi_nmm.kernel import dynamics, kinematics, walker
from taichi_nmm.kernel.backend import Array, Rows, Static, local_rows, named_rows, ti
from taichi_nmm.kernel.layout import (
    COORDINATES,
    MUSCLES_PER_LEG,
    RINGS,
    Const,
    Delay,
    Gait,
    Muscle,
    Pose,
    State,
    Sums,
    WalkerRows,
    Work,
)
from taichi_nmm.kernel.muscle_table import TABLE_COLUMNS

TURNS_PER_TASK = 1  # of the CPU's thread pool; packs are few and long


@ti.func
def load(packs: Rows, p, first: Static, layout: Static, lanes: Static):
    """A block of a pack's rows in a local array."""
    rows = named_rows(layout, lanes)
    for row in range(layout.count):
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
def load_terrains(terrains: Rows, p, lanes: Static):
    """The ground of each lane."""
    terrain = ti.Vector.zero(ti.i32, lanes)
    for lane in range(lanes):
        terrain[lane] = terrains[p, lane]
    return terrain


@ti.func
def save(packs: Rows, p, first: Static, lanes: Static, source: Rows):
    """Copy a local array back into a block of a pack's rows."""
    for row in range(source.count):
        for lane in range(lanes):
            packs[p, first + row, lane] = source[row, lane]


@ti.func
def load_slots(packs: Rows, p, tick, lanes: Static):
    """A local array of a pack's delay rings, with the slots that a tick exchanges."""
    delay = named_rows(Delay, lanes)
    for lane in range(lanes):
        for _signal, count, ticks, first in ti.static(RINGS):
            for i in ti.static(range(count)):
                row = first + i * ticks + ti.raw_mod(tick, ticks)
                delay[row, lane] = packs[p, WalkerRows.delay + row, lane]
    return delay


@ti.func
def save_slots(packs: Rows, p, tick, lanes: Static, delay: Rows):
    """Copy them back."""
    for lane in range(lanes):
        for _signal, count, ticks, first in ti.static(RINGS):
            for i in ti.static(range(count)):
                row = first + i * ticks + ti.raw_mod(tick, ticks)
                packs[p, WalkerRows.delay + row, lane] = delay[row, lane]


@ti.kernel
def advance(
    lanes: Static,
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

    packs [p, WalkerRows.count, lane], constants [p, Const.count, lane], terrains [p, lane]
    (rows of `heights` [terrain, node]), muscles [7, TABLE_COLUMNS].
    """
    ti.loop_config(block_dim=TURNS_PER_TASK)
    for p in range(packs.shape[0]):
        work = named_rows(Work, lanes)
        table = load_table(muscles)
        state = load(packs, p, 0, State, lanes)
        fibres = load(packs, p, WalkerRows.fibres, Muscle, lanes)
        delay = load(packs, p, WalkerRows.delay, Delay, lanes)
        events = load(packs, p, WalkerRows.events, Gait, lanes)
        sums = load(packs, p, WalkerRows.sums, Sums, lanes)
        const = load(constants, p, 0, Const, lanes)
        terrain = load_terrains(terrains, p, lanes)
        for tick in range(first_tick, first_tick + ticks):
            walker.step(
                tick,
                substeps,
                step_s,
                activation_blend,
                load_blend,
                rough,
                lanes,
                terrain,
                heights,
                table,
                state,
                fibres,
                delay,
                events,
                sums,
                const,
                work,
            )
        save(packs, p, 0, lanes, state)
        save(packs, p, WalkerRows.fibres, lanes, fibres)
        save(packs, p, WalkerRows.delay, lanes, delay)
        save(packs, p, WalkerRows.events, lanes, events)
        save(packs, p, WalkerRows.sums, lanes, sums)


@ti.kernel
def accelerate(
    lanes: Static,
    states: Array,
    torques: Array,
    constants: Array,
    accelerations: Array,
):
    """Accelerations of walkers in the air: `dynamics.solve` with the generalised forces alone.

    states [p, 18, lanes] (q, then qdot), torques [p, 6, lanes], accelerations [p, 9,
    lanes].
    """
    ti.loop_config(block_dim=TURNS_PER_TASK)
    for p in range(states.shape[0]):
        work = named_rows(Work, lanes)
        state = load(states, p, 0, Pose, lanes)
        const = load(constants, p, 0, Const, lanes)
        for lane in range(lanes):
            for i in ti.static(range(6)):
                work.joint_torque[i, lane] = torques[p, i, lane]
        for lane in range(lanes):
            kinematics.directions(lane, state, work)
            dynamics.momentum_after_free_step(lane, 1.0, 0.0, state, const, work)
            dynamics.solve(lane, 1.0, const, work)
        for lane in range(lanes):
            for i in ti.static(range(COORDINATES)):
                accelerations[p, i, lane] = work.new_qdot[i, lane]
