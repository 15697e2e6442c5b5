"""Features of points off the store's grid: simulated as the store's rows were."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from storage.searched import searched_parameters, split_points
from storage.store import open_store
from study.experiment.experiment import Experiment
from study.experiment.stores import store_path
from taichi_nmm.body import Bodies
from taichi_nmm.conditions import read_settings
from taichi_nmm.config import Table
from taichi_nmm.errors import InputError
from taichi_nmm.result import RESULT_DTYPE

Floats = NDArray[np.float64]


class StoreFeatures:
    """The features that a store's base setting gives to any gains.

    Args:
        experiment: whose store it is, and on whose engine the gains walk: another one would be
            started anew for each trial.
        store: key of the store, whose base setting is level ground and the undisturbed body.
        features: columns of the base setting.

    Raises:
        InputError: another base setting, or a feature that is not of it.
    """

    def __init__(self, experiment: Experiment, store: str, features: tuple[str, ...]) -> None:
        """Read the store's settings; nothing is simulated yet."""
        path = store_path(experiment, store)
        known = RESULT_DTYPE.names or ()
        for name in features:
            if name not in known:
                raise InputError("feature", name, f"one of {', '.join(known)}")
        specification = open_store(path).specification
        ground = specification["terrain"]["name"]
        disturbance = specification["body"]["disturbance"]
        if ground != "flat" or disturbance != 0.0:
            allowed = "a store whose base setting is level ground and the undisturbed body"
            raise InputError("store", str(path), allowed)
        self._features = features
        self._searched = searched_parameters(experiment.searched)
        simulation = dict(specification["simulation"])
        self._duration_s = float(simulation.pop("duration_s"))
        ours = experiment.conditions.settings
        self._settings = replace(read_settings(Table(simulation), ours.arch), threads=ours.threads)

    def __call__(self, gains: Floats) -> Floats:
        """Features [n, k] of gains [n, 16 + s]."""
        import taichi_nmm

        own, low_level = split_points(gains, self._searched)
        result = taichi_nmm.simulate(
            own,
            duration_s=self._duration_s,
            bodies=Bodies.nominal(),
            low_level_gains=low_level if self._searched else None,
            settings=self._settings,
        )
        return np.column_stack([result[name].astype(np.float64) for name in self._features])
