"""MuJoCo as the engine of a walk: its bodies, contacts and joint limits under our controller.

`mjcf` makes the model: links, feet, limits, motors, and the ground of a file; `engine`
puts planes under the soles and advances a batch. Both need the package mujoco, an
extra.
"""

from importlib.util import find_spec

from storage.inputs.errors import InputError


def require_mujoco() -> None:
    """Refuse an environment without MuJoCo.

    Raises:
        InputError: the package is not there, or is older than its `mujoco.batch`.
    """
    if find_spec("mujoco") is None or find_spec("mujoco.batch") is None:
        allowed = (
            "an environment with mujoco 4.0 or newer: pip install 'taichi-nmm[mujoco]'"
        )
        raise InputError("simulation.engine", "mujoco", allowed)
