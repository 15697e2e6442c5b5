"""Trials of an experiment as one batch: each on the body and the ground of its run."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

import taichi_nmm
from storage.searched import split_points
from study.experiment.experiment import Experiment
from taichi_nmm.body import Bodies
from taichi_nmm.parameters import GAINS
from taichi_nmm.result import Result
from taichi_nmm.world import Worlds


def simulate_trials(
    experiment: Experiment,
    runs: ArrayLike,
    gains: NDArray[np.float64],
    record: bool | Sequence[int] = False,
    *,
    duration_s: float | None = None,
    record_rate_hz: float = 100.0,
) -> Result:
    """Simulate n trials at once.

    Args:
        experiment: whose bodies, grounds and settings.
        runs: of each trial, [n].
        gains: the searched parameters of each, [n, 16 + k], in the order of `experiment.names`.
        record: rows whose trajectory is wanted; True: all of them.
        duration_s: of a trial; None is the experiment's.
        record_rate_hz: samples a second of the trajectories.

    Raises:
        InputError: what `taichi_nmm.simulate` refuses.
    """
    different, index = np.unique(np.asarray(runs, dtype=np.int64), return_inverse=True)
    bodies = [experiment.body(int(run)) for run in different]
    rows = range(len(gains)) if record is True else record or ()
    conditions = experiment.conditions
    own, low_level = split_points(gains, experiment.parameters[len(GAINS) :])
    return taichi_nmm.simulate(
        own,
        duration_s=conditions.duration_s if duration_s is None else duration_s,
        bodies=_stacked(bodies).take(index),
        worlds=Worlds.stacked(experiment.world(int(run)) for run in different).take(index),
        terrains=[experiment.terrain(int(run)) for run in different],
        terrain_index=index.astype(np.int32),
        low_level_gains=low_level if experiment.searched else None,
        settings=conditions.settings,
        record=tuple(rows),
        record_rate_hz=record_rate_hz,
    )


def _stacked(bodies: Sequence[Bodies]) -> Bodies:
    """Several batches of bodies as one."""
    return Bodies(
        np.vstack([body.mass_kg for body in bodies]),
        np.vstack([body.inertia_kgm2 for body in bodies]),
        np.vstack([body.com_m for body in bodies]),
    )
