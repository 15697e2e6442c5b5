"""A cart of somebody else's: a function, and the simulator made of it."""

import math
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from storage import FunctionSimulator
from storage.inputs.config import read_toml
from storage.precompute import precompute
from storage.specification import read_specification

PARAMETERS = {
    "thrust_n": FloatDistribution(0.1, 10.0, log=True),
    "steer": FloatDistribution(-1.0, 1.0),
    "gear": IntDistribution(1, 5),
    "mode": CategoricalDistribution(["slow", "fast"]),
}
WORLDS = {"wind": 0.5, "mass_kg": 1.0}
COLUMNS = ("survived_fraction", "speed_mps")


def drive(
    point: Mapping[str, Any], world: Mapping[str, Any], seconds: float
) -> dict[str, float]:
    """One run."""
    windage = 2.0 if point["mode"] == "fast" else 1.0
    lasted_s = seconds * math.exp(-world["wind"] * abs(point["steer"]) * windage)
    speed_mps = point["thrust_n"] / (world["mass_kg"] * point["gear"])
    return {"survived_fraction": lasted_s / seconds, "speed_mps": speed_mps}


def drive_all(
    point: Mapping[str, Any], world: Mapping[str, Any], seconds: float
) -> dict[str, Any]:
    """The same for many runs at a time."""
    windage = np.where(point["mode"] == "fast", 2.0, 1.0)
    return {
        "survived_fraction": np.exp(-world["wind"] * np.abs(point["steer"]) * windage),
        "speed_mps": point["thrust_n"] / (world["mass_kg"] * point["gear"]),
    }


Cart = FunctionSimulator(
    drive,
    parameters=PARAMETERS,
    worlds=WORLDS,
    columns=COLUMNS,
    measures={"speed_mps": (0, 10)},
)
Carts = FunctionSimulator(
    drive_all, parameters=PARAMETERS, worlds=WORLDS, columns=COLUMNS, batch=True
)


def written_store(folder: Path, module: str, settings: str) -> tuple[Path, Path]:
    """A store of carts, and the configuration that it was computed by.

    Args:
        folder: for both, and for the file of the simulator.
        module: name of this file; another in each test file, since a process imports
            a name once.
        settings: of the configuration, beside the simulator.
    """
    shutil.copy(__file__, folder / f"{module}.py")
    store, config = folder / f"{module}-store", folder / f"{module}.toml"
    config.write_text(f'simulator = "{module}.py:Cart"\n{settings}')
    precompute(read_specification(read_toml(config)), store)
    return store, config
