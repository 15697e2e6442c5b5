"""The kernel on a GPU against the same on the processor; skipped where there is no GPU.

All walkers start with tendons that are slack to the last bit, and rounding decides
whether one pulls. So the two are compared from a state that the processor has walked
to.
"""

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_nmm import InputError, Settings, queue, simulator
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.layout import State, WalkerRows
from taichi_nmm.kernel.queue import DRAIN_TICKS
from taichi_nmm.parameters import LOW_LEVEL_NAMES
from taichi_nmm.queue import Queue
from tests.parity.test_compiler import walking_batch

Array = NDArray[np.float64]

WALKERS = 64  # two warps
START_TICK = 100
MARKS = (0, 1, 50, DRAIN_TICKS, 2 * DRAIN_TICKS)
TOLERANCE = 1e-9  # of each row, or of 1: rounding, in float64
DEVICE = slice(State.device_air, State.device_torque)


def on_processor(batch, ticks, rows=None):
    """Rows of all walkers at the later ticks, [n, row] each, from `rows` at the first one."""
    settings = Settings(arch="cpu", precision="float64")
    backend.start(settings)
    packs = simulator.start_packs(batch, settings)
    launch = simulator.launcher(batch, settings)
    if rows is not None:
        packs.rows[...] = packs.fold(rows)
    found = []
    for first, last in pairwise(ticks):
        launch(packs, first, last - first)
        found.append(np.array(packs.unfold(packs.rows)))
        if last % DRAIN_TICKS == 0:
            packs.drain()
    return found


def on_gpu(batch, ticks):
    """The same by the queue, from where `start_rows` says."""
    settings = Settings(arch="cuda", precision="float64")
    backend.start(settings)
    walkers = Queue(batch, settings, ticks[-1] + 1, at_once=True)
    found = []
    for first, last in pairwise(ticks):
        walkers.advance(last - first)
        found.append(np.array([walkers.rows_of(n) for n in range(len(batch))]))
    return found


def test_a_gpu_walks_as_the_processor(monkeypatch):
    try:
        backend.start(Settings(arch="cuda"))
    except InputError:
        pytest.skip("no GPU")
    batch = walking_batch(WALKERS)
    (start,) = on_processor(batch, (0, START_TICK))
    start[:, WalkerRows.sums :] = 0.0
    # Where those begin whose clock is 0; no ring is longer than this.
    every = np.arange(WALKERS, dtype=np.int32)
    monkeypatch.setattr(queue, "start_rows", lambda batch: (start, every))
    gpus, cpus = on_gpu(batch, MARKS), on_processor(batch, MARKS, start)
    bare = batch.low_level[:, LOW_LEVEL_NAMES.index("exo_torque")] == 0.0
    assert 0 < bare.sum() < WALKERS
    for gpu, cpu in zip(gpus, cpus, strict=True):
        # Strides of walkers without a device are counted where another one of the pack
        # has one.
        gpu[bare, DEVICE] = cpu[bare, DEVICE]
        assert np.array_equal(gpu[:, State.active], cpu[:, State.active])
        up = cpu[:, State.active] > 0.5
        assert up.sum() > WALKERS / 2
        assert (
            np.max((np.abs(gpu - cpu) / np.maximum(np.abs(cpu), 1.0))[up]) < TOLERANCE
        )
