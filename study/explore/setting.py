"""Where a gait walks: ground, body, world and engine, and the configuration that says so."""

import json
from dataclasses import dataclass
from typing import Any

from study.experiment.experiment import Experiment, as_written, experiment_of
from taichi_nmm.config import Table

GROUNDS: dict[str, dict[str, Any]] = {
    "flat": {"kind": "flat"},
    "rough, 4 cm a metre": {"kind": "rough", "amplitude_m": 0.04},
    "rough, 8 cm a metre": {"kind": "rough", "amplitude_m": 0.08},
    "blocks of 8 cm, risers of 25 cm": {"kind": "blocks", "amplitude_m": 0.08, "riser_m": 0.25},
    "blocks of 8 cm, risers of 10 cm": {"kind": "blocks", "amplitude_m": 0.08, "riser_m": 0.10},
    "ramp up to 10 %": {"kind": "ramp", "direction": "up", "largest_slope": 0.10},
    "ramp up to 20 %": {"kind": "ramp", "direction": "up", "largest_slope": 0.20},
    "ramp down to 20 %": {"kind": "ramp", "direction": "down", "largest_slope": 0.20},
    "stairs up, 8 cm a step": {"kind": "stairs", "rise_m": 0.08, "run_m": 1.0},
    "stairs up, 10 cm a step": {"kind": "stairs", "rise_m": 0.10, "run_m": 1.0},
    "stairs down, 10 cm a step": {
        "kind": "stairs", "rise_m": 0.10, "run_m": 1.0, "direction": "down",
    },
}  # fmt: skip
WORLDS: dict[str, dict[str, list[float]]] = {
    "nominal": {},
    "slippery: friction 0.5": {"friction": [0.5, 0.5]},
    "weak: muscles at 80 %": {"strength": [0.8, 0.8]},
    "slow and noisy nerves": {"nerve_lag_s": [0.005, 0.005], "sensing_noise": [0.01, 0.01]},
    "drawn by the seed": {
        "friction": [0.6, 1.0], "strength": [0.9, 1.1], "nerve_lag_s": [0.0, 0.005],
        "sensing_noise": [0.0, 0.01],
    },
}  # fmt: skip
DISTURBANCES = {"nominal": 0.0, "within 15 %": 0.15, "within 25 %": 0.25}
DURATIONS_S = (5.0, 10.0, 20.0, 100.0)
NAME = "walk"  # of the configuration


@dataclass(frozen=True)
class Setting:
    """One run of an experiment: a robot on its ground.

    Attributes:
        experiment: whose.
        run: its number.
    """

    experiment: Experiment
    run: int = 0

    def toml(self) -> str:
        """The configuration that every command takes for it."""
        runs = max(self.experiment.runs, self.run + 1)
        return to_toml({"runs": runs, **as_written(self.experiment)})


def chosen_setting(
    ground: str, disturbance: str, seed: int, world: str, engine: str, duration_s: float
) -> Setting:
    """What was chosen on the page, by the names above.

    Raises:
        InputError: a seed out of its bounds.
    """
    tables = {
        "seed": seed,
        "simulation": {"duration_s": duration_s, "engine": engine},
        "body": {"disturbance": DISTURBANCES[disturbance]},
        "terrain": GROUNDS[ground],
        "world": WORLDS[world],
    }
    return Setting(experiment_of(Table(tables), NAME))


def to_toml(tables: dict[str, Any], name: str = "") -> str:
    """Plain values as TOML, in which they look as in JSON; tables come last."""
    lines = [f"[{name}]"] if name else []
    lines += [f"{key} = {json.dumps(value)}" for key, value in tables.items() if not _is(value)]
    text = "\n".join(lines) + "\n"
    inner = {f"{name}.{key}".lstrip("."): value for key, value in tables.items() if _is(value)}
    return text + "".join("\n" + to_toml(value, key) for key, value in inner.items())


def _is(value: object) -> bool:
    return isinstance(value, dict)
