"""All that decides an experiment's trials, as JSON values; and the machine that ran them.

There is one such document: a comparison's folder, a study database and a live study all keep it, or
its digest, and refuse to go on with another.
"""

import os
import platform
from collections.abc import Iterable
from functools import cache, lru_cache
from importlib.metadata import version
from typing import Any

from storage.tables import FORMAT, document_hash
from study.experiment.arms import Arm
from study.experiment.experiment import Experiment, as_written
from study.experiment.stores import store_digest, store_path
from taichi_nmm import __version__
from taichi_nmm.kernel_cache import COMPILER
from taichi_nmm.walker_simulator import terrain_document

PACKAGES = (COMPILER, "optuna", "cma", "cmaes", "numpy", "scipy")
GROWING = ("arms", "stores")  # parts that later calls add to
FINGERPRINT_LENGTH = 16
LIVE_ATTRIBUTE = "experiment"  # of a live study: its document; of a comparison's: a name


def document(experiment: Experiment, arms: Iterable[Arm]) -> dict[str, Any]:
    """The identity of an experiment. Runs and trials may grow, so they are no part of it.

    Arms and stores are those of one call; a folder gathers them. The architecture is no part of
    it either: what was begun on one machine may go on on another.
    """
    tables = as_written(experiment)
    ground = tables.pop("terrain")
    by_name = sorted(arms, key=lambda arm: arm.name)
    stores = sorted({arm.store for arm in by_name if arm.store})
    return {
        "format": FORMAT,
        "versions": versions(*deciding_packages(experiment)),
        **tables,
        "terrain": terrain_document((experiment.terrain(0),)),
        "ground": ground,
        "parameters": {p.name: [float(p.low), float(p.high)] for p in experiment.parameters},
        "arms": {arm.name: arm.definition for arm in by_name},
        "stores": {key: store_digest(store_path(experiment, key)) for key in stores},
    }


def deciding_packages(experiment: Experiment) -> tuple[str, ...]:
    """Packages whose versions decide an experiment's trials."""
    of_engine = ("mujoco",) if experiment.conditions.settings.engine == "mujoco" else ()
    return *PACKAGES, *of_engine


@cache
def versions(*packages: str) -> dict[str, str]:
    """The versions of this project and of packages that decide results."""
    return {"taichi-nmm": __version__} | {name: version(name) for name in packages}


@lru_cache(maxsize=16)
def fingerprint(experiment: Experiment) -> str:
    """A short digest of all that decides trials but the arms: for databases and file names."""
    return document_hash(document(experiment, ()))[:FINGERPRINT_LENGTH]


def machine() -> dict[str, Any]:
    """The machine that runs the trials."""
    return {
        "system": platform.system(),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
    }
