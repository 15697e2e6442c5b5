"""What the trials of a study say, as numbers for a model."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from optuna.trial import FrozenTrial

from study.sampler.points import Points
from study.sampler.transforms import clip_infinities, squarable

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Evidence:
    """Finished trials, and those that run elsewhere.

    Attributes:
        points: the n finished trials.
        cost: what they showed, lower is better, finite, [n].
        limits: c constraints of each, feasible where <= 0, NaN where unknown, [n, c].
        running: trials of other workers whose parameters are known.
    """

    points: Points
    cost: Floats
    limits: Floats
    running: Points

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Finished trials that kept all their limits, [n]."""
        return np.asarray(~(self.limits > 0).any(axis=1))


def read_limits(trials: Sequence[FrozenTrial]) -> Floats:
    """The constraints of trials, [n, c]: what `trial.set_constraint` or `constraints_func` said."""
    told = [trial.constraints for trial in trials]
    keys = sorted({key for constraints in told for key in constraints})
    limits = [[constraints.get(key, np.nan) for key in keys] for constraints in told]
    columns = np.array(limits, dtype=np.float64).reshape(len(trials), len(keys)).T
    clipped = [squarable(clip_infinities(column)) for column in columns]
    return np.array(clipped).reshape(len(keys), len(trials)).T
