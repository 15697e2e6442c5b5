"""A robot of somebody else's in MuJoCo: a trunk on the ground with a leg, and its controller."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from optuna.distributions import FloatDistribution, IntDistribution

from storage.mujoco_simulator import MujocoSimulator, SensedState

XML = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="trunk" pos="0 0 0.5">
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
      <joint name="pitch" type="hinge" axis="0 1 0" damping="0.5" armature="0.1"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.05" mass="3"/>
      <body name="leg">
        <joint name="hip" type="hinge" axis="0 1 0" damping="0.2"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.44" size="0.05" mass="1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="hip" gear="20"/></actuator>
  <sensor><jointpos name="hip" joint="hip"/></sensor>
</mujoco>
"""
PARAMETERS = {"kp": FloatDistribution(0.1, 3.0, log=True), "beats": IntDistribution(1, 4)}


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
        Model(text), swing, **{"parameters": PARAMETERS, "control_step_s": 0.01} | changes
    )


class Model:
    """A function that pickles, and returns the model of a text."""

    def __init__(self, text: str) -> None:
        self.text, self.__name__ = text, "rail"

    def __call__(self) -> Any:
        """The model."""
        import mujoco

        return mujoco.MjSpec.from_string(self.text)


Rail = made()
