"""A robot of somebody else's in MuJoCo: a trunk on the ground with a leg, and its controller."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from optuna.distributions import FloatDistribution, IntDistribution

from storage.mujoco_simulator import MujocoSimulator, SensedState
from tests.cases import ASSETS

XML = (ASSETS / "rail.xml").read_text()
PARAMETERS = {
    "kp": FloatDistribution(0.1, 3.0, log=True),
    "beats": IntDistribution(1, 4),
}


def swing(point: Mapping[str, Any], sensed: SensedState, memory: dict[str, Any]) -> Any:
    """The leg follows a sine, late by one call, and keeps the trunk up."""
    aim = 0.5 * np.sin(point["beats"] * 4.0 * sensed.time_s)
    before = memory.get("aim", np.zeros(len(aim)))
    memory["aim"] = aim
    torque = point["kp"] * (before - sensed.sensors["hip"]) - 0.1 * sensed.qvel[:, 3]
    return (torque + 0.3 * sensed.pitch_rad)[:, None]


def made(text: str = XML, **changes: Any) -> MujocoSimulator:
    """The simulator of a model, which is a text."""
    return MujocoSimulator(
        Model(text),
        swing,
        **{"parameters": PARAMETERS, "control_step_s": 0.01} | changes,
    )


class Model:
    """A function that pickles, and returns the model of a text with its files."""

    def __init__(self, text: str, files: dict[str, bytes] | None = None) -> None:
        self.text, self.files, self.__name__ = text, files or {}, "rail"

    def __call__(self) -> Any:
        """The model."""
        import mujoco

        return mujoco.MjSpec.from_string(self.text, assets=self.files)


Rail = made()
