"""The Parquet store of a simulator's scores, and Optuna's study databases.

Importing this package loads neither Taichi nor Optuna, and Arrow when a name below is
first used; `storage.precompute` fills a store, `storage.databases` has the databases,
and `storage.pool` spreads work over processes.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from storage.function_simulator import FunctionSimulator
    from storage.inputs.errors import InputError
    from storage.mujoco_simulator import MujocoSimulator
    from storage.precompute import make_store
    from storage.simulator import Simulator, Uniform
    from storage.store import Store, merge, open_store

__all__ = [
    "FunctionSimulator",
    "InputError",
    "MujocoSimulator",
    "Simulator",
    "Store",
    "Uniform",
    "make_store",
    "merge",
    "open_store",
]

_PLACES = {
    "storage.function_simulator": ("FunctionSimulator",),
    "storage.inputs.errors": ("InputError",),
    "storage.mujoco_simulator": ("MujocoSimulator",),
    "storage.precompute": ("make_store",),
    "storage.simulator": ("Simulator", "Uniform"),
    "storage.store": ("Store", "merge", "open_store"),
}
_MODULES = {name: module for module, names in _PLACES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*globals(), *__all__])
