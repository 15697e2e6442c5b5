"""The stores that an experiment's arms read: checked before the work, read once a process."""

import hashlib
from functools import lru_cache
from pathlib import Path

from storage.store import MANIFEST_NAME, Manifest, Store, open_store
from storage.tables import file_hash
from study.experiment.experiment import Experiment, search_space
from study.experiment.features import check_feature, feature_table
from study.sampler.table import FeatureTable
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import Parameter


def candidates(experiment: Experiment, store: str, feature: str) -> FeatureTable:
    """The rows of a store with a feature, for studies of an experiment.

    Raises:
        InputError: the configuration names no such store, or it cannot be read.
    """
    path = store_path(experiment, store)
    written = path / MANIFEST_NAME if path.is_dir() else path
    try:
        written_ns = written.stat().st_mtime_ns
    except OSError:
        written_ns = 0  # opening the store tells what is missing
    return _read(path, written_ns, feature, experiment.parameters, experiment.cost)


@lru_cache(maxsize=16)
def _read(
    path: Path,
    _written_ns: int,
    feature: str,
    parameters: tuple[Parameter, ...],
    cost: str,
) -> FeatureTable:
    return feature_table(open_store(path), feature, search_space(parameters), cost)


def store_path(experiment: Experiment, store: str) -> Path:
    """Where the store of that name is.

    Raises:
        InputError: the configuration does not name it.
    """
    if store not in experiment.stores:
        known = ", ".join(experiment.stores) or "none"
        allowed = f"a folder in the configuration's [stores], which has {known}"
        raise InputError(f"stores.{store}", "missing", allowed)
    return experiment.stores[store]


def check_store(experiment: Experiment, store: str, feature: str) -> Store:
    """Open a store, and see that it has the experiment's parameters and this feature.

    Raises:
        InputError: no such store, not a finished store, other parameters or bounds, or no such
            column.
    """
    opened = open_store(store_path(experiment, store))
    field = f"stores.{store}"
    searched = tuple(opened.specification["gains"])
    if set(searched) != set(experiment.names):
        more = [name for name in searched if name not in experiment.names]
        less = [name for name in experiment.names if name not in searched]
        found = f"{opened.path} {'with' if more else 'without'} {(more or less)[0]}"
        allowed = f"a store of {' and '.join(('the 16 gains', *experiment.searched))}"
        raise InputError(field, found, allowed)
    opened.require_bounds()
    check_feature(feature, opened)
    return opened


def store_digest(path: Path) -> str:
    """SHA-256 of a store's content: of its manifest's hashes, or of the one file that it is."""
    if not path.is_dir():
        return file_hash(path)
    hashes = Manifest.read(path).hashes
    return hashlib.sha256("\n".join(hashes.values()).encode()).hexdigest()
