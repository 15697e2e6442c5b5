"""Walks of version 0.2.0 on both engines, frozen: every sum and score of a result.

Parity with NumPy and MuJoCo covers forces and torques; the scores of a walk have no
second source.

    python -m tests.parity.test_frozen_walks    # freezes the walks anew: after a change of physics

Another processor may round otherwise in the last places, which contacts enlarge.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from taichi_nmm import Bodies, Settings, WorldRanges, simulate, terrain
from taichi_nmm.parameters import load_gains, lower_bounds, upper_bounds
from taichi_nmm.result import ENERGY
from taichi_nmm.walker_simulator import Walker

pytestmark = pytest.mark.slow

FROZEN = Path(__file__).resolve().parents[1] / "assets"
DURATION_S = 4.0
TOLERANCE = 1e-6
WALKERS = {"taichi": 25, "mujoco": 10}
SHARED = WorldRanges(
    friction=(0.8, 1.0),
    strength=(0.9, 1.1),
    nerve_lag_s=(0, 0.005),
    sensing_noise=(0, 0.005),
)
WORLDS = {  # MuJoCo's contact is its own
    "taichi": replace(
        SHARED, contact_stiffness=(0.5, 1.5), relaxation_speed=(0.8, 1.5)
    ),
    "mujoco": SHARED,
}


def frozen(engine):
    return FROZEN / f"walks-{engine}.parquet"


def walked(engine):
    """Results of walkers near the reference gait, the last two of random gains: on five grounds."""
    count = WALKERS[engine]
    rng = np.random.default_rng(11)
    gains = load_gains("reference") * rng.uniform(0.98, 1.02, (count, 16))
    gains[-2:] = rng.uniform(lower_bounds(), upper_bounds(), (2, 16))
    grounds = [
        terrain.flat(),
        terrain.rough(3, flat_start_m=1.0, amplitude_m=0.02),
        terrain.blocks(4, flat_start_m=1.0, spacing_m=0.4, amplitude_m=0.01),
        terrain.ramp(increment=0.02, segment_m=1.0, direction="up"),
        terrain.stairs(rise_m=0.01, run_m=0.5, flat_start_m=1.0),
    ]
    return simulate(
        gains,
        duration_s=DURATION_S,
        bodies=Bodies.disturbed(range(count)),
        terrains=grounds,
        terrain_index=np.arange(count) % len(grounds),
        worlds=WORLDS[engine].draw(range(count)),
        settings=Settings(precision="float64", arch="cpu", engine=engine),
    ).rows


@pytest.mark.parametrize("engine", WALKERS)
def test_walks_are_those_of_0_2_0(engine):
    rows = walked(engine)
    known = pq.read_table(frozen(engine))
    added = {ENERGY}  # since 0.4.0
    assert {*known.column_names} == {*(Walker(Settings()).columns.names or ())} - added
    assert (rows["step_count"] > 0).sum() > len(rows) / 2
    for name in known.column_names:
        np.testing.assert_allclose(
            rows[name],
            known[name].to_numpy(),
            rtol=TOLERANCE,
            atol=TOLERANCE,
            err_msg=name,
        )


if __name__ == "__main__":
    for one in WALKERS:
        made = walked(one)
        pq.write_table(
            pa.table({name: made[name] for name in made.dtype.names}), frozen(one)
        )
