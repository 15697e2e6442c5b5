"""taichi-nmm: thousands of neuromuscular bipeds at once.

Importing the package is cheap: Taichi is imported when a simulation is first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from taichi_nmm.body import Bodies
from taichi_nmm.cost import smooth_cost, walking_cost
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import (
    GAIN_NAMES,
    GAINS,
    K_T,
    LOW_LEVEL_GAINS,
    load_all_gains,
    load_gains,
)
from taichi_nmm.result import END_REASONS, Result, Trajectory
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import Terrain
from taichi_nmm.world import WorldRanges, Worlds

if TYPE_CHECKING:
    from taichi_nmm.controller import Controller, Muscles
    from taichi_nmm.forward import forward_dynamics
    from taichi_nmm.sensed import Sensed
    from taichi_nmm.simulator import simulate

__version__ = "0.2.0"

__all__ = [
    "END_REASONS",
    "GAINS",
    "GAIN_NAMES",
    "K_T",
    "LOW_LEVEL_GAINS",
    "Bodies",
    "Controller",
    "InputError",
    "Muscles",
    "Result",
    "Sensed",
    "Settings",
    "Terrain",
    "Trajectory",
    "WorldRanges",
    "Worlds",
    "forward_dynamics",
    "load_all_gains",
    "load_gains",
    "simulate",
    "smooth_cost",
    "walking_cost",
]

_NEEDS_TAICHI = {
    "Controller": "taichi_nmm.controller",
    "Muscles": "taichi_nmm.controller",
    "Sensed": "taichi_nmm.sensed",
    "forward_dynamics": "taichi_nmm.forward",
    "simulate": "taichi_nmm.simulator",
}


def __getattr__(name: str) -> Any:
    if name in _NEEDS_TAICHI:
        return getattr(import_module(_NEEDS_TAICHI[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
