"""A walker of one formula, a small store made with it, and a pool without processes.

A walker's quality falls with the distance of its gains from the middle of their ranges; its body
and its ground take something off. Whoever passes WALKS_FROM walks to the end.
"""

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage.precompute import precompute
from storage.specification import read_specification
from study.comparison.experiment import Experiment, read_experiment
from study.comparison.group import Key, Proposals, StudyGroup
from study.survival import FAMILIES
from taichi_nmm.body import Bodies
from taichi_nmm.config import Table
from taichi_nmm.parameters import gain_rows, lower_bounds, upper_bounds
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE, Result, Trajectory
from taichi_nmm.terrain import Terrain

ROUND_S = float(os.environ.get("FAKE_ROUND_S", "0"))  # for those who want to kill it
WALKS_FROM = 0.7  # quality
EMPTY = Trajectory(0, *[np.empty(0)] * 9)
STORE_ROWS = 150
THETA_REF = 7  # of the low-level gains

calls: list[dict[str, Any]] = []  # what the simulator was called with


def quality(gains: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of each row of gains, 0 to 1, [n]."""
    unit = (gains - lower_bounds()) / (upper_bounds() - lower_bounds())
    return np.exp(-np.mean((2.0 * unit[:, :6] - 1.0) ** 2, axis=1) * 1.5)


def simulate(gains: Any, **options: Any) -> Result:
    """What `taichi_nmm.simulate` promises, with empty trajectories."""
    time.sleep(ROUND_S)
    gains = gain_rows(gains)
    calls.append({"gains": gains, **options})
    bodies: Bodies = options.get("bodies") or Bodies.nominal()
    terrains = options.get("terrains")
    grounds = [terrains] if isinstance(terrains, Terrain) else list(terrains or [])
    rough = np.array([np.std(np.diff(ground.height_m)) for ground in grounds] or [0.0])
    index = options.get("terrain_index")
    index = np.zeros(len(gains), dtype=int) if index is None else np.asarray(index)
    mass = np.resize(bodies.mass_kg.sum(axis=1), len(gains))
    good = quality(gains) * np.exp(-10.0 * rough[index] - abs(mass / 80.0 - 1.0) / 5.0)
    low_level = options.get("low_level_gains")
    if low_level is not None:
        good = good * np.exp(-np.abs(low_level[:, THETA_REF]))
    duration_s = options.get("duration_s", 5.0)
    rows = np.zeros(len(gains), RESULT_DTYPE)
    rows["duration_s"] = np.where(good >= WALKS_FROM, duration_s, duration_s * good)
    rows["end_reason"] = np.where(good >= WALKS_FROM, COMPLETED, FELL)
    rows["survived_fraction"] = rows["duration_s"] / duration_s
    rows["mean_speed_mps"] = 1.3 * good
    rows["distance_m"] = rows["mean_speed_mps"] * rows["duration_s"]
    rows["phi_printed"] = rows["phi_corrected"] = np.round(50.0 * good)
    for number in range(1, 5):
        rows[f"m{number}_mean"] = np.sin(number + 7.0 * good)
    rows["m5_mean_mps"] = good
    if options.get("progress") is not None:
        options["progress"](duration_s, 0)
    return Result(rows, (EMPTY,) * len(options.get("record", ())), {"engine": "fake"})


def write_store(path: Path, **changes: Any) -> None:
    """A store of fake scores; `taichi_nmm.simulate` must be the fake."""
    settings = {
        "settings": 1,
        "min_survival_s": 1.0,
        "terrain": {"kind": "rough", "amplitude_m": 0.08},
        "body": {"disturbance": 0.15},
    }
    families = {name: settings | {"seed": seed} for seed, name in enumerate(FAMILIES)}
    data = {"samples": STORE_ROWS, "seed": 3, "robust": settings, "families": families} | changes
    precompute(read_specification(Table(data)), path)


CONFIG = """
name = "toy"
seed = 5
runs = 3
trials = 8
arms = ["random", "dog", "score-first"]
{top}
[objective]
cost = "smooth"
[simulation]
duration_s = 20.0
[body]
disturbance = 0.15
[terrain]
kind = "rough"
[stores]
flat = "{store}"
robust = "{store}"
mild = "{store}"
ramps = "{store}"
diverse = "{store}"
"""


def write_config(folder: Path, top: str = "") -> Path:
    """A configuration in a folder, and the store that it names."""
    store = folder / "store"
    if not store.exists():
        searched = {"searched": ["theta_ref"]} if "theta_ref" in top else {}
        write_store(store, **searched)
    path = folder / "toy.toml"
    path.write_text(CONFIG.format(top=top, store=store))
    return path


def experiment(folder: Path, top: str = "") -> Experiment:
    """The experiment of `write_config`."""
    return read_experiment(write_config(folder, top))


class LocalPool:
    """`study.comparison.pool.Pool` in this process."""

    def __init__(
        self,
        experiment: Experiment,
        studies: list[Key],
        trials: int,
        known: dict[str, pa.Table],
        workers: int,
    ) -> None:
        self._group = StudyGroup(experiment, dict(enumerate(studies)), trials)
        self._group.restore(known)

    def __enter__(self) -> "LocalPool":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def propose(self) -> Proposals:
        return self._group.propose()

    def tell(self, costs: NDArray[np.float64], outcomes: NDArray[np.void]) -> None:
        self._group.tell(costs, outcomes)
