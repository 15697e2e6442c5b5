"""A trial: one walker, one body, one ground, 100 s; its cost, and what a reader wants to know."""

from dataclasses import dataclass

import numpy as np
import optuna
from numpy.typing import NDArray

import taichi_nmm
from study.config import StudyConfig
from taichi_nmm.parameters import GAIN_NAMES, GAINS
from taichi_nmm.result import Result

COST_FUNCTIONS = {"smooth": taichi_nmm.smooth_cost, "walking": taichi_nmm.walking_cost}


@dataclass(frozen=True, eq=False)
class WalkObjective:
    """The cost of the 16 gains of a trial on the body and ground of a configuration.

    Sets the user attributes `duration_s`, `distance_m`, `mean_speed_mps` and `end_reason`. A fall
    is a finite cost; so is a walker that diverges.
    """

    config: StudyConfig

    def __call__(self, trial: optuna.Trial) -> float:
        """Suggest, simulate, report."""
        result = simulate_gains(self.config, suggest_gains(trial))
        for name in ("duration_s", "distance_m", "mean_speed_mps"):
            trial.set_user_attr(name, float(result[name][0]))
        trial.set_user_attr("end_reason", str(result.end_reason[0]))
        return float(COST_FUNCTIONS[self.config.cost](result.rows)[0])


def suggest_gains(trial: optuna.Trial) -> NDArray[np.float64]:
    """The 16 gains by name, within the bounds of the parameter table, [16]."""
    return np.array([trial.suggest_float(gain.name, gain.low, gain.high) for gain in GAINS])


def trial_gains(trial: optuna.trial.FrozenTrial) -> NDArray[np.float64]:
    """The 16 gains of a finished trial, [16]."""
    return np.array([trial.params[name] for name in GAIN_NAMES])


def simulate_gains(
    config: StudyConfig, gains: NDArray[np.float64], *, record: bool = False
) -> Result:
    """The walker of these gains, [16], on the body and ground of a configuration."""
    return taichi_nmm.simulate(
        gains,
        duration_s=config.duration_s,
        bodies=config.bodies,
        terrains=config.terrain,
        settings=config.settings,
        record=(0,) if record else (),
    )
