"""Bits do not depend on threads, order, size of the batch or process."""

import numpy as np
import pytest

from taichi_nmm import Bodies, Settings, simulate, terrain
from taichi_nmm.kernel import backend, registers
from taichi_nmm.parameters import PUBLISHED_GAINS, lower_bounds, upper_bounds
from tests.processes import printed
from tests.taichi_nmm.test_queue import queue_on_processor

pytestmark = pytest.mark.slow

WALKERS = 1000
DURATION_S = 2.0
CPU = Settings(arch="cpu")


def batch():
    rng = np.random.default_rng(7)
    gains = rng.uniform(lower_bounds(), upper_bounds(), (WALKERS, 16))
    gains[::10] = PUBLISHED_GAINS * rng.uniform(0.95, 1.05, (WALKERS // 10, 16))
    bodies = Bodies.disturbed(np.random.SeedSequence(3).spawn(WALKERS))
    grounds = [terrain.flat(), terrain.rough(1, flat_start_m=1.0)]
    return gains, bodies, grounds, np.arange(WALKERS) % 2


def rows(index, settings=CPU):
    """Results of these walkers of the batch, in this order."""
    gains, bodies, grounds, ground = batch()
    return simulate(
        gains[index],
        duration_s=DURATION_S,
        bodies=bodies.take(index),
        terrains=grounds,
        terrain_index=ground[index],
        settings=settings,
    ).rows


@pytest.fixture(scope="module")
def whole():
    return rows(np.arange(WALKERS))


def test_walkers_differ_and_a_permuted_batch_permutes_its_rows(whole):
    assert len(np.unique(whole["duration_s"])) > WALKERS / 4
    assert 0.02 < (whole["end_reason"] == 0).mean() < 0.9
    order = np.random.default_rng(1).permutation(WALKERS)
    assert rows(order).tobytes() == whole[order].tobytes()


@pytest.mark.parametrize("walker", [0, 5, 990])
def test_batch_of_one(whole, walker):
    assert rows(np.array([walker])).tobytes() == whole[[walker]].tobytes()


def test_threads_and_width_of_registers(whole):
    index = np.arange(200)
    width = registers.width()
    for threads, wide in ((1, True), (2, True), (1, False)):
        settings = Settings(arch="cpu", threads=threads, wide_registers=wide)
        assert rows(index, settings).tobytes() == whole[:200].tobytes()
        assert backend.lanes() == (width if wide and width else backend.LANES_CPU)


@pytest.mark.parametrize("launch_ticks", [130, 5000])
def test_a_queue_as_on_gpus(whole, monkeypatch, launch_ticks):
    queue_on_processor(monkeypatch, launch_ticks)
    index = np.arange(300)[::-1]
    assert rows(index).tobytes() == whole[index].tobytes()


def test_new_process(whole, tmp_path):
    file = tmp_path / "rows.npy"
    code = (
        "import sys, numpy as np; from tests.taichi_nmm.test_determinism import rows; "
    )
    code += "np.save(sys.argv[1], rows(np.arange(64)))"
    printed("-c", code, file)
    assert np.load(file).tobytes() == whole[:64].tobytes()
