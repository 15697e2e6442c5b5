"""Whole walks on a GPU: its threads take walkers from a queue, one after the other.

A thread is a *seat*. A walker takes a seat only where the clock of all seats is a
multiple of the longest delay: then the threads of a warp read the same slots of their
delay rings, and numbers lie side by side. Between launches the rows of those under way
lie in `seats`. The step is the processor's own, `walker.step`.
"""

from taichi_nmm.kernel import backend, compiler, walker
from taichi_nmm.kernel.backend import Array, Rows, Static, named_rows, ti
from taichi_nmm.kernel.compiler import shared_rows, shared_table
from taichi_nmm.kernel.layout import (
    LOW_LEVEL,
    MUSCLES_PER_LEG,
    PER_WALKER,
    RINGS,
    Const,
    Delay,
    Ends,
    Gait,
    Muscle,
    State,
    Sums,
    WalkerRows,
    Work,
)
from taichi_nmm.kernel.muscle_table import TABLE_COLUMNS

LONGEST_RING = max(ticks for _, _, ticks, _ in RINGS)
DRAIN_TICKS = 250  # as often as the host drains sums on a processor
# A block's shared memory holds constants: 31 KB. Of 256 KB a multiprocessor then sets 32
# aside, and caches with the others what the threads' registers do not hold.
SEATS_PER_BLOCK = 128
SEATS_PER_BLOCK_DOUBLE = 64
FIRSTS = tuple(first for first, _ in WalkerRows.blocks.values())
FREE, CLOSED = -1, -2  # a seat without a walker: waits for one, or there is none left


def seats_per_block() -> int:
    """Threads of a block, in the precision that kernels are compiled for."""
    return SEATS_PER_BLOCK_DOUBLE if backend.is_double() else SEATS_PER_BLOCK


@ti.func
def take_rows(begins, seats: Rows, seat, starts: Rows, start, blocks: Static):
    """All rows of a walker, as `WalkerRows` has them: of its start, or of its seat.

    Both are columns of arrays [row, column]. Two functions would compile longer.
    """
    for rows, first in ti.static(zip(blocks, FIRSTS, strict=True)):
        for row in range(rows.count):
            rows[row, 0] = ti.select(
                begins, starts[first + row, start], seats[first + row, seat]
            )


@ti.func
def keep_rows(target: Rows, column, blocks: Static):
    """The same back."""
    for rows, first in ti.static(zip(blocks, FIRSTS, strict=True)):
        for row in range(rows.count):
            target[first + row, column] = rows[row, 0]


@ti.func
def take_constants(
    walker_number,
    gains: Rows,
    kinds: Rows,
    indices: Rows,
    muscles: Rows,
    const: Rows,
    table: Rows,
):
    """The constants of a walker: its gains, and what walkers of its kind share.

    And the table of muscles, which all share: were it written before the loop over
    ticks, LLVM would have each thread keep it.
    """
    for m in range(MUSCLES_PER_LEG):
        for c in range(TABLE_COLUMNS):
            table[m, c] = muscles[m, c]
    for row in range(PER_WALKER):
        const[row, 0] = gains[row, walker_number]
    kind = indices[0, walker_number]
    for row in range(PER_WALKER, Const.count):
        const[row, 0] = kinds[row - PER_WALKER, kind]


@ti.func
def drain(walker_number, sums: Rows, totals: Rows):
    """Add the sums to float64 totals, so that long walks lose no digits."""
    for row in range(Sums.count):
        # No atomic addition: a walker has one seat.
        totals[walker_number, row] = totals[walker_number, row] + ti.cast(
            sums[row, 0], ti.f64
        )


@ti.func
def is_over(own):
    """Whether a seat is closed, on a GPU all seats of a block.

    They wait for each other at every tick: the code of a step is read once for all.
    """
    over = own == CLOSED
    if ti.static(compiler.unrolls):
        over = ti.simt.block.sync_any_nonzero(ti.cast(own != CLOSED, ti.i32)) == 0
    return over


