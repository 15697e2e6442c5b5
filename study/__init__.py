"""Studies of expensive things in Optuna: feature-kernel samplers, and experiments with the walker.

Importing this package imports neither Taichi nor matplotlib, and the names below when
first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from study.neighbours import require_neighbours

if TYPE_CHECKING:
    from storage.inputs.errors import InputError
    from study.bench.bench import Bench
    from study.experiment.features import world_table, worlds_function
    from study.sampler.forecast import Forecast, forecast
    from study.sampler.policy import TableExhaustedError
    from study.sampler.prediction import Best, Prediction
    from study.sampler.sampler import DoGSampler, FeatureKernelSampler
    from study.sampler.table import FeatureTable

__all__ = [
    "Bench",
    "Best",
    "DoGSampler",
    "FeatureKernelSampler",
    "FeatureTable",
    "Forecast",
    "InputError",
    "Prediction",
    "TableExhaustedError",
    "forecast",
    "world_table",
    "worlds_function",
]

_PLACES = {
    "storage.inputs.errors": ("InputError",),
    "study.bench.bench": ("Bench",),
    "study.experiment.features": ("world_table", "worlds_function"),
    "study.sampler.forecast": ("Forecast", "forecast"),
    "study.sampler.prediction": ("Best", "Prediction"),
    "study.sampler.sampler": ("DoGSampler", "FeatureKernelSampler"),
    "study.sampler.table": ("FeatureTable",),
    "study.sampler.policy": ("TableExhaustedError",),
}
_MODULES = {name: module for module, names in _PLACES.items() for name in names}

require_neighbours("storage")


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*globals(), *__all__])
