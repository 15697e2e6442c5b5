"""A walker of one formula in place of the simulator: tests of studies take milliseconds a trial.

A walker's quality falls with the distance of its gains from the middle of their ranges; the body
moves the optimum a little, the ground shortens every walk. Everything else follows from quality.
"""

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from storage.precompute import precompute
from storage.specification import read_specification
from taichi_nmm.body import Bodies
from taichi_nmm.config import Table
from taichi_nmm.parameters import gain_rows, lower_bounds, upper_bounds
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE, Result, Trajectory
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import Terrain

TRIAL_S = float(os.environ.get("FAKE_TRIAL_S", "0"))  # for those who want to kill it
WALKS_FROM = 0.75  # quality
EMPTY = Trajectory(0, *[np.empty(0)] * 9)


def quality(gains: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of each row of gains, 0 to 1, [n]."""
    unit = (gains - lower_bounds()) / (upper_bounds() - lower_bounds())
    return np.exp(-np.mean((2.0 * unit[:, :6] - 1.0) ** 2, axis=1) * 1.5)


def simulate(
    gains: NDArray[np.float64],
    duration_s: float = 5.0,
    bodies: Bodies | None = None,
    terrains: Terrain | Sequence[Terrain] | None = None,
    settings: Settings | None = None,
    record: Sequence[int] = (),
    progress: Callable[[float, int], None] | None = None,
) -> Result:
    """What `taichi_nmm.simulate` promises, with empty trajectories."""
    time.sleep(TRIAL_S)
    gains = gain_rows(gains)
    roughness_m = 0.0 if terrains is None else float(np.std(np.diff(terrains.height_m)))
    mass_kg = 80.0 if bodies is None else float(bodies.mass_kg.sum())
    good = quality(gains) * np.exp(-10.0 * roughness_m - abs(mass_kg / 80.0 - 1.0) / 5.0)
    rows = np.zeros(len(gains), RESULT_DTYPE)
    rows["duration_s"] = np.where(good >= WALKS_FROM, duration_s, duration_s * good)
    rows["end_reason"] = np.where(good >= WALKS_FROM, COMPLETED, FELL)
    rows["mean_speed_mps"] = 1.3 * good
    rows["distance_m"] = rows["mean_speed_mps"] * rows["duration_s"]
    rows["phi_printed"] = rows["phi_corrected"] = 50.0 * quality(gains)
    if progress is not None:
        progress(duration_s, 0)
    return Result(rows, (EMPTY,) * len(record), {"engine": "fake"})


def write_store(path: Path, points: int = 200) -> None:
    """A store of fake scores; `taichi_nmm.simulate` must be the fake."""
    precompute(read_specification(Table({"samples": points, "seed": 3})), path)
