"""What decides an experiment's trials, as JSON values; and the machine that ran them."""

import hashlib
import os
import platform
from collections.abc import Iterable
from importlib.metadata import version
from typing import Any

import numpy as np

from storage.document import FORMAT
from study.comparison.arms import Arm
from study.comparison.experiment import Experiment
from study.comparison.stores import store_digest, store_path
from taichi_nmm import __version__

PACKAGES = ("taichi", "optuna", "cma", "cmaes", "numpy", "scipy", "scikit-learn")
DIGEST_DECIMALS = 9  # nanometres: below what another machine's last bit can change


def document(experiment: Experiment, arms: Iterable[Arm]) -> dict[str, Any]:
    """What is compared on what. Runs and trials may grow, so they are no part of it.

    Arms and stores are those of one call; the folder gathers them. The architecture is no part of
    it either: what was begun on one machine may go on on another.
    """
    simulation = experiment.settings
    ground = experiment.terrain(0)
    by_name = sorted(arms, key=lambda arm: arm.name)
    stores = sorted({arm.store for arm in by_name if arm.store})
    return {
        "format": FORMAT,
        "versions": {"taichi-nmm": __version__} | {name: version(name) for name in PACKAGES},
        "name": experiment.name,
        "seed": experiment.seed,
        "searched": list(experiment.searched),
        "objective": {"cost": experiment.cost},
        "simulation": {
            "duration_s": experiment.duration_s,
            "physics_step_s": simulation.physics_step_s,
            "contact_relaxation_speed_mps": simulation.contact_relaxation_speed_mps,
            "precision": simulation.precision,
        },
        "body": {"disturbance": experiment.disturbance},
        "terrain": {"name": ground.name, "sha256": _digest(ground.height_m)},
        "parameters": {p.name: [float(p.low), float(p.high)] for p in experiment.parameters},
        "arms": {arm.name: arm.definition for arm in by_name},
        "stores": {key: store_digest(store_path(experiment, key)) for key in stores},
    }


def machine() -> dict[str, Any]:
    """What the trials were run on."""
    return {
        "system": platform.system(),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
    }


def _digest(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    """SHA-256 of the first run's ground; adding zero turns -0.0 into 0.0."""
    return hashlib.sha256((np.round(values, DIGEST_DECIMALS) + 0.0).tobytes()).hexdigest()
