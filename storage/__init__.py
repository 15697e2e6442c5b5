"""The Parquet store of gait scores, and Optuna's study databases.

Importing this package loads neither Taichi nor Optuna, and Arrow when a name below is first used;
`storage.precompute` fills a store, `storage.databases` has the databases, and `storage.pool`
spreads work over processes.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from storage.store import Store, merge, open_store

__all__ = ["Store", "merge", "open_store"]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("storage.store"), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*globals(), *__all__])