@ti.kernel
def walk(
    seats: Array,
    taken: Array,
    counters: Array,
    gains: Array,
    kinds: Array,
    indices: Array,
    starts: Array,
    heights: Array,
    muscles: Array,
    ends: Array,
    totals: Array,
    first_tick: int,
    ticks: int,
    longest: int,
    count: int,
    substeps: Static,
    step_s: float,
    activation_blend: float,
    load_blend: float,
    rough: int,
):
    """Let all seats go on for so many ticks; those whose walkers end take others of `count`.

    seats [WalkerRows.count, seat]; taken: the walker of each seat, and the tick at which
    it began, [2, seat]; counters: the next walker, and how many have ended, [1, 2]; gains
    [PER_WALKER, n]; kinds [Const.count - PER_WALKER, kind]; indices: each walker's kind,
    start and terrain, [3, n]; starts [WalkerRows.count, start]; heights [terrain, node];
    muscles [7, TABLE_COLUMNS]; ends [Ends.count, n]; totals, float64 [n, Sums.count]. A
    walker ends at `longest` ticks.
    """
    ti.loop_config(block_dim=ti.static(seats_per_block()))
    for seat in range(seats.shape[1]):
        work = named_rows(Work, 1)
        numbers = ti.static((substeps, step_s, activation_blend, load_blend, rough))
        table = shared_table(MUSCLES_PER_LEG, TABLE_COLUMNS)
        state = named_rows(State, 1)
        fibres = named_rows(Muscle, 1)
        delay = named_rows(Delay, 1)
        events = named_rows(Gait, 1)
        sums = named_rows(Sums, 1)
        blocks = ti.static((state, fibres, delay, events, sums))
        const = shared_rows(Const, LOW_LEVEL, seat, ti.static(seats_per_block()))
        terrain = ti.Vector.zero(ti.i32, 1)
        own = FREE
        began = 0
        if first_tick > 0:
            own = taken[0, seat]
            began = taken[1, seat]
        for clock in range(first_tick, first_tick + ticks):
            goes_on = (clock == first_tick) & (own >= 0)
            begins = False
            if (own == FREE) & (ti.raw_mod(clock, LONGEST_RING) == 0):
                own = seat  # all seats at first; the counter begins behind them
                if clock > 0:
                    own = ti.atomic_add(counters[0, 0], 1)
                if own >= count:
                    own = CLOSED
                else:
                    began = clock
                    begins = True
                    for row in range(Sums.count):
                        totals[own, row] = 0.0
            if begins | goes_on:
                take_constants(own, gains, kinds, indices, muscles, const, table)
                terrain[0] = indices[2, own]
                take_rows(begins, seats, seat, starts, indices[1, own], blocks)
            if is_over(own):
                break
            if own >= 0:
                tick = clock - began
                if ti.raw_mod(tick, DRAIN_TICKS) == 0:
                    drain(own, sums, totals)
                    for row in range(Sums.count):
                        sums[row, 0] = 0.0
                walker.step(
                    tick, *numbers, 1, terrain, heights, table, *blocks, const, work
                )
                if (tick + 1 >= longest) | (state.active[0] < 0.5):
                    drain(own, sums, totals)
                    for row in range(Ends.count):
                        ends[row, own] = state[State.end_reason + row, 0]
                    own = FREE
                    ti.atomic_add(counters[0, 1], 1)
        taken[0, seat] = own
        taken[1, seat] = began
        keep_rows(seats, seat, blocks)


@ti.kernel
def put(source: Array, target: Array):
    """Copy an array of the host's to the device, or back, [row, column] both."""
    for row, column in ti.ndrange(source.shape[0], source.shape[1]):
        target[row, column] = source[row, column]


@ti.kernel
def turn(source: Array, first: int, target: Array):
    """Copy rows of an array [row, column], from `first` on, to those of `target`, [column, row]."""
    for column, row in ti.ndrange(target.shape[0], target.shape[1]):
        target[column, row] = source[first + row, column]


@ti.kernel
def pick(source: Array, column: int, target: Array):
    """Copy a column of an array [row, column] to `target`, [row, 1]."""
    for row in range(target.shape[0]):
        target[row, 0] = source[row, column]
