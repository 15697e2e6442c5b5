"""Where the rows lie: gains by name, in the order of their tables, and none twice."""

import numpy as np

from taichi_nmm import Bodies, Settings
from taichi_nmm.kernel.layout import (
    WALKER_ROWS,
    Const,
    Delay,
    Gait,
    Muscle,
    Signal,
    State,
    Sums,
    Work,
    blocks,
)
from taichi_nmm.parameters import GAIN_NAMES, LOW_LEVEL_NAMES
from taichi_nmm.walkers import check_batch, constant_rows


def test_blocks_follow_each_other_and_each_gain_has_a_row_of_its_name() -> None:
    named = blocks(a=2, b=1, c=3)
    assert (named.a, named.b, named.c, named.count) == (0, 2, 3, 6)
    assert sum(block.count for block in (State, Muscle, Delay, Gait, Sums)) == WALKER_ROWS
    # What the table can say in numbers alone: signals are felt and sensed, each in a row.
    assert State.device_air - State.felt == Signal.count
    assert Work.sensed - Work.leg_angle_rate == 2 and Work.sensed + Signal.count <= Work.count
    gains = np.arange(1.0, 1.0 + len(GAIN_NAMES))
    low_level = -np.arange(1.0, 1.0 + len(LOW_LEVEL_NAMES))
    (rows,) = constant_rows(check_batch(gains, low_level_gains=low_level), Settings())
    assert [rows[getattr(Const, name)] for name in GAIN_NAMES] == gains.tolist()
    assert [rows[getattr(Const, name)] for name in LOW_LEVEL_NAMES] == low_level.tolist()
    assert rows[Const.total_mass] == Bodies.nominal().mass_kg.sum()
    # Side by side, in their order, before all else.
    assert rows[: Const.total_mass].tolist() == [*gains.tolist(), *low_level.tolist()]
