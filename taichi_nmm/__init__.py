"""taichi-nmm: thousands of neuromuscular bipeds at once.

Importing the package is cheap: names are loaded when they are first used, and Taichi
with the first simulation.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from storage.inputs.errors import InputError
    from taichi_nmm.body import Bodies
    from taichi_nmm.controller import Controller, Muscles
    from taichi_nmm.observation import Observation
    from taichi_nmm.parameters import (
        GAIN_NAMES,
        GAINS,
        LOW_LEVEL_GAINS,
        PUBLISHED_GAINS,
        load_all_gains,
        load_gains,
    )
    from taichi_nmm.result import (
        END_REASONS,
        MUSCLES,
        Result,
        Trajectory,
        smooth_cost,
        walking_cost,
    )
    from taichi_nmm.settings import Settings
    from taichi_nmm.simulator import forward_dynamics, simulate
    from taichi_nmm.terrain import Terrain
    from taichi_nmm.walkers import Switch
    from taichi_nmm.world import Exoskeleton, Prosthesis, WorldRanges, Worlds

__version__ = "0.4.0"

__all__ = [
    "END_REASONS",
    "GAINS",
    "GAIN_NAMES",
    "LOW_LEVEL_GAINS",
    "MUSCLES",
    "PUBLISHED_GAINS",
    "Bodies",
    "Controller",
    "Exoskeleton",
    "InputError",
    "Muscles",
    "Observation",
    "Prosthesis",
    "Result",
    "Settings",
    "Switch",
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

_PLACES = {
    "body": ("Bodies",),
    "controller": ("Controller", "Muscles"),
    "errors": ("InputError",),
    "parameters": (
        "GAINS",
        "GAIN_NAMES",
        "PUBLISHED_GAINS",
        "LOW_LEVEL_GAINS",
        "load_all_gains",
        "load_gains",
    ),
    "result": (
        "END_REASONS",
        "MUSCLES",
        "Result",
        "Trajectory",
        "smooth_cost",
        "walking_cost",
    ),
    "observation": ("Observation",),
    "settings": ("Settings",),
    "simulator": ("forward_dynamics", "simulate"),
    "terrain": ("Terrain",),
    "walkers": ("Switch",),
    "world": ("Exoskeleton", "Prosthesis", "WorldRanges", "Worlds"),
}
_MODULES = {name: module for module, names in _PLACES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name, or one of the modules, at its first use (PEP 562)."""
    if name == "InputError":
        return import_module("storage.inputs.errors").InputError
    if name in _MODULES:
        return getattr(import_module(f"taichi_nmm.{_MODULES[name]}"), name)
    if name in _PLACES:
        return import_module(f"taichi_nmm.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*globals(), *__all__])
