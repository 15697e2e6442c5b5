"""Packs: who falls makes room, and every walker keeps its rows."""

import numpy as np
import pytest

from taichi_nmm.kernel import backend
from taichi_nmm.kernel.layout import FIRST_SUM, WALKER_ROWS, Const, State
from taichi_nmm.packs import Packs
from taichi_nmm.settings import Settings

WALKERS = 29
HIP = State.q  # a row that tells walkers apart here


@pytest.fixture
def packs() -> Packs:
    """Walkers that start alike in threes; each has its number as a constant and as its ground."""
    backend.start(Settings(arch="cpu"))
    rows = np.zeros((-(-WALKERS // 3), WALKER_ROWS))
    rows[:, State.active] = 1.0
    rows[:, HIP] = np.arange(len(rows))
    numbers = np.arange(WALKERS)
    constants = np.tile(numbers[:, None], (1, Const.count)).astype(np.float64)
    return Packs(rows, constants, numbers.astype(np.int32), starts=numbers // 3)


def fall(packs: Packs, walkers: list[int]) -> None:
    for walker in walkers:
        seat = packs.lane_of(walker)
        assert seat is not None
        packs.rows[seat[0], State.active, seat[1]] = 0.0


def test_walkers_of_the_last_packs_take_the_lanes_of_those_that_have_ended(packs: Packs) -> None:
    before, lanes = packs.rows, packs.lanes
    gone: list[int] = []
    for walkers in ([3], [28, 0, 9, 27, 26, 5], list(range(10, 22)), [1, 2, 4, 6, 7, 8, 22, 23]):
        fall(packs, walkers)
        gone += walkers
        packs.compact()
        up = WALKERS - len(gone)
        assert len(packs.rows) == len(packs.constants) == len(packs.terrains) == -(-up // lanes)
        assert np.shares_memory(packs.rows, before) and packs.rows.flags.c_contiguous
        assert set(packs.walkers[packs.up()]) == set(range(WALKERS)) - set(gone)
        assert np.array_equal(packs.terrains.ravel()[: len(packs.walkers)], packs.walkers)
        for walker in packs.walkers:
            pack, lane = packs.lane_of(walker) or (-1, -1)
            assert packs.rows[pack, HIP, lane] == walker // 3
            assert np.all(packs.constants[pack, :, lane] == walker)
        if len(packs.walkers) == up:  # the rest of the last pack are copies of its last walker
            rest = packs.terrains.ravel()[up:]
            assert np.all(rest == packs.walkers[-1])
    final, _ = packs.collect()
    assert final[:, HIP].tolist() == [walker // 3 for walker in range(WALKERS)]
    assert final[:, State.active].tolist() == [float(walker not in gone) for walker in range(29)]


def test_sums_follow_their_walkers_and_all_may_end(packs: Packs) -> None:
    for turn in range(4):
        pack, lane = np.divmod(np.arange(len(packs.walkers)), packs.lanes)
        packs.rows[pack, FIRST_SUM, lane] = packs.walkers
        packs.drain()
        assert not packs.rows[:, FIRST_SUM:].any()
        fall(packs, packs.walkers[packs.up()][:: 2 if turn < 3 else 1].tolist())
        packs.compact()
    assert len(packs.walkers) == 0 and len(packs.rows) == 0
    final, sums = packs.collect()
    turns = sums[1:, 0] / np.arange(1, WALKERS)
    assert np.all(turns == np.round(turns)) and turns.min() == 1 and turns.max() == 4
    assert not final[:, State.active].any()
