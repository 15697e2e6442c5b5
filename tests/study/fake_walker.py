"""A walker of one formula in place of the simulator, stores made with it, and a toy experiment.

A walker's quality falls with the distance of its gains from the middle of their ranges;
its body and its ground take something off. Whoever passes WALKS_FROM walks to the end.
Trials take milliseconds.
"""

import os
import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import ArrayLike, NDArray

import taichi_nmm
from storage.inputs.config import Table
from storage.precompute import precompute
from storage.specification import read_specification
from study.experiment.experiment import Experiment, read_experiment
from taichi_nmm.body import Bodies
from taichi_nmm.parameters import gain_rows, lower_bounds, upper_bounds
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE, Result, Trajectory
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import Terrain
from taichi_nmm.world import Worlds
from tests.storage.fake import stopping

TRIAL_S = float(
    os.environ.get("FAKE_TRIAL_S", "0")
)  # of a call, for those who want to kill it
SIGNAL = os.environ.get(
    "FAKE_SIGNAL", ""
)  # "5:SIGKILL": sent to this process in its fifth call
WALKS_FROM = 0.7  # quality
WIDTHS = (9, 9, 6, 14, 14, 4, 6, 4, 6, 14, 14, 22, 2, 3)  # of a trajectory's arrays
EMPTY = Trajectory(
    0, np.empty(0), *(np.empty((0, n)) for n in WIDTHS)
)  # that cannot be drawn
STORE_ROWS = 150
KINDS = (
    "rough",
    "blocks",
    "up",
    "down",
    "stairs",
)  # of families, each with one of longer walks
THETA_REF = 7  # of the low-level gains

calls: list[dict[str, Any]] = []  # what the simulator was called with


def quality(gains: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of each row of gains, 0 to 1, [n]."""
    unit = (gains - lower_bounds()) / (upper_bounds() - lower_bounds())
    return np.exp(-np.mean((2.0 * unit[:, :6] - 1.0) ** 2, axis=1) * 1.5)


def simulate(
    gains: ArrayLike,
    *,
    duration_s: float = 5.0,
    bodies: Bodies | None = None,
    terrains: Terrain | Sequence[Terrain] | None = None,
    terrain_index: ArrayLike | None = None,
    worlds: Worlds | None = None,
    low_level_gains: ArrayLike | None = None,
    settings: Settings | None = None,
    record: Sequence[int] = (),
    progress: Callable[[float, int], None] | None = None,
    **options: Any,
) -> Result:
    """What `taichi_nmm.simulate` promises, with empty trajectories."""
    time.sleep(TRIAL_S)
    number, _, name = SIGNAL.partition(":")
    if number == str(len(calls) + 1):
        signal.raise_signal(signal.Signals[name])
    tried = gain_rows(gains)
    calls.append(
        {
            "gains": tried,
            "duration_s": duration_s,
            "bodies": bodies,
            "terrains": terrains,
            "terrain_index": terrain_index,
            "low_level_gains": low_level_gains,
            "settings": settings,
            "record": record,
            **options,
        }
    )
    bodies = bodies or Bodies.nominal()
    grounds = [terrains] if isinstance(terrains, Terrain) else list(terrains or [])
    rough = np.array([np.std(np.diff(ground.height_m)) for ground in grounds] or [0.0])
    index = (
        np.zeros(len(tried), int)
        if terrain_index is None
        else np.asarray(terrain_index)
    )
    mass = np.resize(bodies.mass_kg.sum(axis=1), len(tried))
    good = quality(tried) * np.exp(-10.0 * rough[index] - abs(mass / 80.0 - 1.0) / 5.0)
    if low_level_gains is not None:
        good = good * np.exp(-np.abs(np.atleast_2d(low_level_gains)[:, THETA_REF]))
    rows = np.zeros(len(tried), RESULT_DTYPE)
    rows["duration_s"] = np.where(good >= WALKS_FROM, duration_s, duration_s * good)
    rows["end_reason"] = np.where(good >= WALKS_FROM, COMPLETED, FELL)
    rows["survived_fraction"] = rows["duration_s"] / duration_s
    rows["mean_speed_mps"] = 1.3 * good
    rows["distance_m"] = rows["mean_speed_mps"] * rows["duration_s"]
    rows["step_count"] = np.ceil(rows["duration_s"])
    rows["phi_printed"] = rows["phi_corrected"] = np.round(
        50.0 * good
    )  # with ties, as of real
    for number in range(1, 5):
        rows[f"m{number}_mean"] = np.sin(number + 7.0 * good)
    rows["m5_mean_mps"] = good
    rows["activation_cubed_mean"] = 1.0 - good
    # Who spends least with the muscles alone does not with the motors.
    rows["cost_of_transport_jpkgpm"] = 3.0 + np.sin(9.0 * tried[:, 0])
    motors = 1.0 - np.sin(9.0 * tried[:, 0]) + np.cos(7.0 * tried[:, 1])
    rows["cost_of_transport_powered_jpkgpm"] = rows["cost_of_transport_jpkgpm"] + motors
    if progress is not None:
        progress(duration_s, 0)
    return Result(rows, (EMPTY,) * len(record), {"engine": "fake"})


def stopped_in_call(
    number: int, error: type[BaseException] = KeyboardInterrupt
) -> Callable[..., Result]:
    """`simulate`, but an error ends its call of that number, counted from 1, and later ones."""
    return stopping(number - 1, simulate, error)


def fill(path: Path, data: dict[str, Any]) -> None:
    """Fill a store with fake scores."""
    with mock.patch.dict(vars(taichi_nmm), simulate=simulate):
        precompute(read_specification(Table(data)), path)


def write_plain_store(path: Path, samples: int = 200) -> None:
    """A store of fake scores on level ground alone."""
    fill(path, {"samples": samples, "seed": 3})


def write_store(path: Path, **changes: Any) -> None:
    """A store of fake scores with families."""
    settings = {
        "settings": 1,
        "min_survival_s": 1.0,
        "terrain": {"kind": "rough", "amplitude_m": 0.08},
        "body": {"disturbance": 0.15},
    }
    families = {name: settings | {"seed": seed} for seed, name in enumerate(KINDS)}
    for name in KINDS:
        families[f"{name}_long"] = settings | {
            "after": name,
            "min_survived_fraction": 0.5,
        }
    data = {"samples": STORE_ROWS, "seed": 3, "robust": settings, "families": families}
    fill(path, data | changes)


CONFIG = """
name = "toy"
seed = 5
runs = 3
trials = 8
arms = ["random", "dog", "ranking"]
{top}
objective.cost = "smooth"
simulation.duration_s = 20.0
body.disturbance = 0.15
terrain.kind = "rough"
stores = {{flat = "{store}", worlds = "{store}", stairs = "{store}"}}
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
