"""taichi-nmm: thousands of neuromuscular bipeds at once.

Importing the package is cheap: names are loaded when they are first used, and Taichi
with the first simulation.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from storage.inputs.errors import InputError
    from storage.inputs.version import __version__ as __version__
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
    from taichi_nmm.world import (
        Exoskeleton,
        Prosthesis,
        Push,
        Slip,
        WorldRanges,
        Worlds,
    )

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
    "Push",
    "Result",
    "Settings",
    "Slip",
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
    "storage.inputs.errors": ("InputError",),
    "storage.inputs.version": ("__version__",),
    "taichi_nmm.body": ("Bodies",),
    "taichi_nmm.controller": ("Controller", "Muscles"),
    "taichi_nmm.observation": ("Observation",),
    "taichi_nmm.parameters": (
        "GAINS",
        "GAIN_NAMES",
        "PUBLISHED_GAINS",
        "LOW_LEVEL_GAINS",
        "load_all_gains",
        "load_gains",
    ),
    "taichi_nmm.result": (
        "END_REASONS",
        "MUSCLES",
        "Result",
        "Trajectory",
        "smooth_cost",
        "walking_cost",
    ),
    "taichi_nmm.settings": ("Settings",),
    "taichi_nmm.simulator": ("forward_dynamics", "simulate"),
    "taichi_nmm.terrain": ("Terrain",),
    "taichi_nmm.walkers": ("Switch",),
    "taichi_nmm.world": (
        "Exoskeleton",
        "Prosthesis",
        "Push",
        "Slip",
        "WorldRanges",
        "Worlds",
    ),
}
_MODULES = {name: module for module, names in _PLACES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name, or one of the modules, at its first use (PEP 562)."""
    if f"taichi_nmm.{name}" in _PLACES:
        return import_module(f"taichi_nmm.{name}")
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*globals(), *__all__])
