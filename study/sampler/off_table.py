"""Trials whose parameters are no row of the table: which features they are taken to have."""

import numpy as np
from numpy.typing import NDArray
from optuna.trial import FrozenTrial

from study.sampler.history import OFF_TABLE, noted_features
from study.sampler.nearest_row import NearestRow
from study.sampler.options import Options
from study.sampler.rows import Rows
from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]

IGNORED = "trials whose parameters are no row of the table are ignored"


class OffTable:
    """What a sampler was told of them.

    Args:
        options: of the sampler.
        function: whether the features of any point can be computed.

    Raises:
        InputError: the nearest row is to lend its features where they can be computed.
    """

    def __init__(self, options: Options, function: bool) -> None:
        if options.nearest is not None and function:
            allowed = "none with a feature_function, which knows the features of any point"
            raise InputError("nearest", options.nearest, allowed)
        self._limit = options.nearest
        self._own = function or not options.uses_features
        self._nearest: NearestRow | None = None

    def __getstate__(self) -> dict[str, object]:
        """Without distances, which follow from the table."""
        return self.__dict__ | {"_nearest": None}

    @property
    def may_teach(self) -> bool:
        """Whether anything can be learned from such trials."""
        return self._own or self._limit is not None

    def features_of(self, rows: Rows, trial: FrozenTrial, parameters: Floats) -> int | None:
        """The row that lends its features to a trial of parameters [d].

        OFF_TABLE: it has its own, or none are needed. None: it cannot be learned from.
        """
        if self._own or noted_features(trial) is not None:
            return OFF_TABLE
        if self._limit is None:
            return None
        row, distance = self._nearest_row(rows, parameters)
        return row if distance <= self._limit else None

    def ignored(self, rows: Rows, trial: FrozenTrial) -> str:
        """A warning that such a trial was left out, with what can be done about it."""
        parameters, far = rows.space.row(trial.params), ""
        if parameters is not None:
            far = f", {self._nearest_row(rows, parameters)[1]:.2g} from its nearest row"
        return (
            f"{IGNORED}: such as trial {trial.number}{far}; enqueue rows of the table instead, or "
            "give the sampler a feature_function, or nearest=, the distance at which a row lends "
            "its features"
        )

    def _nearest_row(self, rows: Rows, parameters: Floats) -> tuple[int, float]:
        """The nearest row of a point [d], and its distance."""
        if self._nearest is None or self._nearest.rows is not rows:
            self._nearest = NearestRow(rows)
        return self._nearest.of(parameters)
