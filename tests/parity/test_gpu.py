"""The kernel on a GPU against the same on the processor; skipped where there is no GPU.

All walkers start with tendons that are slack to the last bit, and rounding decides
whether one pulls. So the two are compared from a state that the processor has walked
to.
"""

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from taichi_nmm import InputError, Settings, simulator
from taichi_nmm.kernel import backend
from taichi_nmm.kernel.layout import State
from taichi_nmm.packs import Packs
from taichi_nmm.parameters import LOW_LEVEL_NAMES
from taichi_nmm.walkers import Batch
from tests.parity.test_compiler import walking_batch

WALKERS = 64  # two warps
START_TICK = 100
MARKS = (101, 150, 600)
TOLERANCE = 1e-9  # of each row, or of 1: rounding, in float64
DEVICE = slice(State.device_air, State.device_torque)


def walked(
    batch: Batch,
    arch: str,
    ticks: tuple[int, ...],
    rows: NDArray[np.float64] | None = None,
) -> list[NDArray[np.float64]]:
    """Rows of all walkers at the later ticks, [n, row] each, from `rows` at the first one."""
    settings = Settings(arch=arch, precision="float64")
    backend.start(settings)
    packs = simulator.start_packs(batch, settings)
    launch = simulator.launcher(batch, settings)
    if rows is not None:
        packs.rows[...] = packs.fold(rows)
    return [
        after(packs, launch, first, last - first) for first, last in pairwise(ticks)
    ]


def after(
    packs: Packs, launch: simulator.Launch, tick: int, ticks: int
) -> NDArray[np.float64]:
    launch(packs, tick, ticks)
    return np.array(packs.unfold(packs.rows))


def test_a_gpu_walks_as_the_processor() -> None:
    try:
        backend.start(Settings(arch="cuda"))
    except InputError:
        pytest.skip("no GPU")
    batch = walking_batch(WALKERS)
    (start,) = walked(batch, "cpu", (0, START_TICK))
    later = (START_TICK, *MARKS)
    gpus, cpus = walked(batch, "cuda", later, start), walked(batch, "cpu", later, start)
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
