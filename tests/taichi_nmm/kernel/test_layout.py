"""Where the rows lie: gains by name, in the order of their tables, and none twice."""

import numpy as np

from taichi_nmm import Bodies, Settings
from taichi_nmm.kernel.layout import (
    Const,
    Layout,
    Muscle,
    State,
    Work,
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


def test_blocks_follow_each_other_and_each_gain_has_a_row_of_its_name():
    layout = Layout(a=2, b=1, c=Layout(d=1, e=2))
    assert (layout.a, layout.b, layout.c, layout.count) == (0, 2, 3, 6)
    rows = np.arange(12.0).reshape(6, 2)
    named = layout.of(rows)
    assert named.a.tolist() == rows[:2].tolist() and named.b.tolist() == [4.0, 5.0]
    assert named.c.e.tolist() == rows[4:].tolist() and named.c[0, 1] == 7.0
    named.c.d[1] = named[0, 0] = -1.0  # views
    assert rows[3, 1] == rows[0, 0] == -1.0
    both = Layout(x=2) | Layout(2, y=1) | Layout(2, z=3)
    assert (both.x, both.y, both.z, both.count) == (0, 2, 2, 5)
    gains = np.arange(1.0, 1.0 + len(GAIN_NAMES))
    one_for_all, asymmetry = -np.arange(1.0, 13.0), np.full(16, 0.25)
    low_level = [*one_for_all, *asymmetry]
    rows = constant_rows(check_batch(gains, low_level_gains=low_level), Settings())
    const = Const.of(rows.T)
    by_leg = np.array([getattr(const, name)[:, 0] for name in GAIN_NAMES])
    np.testing.assert_array_equal(by_leg, np.outer(gains, [1.25, 0.75]))
    names = LOW_LEVEL_NAMES[: len(one_for_all)]
    assert [getattr(const, name)[0] for name in names] == one_for_all.tolist()
    assert const.total_mass[0] == Bodies.nominal().mass_kg.sum()


def test_each_leg_is_controlled_by_its_own_gains():
    """By stance reflexes and swing: one leg as that of a walker whose legs both have its gains."""
    reflexes, swing = interpreted("reflexes", "swing")
    rng = np.random.default_rng(5)
    lane = np.arange(50)
    both = rng.uniform(lower_bounds(), upper_bounds(), (2, 16))
    low_level = np.tile([each.default for each in LOW_LEVEL_GAINS], (3, 1))
    low_level[0, -16:] = (both[0] - both[1]) / both.sum(axis=0)
    gains = np.vstack([both.mean(axis=0), both])
    walkers = constant_rows(check_batch(gains, low_level_gains=low_level), Settings())
    states = rng.uniform(0.0, 1.0, (State.count, 50))
    scratch = rng.uniform(-0.1, 1.0, (Work.count, 50))
    State.of(states).swing_phase[:] = rng.integers(0, 4, (2, 50))
    orders = []
    for row in walkers:
        state, work = State.of(states.copy()), Work.of(scratch.copy())
        const = Const.of(np.tile(row[:, None], 50))
        fibres = Muscle.of(np.zeros((Muscle.count, 50)))
        reflexes.stimulate(lane, state, const, fibres, work)
        torques = [swing.swing_torques(lane, leg, state, const, work) for leg in (0, 1)]
        stimulations = fibres.stimulation.reshape(2, 7, 50)
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
