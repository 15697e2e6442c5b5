"""Where features are simulated and reality differs: a second process learns by how much, and where.

With phi simulated and phi' shown, g(x) = phi(x) - phi'(x) is a Gaussian process over the parameters
x in the unit cube, of mean zero, one for each feature with constants in common. A candidate counts
as phi(x) - E[g(x)]: corrected near the trials that reported what they showed, and left alone far
from them (Rai, Antonova et al. 2018, "Bayesian optimization using domain knowledge on the ATRIAS
biped", section IV-C, there as a kernel).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from optuna.trial import FrozenTrial

from study.sampler.gaussian_process import condition, learn
from study.sampler.kernels import Layout, mismatch_covariance
from study.sampler.points import Points
from study.sampler.posterior import Posterior

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mismatch:
    """How far simulated features are from those shown, as learned from some trials."""

    posterior: Posterior

    @classmethod
    def fit(cls, points: Points, shown: Floats, parameters: int, fast: bool) -> "Mismatch | None":
        """From trials with features as simulated, and as shown [n, k], NaN where not reported.

        Returns None where no trial has reported.
        """
        known = np.isfinite(shown).all(axis=1)
        if not known.any():
            return None
        difference = points.features[known] - shown[known]
        covariance = mismatch_covariance(Layout(0, points.coordinates.shape[1], parameters))
        coordinates = points.coordinates[known]
        theta = learn(covariance, coordinates, difference, center=False)
        posterior = condition(
            covariance, theta, coordinates, difference, center=False, noisy=False, fast=fast
        )
        return cls(posterior)

    def corrected(self, points: Points) -> Points:
        """Points as they are expected to show."""
        elsewhere = Points(points.features[:, :0], points.coordinates)
        return Points(points.features - self.posterior.mean(elsewhere), points.coordinates)


def read_shown(trials: Sequence[FrozenTrial], attribute: str, features: int) -> Floats:
    """What trials report to have shown, [n, k]; NaN where they report nothing of use."""
    shown = np.full((len(trials), features), np.nan)
    for row, trial in enumerate(trials):
        try:
            values = np.atleast_1d(np.array(trial.user_attrs.get(attribute), dtype=np.float64))
        except (TypeError, ValueError):
            continue
        if values.shape == (features,):
            shown[row] = values
    return shown
