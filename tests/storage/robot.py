"""A cart of somebody else's: a function, and the simulator made of it."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from storage import FunctionSimulator

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
