"""Studies of expensive things in Optuna: feature-kernel samplers, and experiments with the walker.

Importing this package imports neither Taichi nor matplotlib, and the names below when
first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from taichi_nmm.neighbours import require_neighbours

if TYPE_CHECKING:
    from study.experiment.features import world_table
    from study.sampler.sampler import DoGSampler, FeatureKernelSampler
    from study.sampler.table import FeatureTable

__all__ = ["DoGSampler", "FeatureKernelSampler", "FeatureTable", "world_table"]

_MODULES = {
    "DoGSampler": "study.sampler.sampler",
    "FeatureKernelSampler": "study.sampler.sampler",
    "FeatureTable": "study.sampler.table",
    "world_table": "study.experiment.features",
}

require_neighbours("storage")


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*globals(), *__all__])
