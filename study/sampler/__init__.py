"""The feature-kernel sampler, for any study: it contains nothing about legs.

`sampler` is the contract with Optuna, `table` the rows to choose from; `table_policy` and
`space_policy` make proposals, `policy` is what they have in common; `history` reads the study; `gp`
is the Gaussian process, `acquisition` compares candidates by it, `transforms` puts features and
costs on its scales, and `diagnostics` reports what features are worth.
"""

import sys
import warnings
from importlib import import_module
from types import ModuleType
from typing import Any

# Where names of 0.2.0 are now; their old modules work for one version.
MOVED = {
    "candidate_table": ("CandidateTable", "table", "FeatureTable"),
    "table_source": ("TableExhaustedError", "table_policy", "TableExhaustedError"),
    "worth": ("Worth", "diagnostics", "Worth"),
}


class _Moved(ModuleType):
    """A module of 0.2.0 whose one public name is found in its new place, with a warning."""

    def __getattr__(self, name: str) -> Any:
        old, module, new = MOVED[self.__name__.rpartition(".")[2]]
        if name != old:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        place = f"{__name__}.{module}"
        message = f"{self.__name__}.{old} is {place}.{new} now"
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return getattr(import_module(place), new)


for _name in MOVED:
    sys.modules[f"{__name__}.{_name}"] = _Moved(f"{__name__}.{_name}")
