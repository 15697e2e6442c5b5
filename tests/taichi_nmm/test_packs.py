"""Packs: who falls makes room, and every walker keeps its rows."""

import math

import numpy as np

from taichi_nmm.kernel import backend
from taichi_nmm.kernel.layout import Const, Ends, State, WalkerRows
from taichi_nmm.packs import Packs
from taichi_nmm.settings import Settings

FALLS = (
    [3],
    [28, 0, 9, 27, 26, 5],
    [*range(10, 22)],
    [1, 2, 4, 6, 7, 8],
    [22, 23, 24, 25],
)


def test_walkers_of_the_last_packs_take_the_lanes_of_those_that_have_ended():
    backend.start(Settings(arch="cpu"))
    rows = np.zeros((1, WalkerRows.count))
    numbers = np.arange(29, dtype=np.int32)
    rows[:, State.active] = 1.0
    constants = np.tile(numbers[:, None], (1, Const.count)).astype(np.float64)
    packs = Packs(rows, constants, numbers, starts=0 * numbers)
    up = set(numbers)
    for walkers in FALLS:
        for walker in walkers:
            pack, lane = packs.lane_of(walker) or (-1, -1)
            packs.rows[pack, State.active, lane] = 0.0
            packs.rows[pack, State.end_reason, lane] = 1.0
        packs.compact()
        up -= set(walkers)
        assert set(packs.walkers[packs.up()]) == up
        assert len(packs.rows) == math.ceil(len(up) / packs.lanes)
        assert np.array_equal(
            packs.terrains.ravel()[: len(packs.walkers)], packs.walkers
        )
        assert np.array_equal(packs.constants[:, 0], packs.terrains)
        assert np.isin(packs.terrains, packs.walkers).all()  # idle lanes are copies
    assert packs.collect()[0][:, Ends.end_reason].all()
