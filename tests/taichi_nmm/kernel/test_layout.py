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
from taichi_nmm.parameters import (
    GAIN_NAMES,
    LOW_LEVEL_GAINS,
    LOW_LEVEL_NAMES,
    lower_bounds,
    upper_bounds,
)
from taichi_nmm.walkers import check_batch, constant_rows
from tests.parity.interpreter import interpreted


def test_blocks_follow_each_other_and_each_gain_has_a_row_of_its_name() -> None:
    named = blocks(a=2, b=1, c=3)
    assert (named.a, named.b, named.c, named.count) == (0, 2, 3, 6)
    assert (
        sum(block.count for block in (State, Muscle, Delay, Gait, Sums)) == WALKER_ROWS
    )
    # What the table can say in numbers alone: signals are felt and sensed, each in a
    # row.
    assert State.device_air - State.felt == Signal.count
    assert (
        Work.sensed - Work.leg_angle_rate == 2
        and Work.sensed + Signal.count <= Work.count
    )
    gains = np.arange(1.0, 1.0 + len(GAIN_NAMES))
    one_for_all, asymmetry = -np.arange(1.0, 13.0), np.full(16, 0.25)
    low_level = [*one_for_all, *asymmetry]
    (rows,) = constant_rows(check_batch(gains, low_level_gains=low_level), Settings())
    left, right = (
        [rows[getattr(Const, name) + leg] for name in GAIN_NAMES] for leg in (0, 1)
    )
    assert left == (1.25 * gains).tolist() and right == (0.75 * gains).tolist()
    names = LOW_LEVEL_NAMES[: len(one_for_all)]
    assert [rows[getattr(Const, name)] for name in names] == one_for_all.tolist()
    assert rows[Const.total_mass] == Bodies.nominal().mass_kg.sum()
    # Side by side, in their order, before all else.
    by_leg = np.column_stack([left, right]).ravel()
    assert rows[: Const.total_mass].tolist() == [*by_leg, *one_for_all]


def test_each_leg_is_controlled_by_its_own_gains() -> None:
    """By stance reflexes and swing: one leg as that of a walker whose legs both have its gains."""
    reflexes, swing = interpreted("reflexes", "swing")
    rng, lane = np.random.default_rng(5), np.arange(50)
    both = rng.uniform(lower_bounds(), upper_bounds(), (2, 16))
    low_level = np.tile([each.default for each in LOW_LEVEL_GAINS], (3, 1))
    low_level[0, -16:] = (both[0] - both[1]) / both.sum(axis=0)
    gains = np.vstack([both.mean(axis=0), both])
    walkers = constant_rows(check_batch(gains, low_level_gains=low_level), Settings())
    start = (
        rng.uniform(0.0, 1.0, (State.count, 50)),
        rng.uniform(-0.1, 1.0, (Work.count, 50)),
    )
    start[0][State.swing_phase : State.swing_phase + 2] = rng.integers(0, 4, (2, 50))
    orders = []
    for row in walkers:
        state, work = (each.copy() for each in start)
        const, fibres = np.tile(row[:, None], 50), np.zeros((Muscle.count, 50))
        reflexes.stimulate(lane, state, const, fibres, work)
        torques = [swing.swing_torques(lane, leg, state, const, work) for leg in (0, 1)]
        stimulations = fibres[Muscle.stimulation : Muscle.stimulation + 14].reshape(
            2, 7, 50
        )
        orders.append(
            [np.vstack([*stimulations[leg], *torques[leg]]) for leg in (0, 1)]
        )
    (left, right), of_left, of_right = orders
    np.testing.assert_allclose(left, of_left[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(right, of_right[1], rtol=1e-12, atol=1e-12)
    assert (
        np.abs(left - right).max(axis=1).all()
        and np.abs(left - of_right[0]).max() > 0.1
    )
