"""The compiled kernel against the same walker interpreted by NumPy, float64."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import taichi_nmm
from taichi_nmm import terrain
from taichi_nmm.body import Bodies
from taichi_nmm.parameters import PUBLISHED_GAINS, lower_bounds, upper_bounds
from taichi_nmm.settings import Settings
from taichi_nmm.world import WorldRanges
from tests.parity.interpreter import AllLanes, interpreted_walker

pytestmark = pytest.mark.slow

WALKERS = 24
TICKS = 500  # 0.5 s
TOLERANCE = 1e-6


@pytest.fixture(scope="module")
def request_() -> Any:
    rng = np.random.default_rng(11)
    gains = rng.uniform(lower_bounds(), upper_bounds(), (WALKERS, 16))
    gains[0] = PUBLISHED_GAINS
    bodies = Bodies.disturbed(np.random.SeedSequence(5).spawn(WALKERS))
    grounds = [
        terrain.flat(),
        terrain.rough(3, flat_start_m=0.0),
        terrain.blocks(4, flat_start_m=0.0, spacing_m=0.4),
        terrain.ramp(increment=0.1, segment_m=0.5, direction="down"),
        terrain.stairs(rise_m=0.03, run_m=0.3, flat_start_m=0.2),
    ]
    worlds = WorldRanges(
        (0.5, 3.0), (0.5, 3.0), (0.5, 1.0), (0.8, 1.1), (0.0, 0.01), (0.0, 0.01)
    ).draw(range(WALKERS))
    return gains, bodies, grounds, np.arange(WALKERS) % len(grounds), None, worlds


def start(request: Any, step_s: float) -> tuple[Settings, Any, Any]:
    """Settings, the checked batch and its packs at time zero."""
    from taichi_nmm import simulator
    from taichi_nmm.kernel import backend
    from taichi_nmm.walkers import check_batch

    settings = Settings(precision="float64", arch="cpu", physics_step_s=step_s)
    batch = check_batch(*request)
    backend.start(settings)
    return settings, batch, simulator.start_packs(batch, settings)


def walker_rows(packs: Any) -> NDArray[np.float64]:
    """Rows of every walker, [n, WALKER_ROWS]."""
    return np.array(packs.rows.transpose(0, 2, 1).reshape(-1, packs.rows.shape[1])[:WALKERS])


def compiled(request: Any, step_s: float) -> NDArray[np.float64]:
    """Rows of every walker after 0.5 s, [n, WALKER_ROWS]."""
    from taichi_nmm import simulator

    settings, batch, packs = start(request, step_s)
    simulator.launcher(batch, settings)(packs, 0, TICKS)
    return walker_rows(packs)


def interpreted(request: Any, step_s: float) -> NDArray[np.float64]:
    """The same by NumPy."""
    from taichi_nmm.kernel.layout import FIRST_DELAY, FIRST_EVENT, FIRST_FIBRE, FIRST_SUM, Work
    from taichi_nmm.kernel.muscle import ACTIVATION_TIME_S
    from taichi_nmm.kernel.muscle_table import muscle_table
    from taichi_nmm.kernel.reflexes import LOAD_FILTER_S
    from taichi_nmm.walkers import constant_rows

    settings, batch, packs = start(request, step_s)
    firsts = [FIRST_FIBRE, FIRST_DELAY, FIRST_EVENT, FIRST_SUM]
    blocks = np.split(np.ascontiguousarray(walker_rows(packs).T), firsts)
    const = constant_rows(batch, settings).T
    heights = np.array([ground.height_m for ground in batch.terrains])
    work = np.zeros((Work.count, WALKERS))
    walker = interpreted_walker()
    with np.errstate(all="ignore"):
        for tick in range(TICKS):
            walker.step(
                tick, settings.substeps, step_s,
                1.0 - np.exp(-step_s / ACTIVATION_TIME_S), 1.0 - np.exp(-step_s / LOAD_FILTER_S),
                AllLanes(WALKERS), batch.terrain_index, heights, muscle_table(step_s),
                *blocks, const, work,
            )  # fmt: skip
    return np.vstack(blocks).T


@pytest.mark.parametrize("step_s", [1e-3, pytest.param(0.5e-3, marks=pytest.mark.campaign)])
def test_compiled_kernel_equals_its_interpretation(request_: Any, step_s: float) -> None:
    from taichi_nmm.kernel.layout import FIRST_EVENT, Gait, State

    ours, numpys = compiled(request_, step_s), interpreted(request_, step_s)
    scale = np.maximum(np.abs(numpys), 1.0)
    assert np.nanmax(np.abs(ours - numpys) / scale) < TOLERANCE
    assert np.array_equal(np.isnan(ours), np.isnan(numpys))
    # Something happened: most walk on, the feet changed, the muscles pulled.
    assert ours[:, State.active].sum() > WALKERS / 2
    events = slice(FIRST_EVENT + Gait.tick_strike, FIRST_EVENT + Gait.tick_strike + 2)
    assert np.array_equal(ours[:, events], numpys[:, events])
    assert ours[:, events].max() > 0


def test_modules_are_put_back() -> None:
    interpreted_walker()
    from taichi_nmm.kernel import backend, walker

    assert hasattr(backend.ti, "kernel")
    assert taichi_nmm.simulate is not None
    assert walker.step is not interpreted_walker().step
