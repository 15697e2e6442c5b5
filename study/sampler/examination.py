"""What a sampler's features are worth, from what it knows at present.

The error of a model is compared with that of a constant and, where the model looks at parameters
too, with that of the same model blind to the features. The gain is the difference of the absolute
leave-one-out errors, averaged over the trials; its standard error follows from how it differs from
trial to trial, as Vehtari, Gelman, Gabry 2017 ("Practical Bayesian model evaluation using
leave-one-out cross-validation and WAIC", section 5.1) have it for log densities.
"""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from study.sampler.leave_one_out import residuals, residuals_of_constant, rms
from study.sampler.present import Present
from study.sampler.rank_correlation import RankCorrelation
from study.sampler.weights import weights_of
from study.sampler.worth import LEAST_TRIALS, Errors, Worth

Floats = NDArray[np.float64]


def worth_of(present: Present | None, *, maximised: bool) -> Worth:
    """The worth of features.

    Args:
        present: of the sampler; None: nothing is known.
        maximised: the study's values are.
    """
    if present is None or not len(present.cost):
        names = () if present is None else present.names
        return Worth(0, names, (None,) * len(names), None, None, False, maximised)
    enough = len(present.cost) >= LEAST_TRIALS
    count = len(present.names)
    return Worth(
        len(present.cost),
        present.names,
        tuple(RankCorrelation.of(feature, present.cost) for feature in present.features.T),
        weights_of(present.model, present.candidates, present.owners, count) if enough else None,
        _errors(present) if enough else None,
        present.is_doubted,
        maximised,
    )


def _errors(present: Present) -> Errors | None:
    """Of the model, as a share of the constant's; None where all trials cost the same."""
    cost = present.model.cost()
    constant = residuals_of_constant(cost)
    unit = rms(constant)
    if unit <= 1e-12 * float(np.abs(cost).max()):
        return None
    with_features, other, without = residuals(present.model.posterior), constant, None
    if present.blind is not None:
        blind = residuals(present.blind.posterior)
        without = rms(blind) / unit
        other = blind if without < 1.0 else constant
    return Errors(rms(with_features) / unit, without, _gain(with_features, other))


def _gain(ours: Floats, others: Floats) -> float:
    """Mean difference of the sizes of errors [n], in its standard errors."""
    less = np.abs(others) - np.abs(ours)
    spread = float(less.std(ddof=1)) / sqrt(len(less))
    return float(less.mean()) / spread if spread > 0 else 0.0
