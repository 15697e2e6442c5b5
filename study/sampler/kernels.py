"""Kernels over features, over parameters, and over both; each with priors on its constants.

A candidate is a row [k + e]: k features in standard units, then e coordinates in the unit cube of
the parameters. Costs are in standard units too.

| constant | unit | prior on its logarithm: normal around | sd |
|---|---|---|---|
| s^2, signal variance | cost^2 | log 1 | 1.5 |
| l, length scale of a feature | feature | log sqrt k | 1 |
| l, length scale of a parameter | its range | sqrt 2 + (log d) / 2 - 3 | sqrt 3 |
| noise of alike features | cost^2 | log 0.1 | 1.5 |
| noise over parameters | cost^2 | -5 | 1 |

Length scales of parameters follow Hvarfner, Hellsten, Nardi 2024 ("Vanilla Bayesian optimization
performs great in high dimensions"): log-normal with mu = sqrt 2 + (log d) / 2, sigma = sqrt 3, so
that the complexity assumed does not grow with d. A log-normal density of l is, as a function of
log l and up to a factor, a normal density around mu - sigma^2; so is BoTorch's log-normal(-4, 1) of
the noise around -5.

Parameter sets with the same features differ in cost, and no repetition would show it: over features
alone, noise is that spread, and is expected to be large.
"""

from dataclasses import dataclass
from math import exp, log, sqrt

from study.sampler.covariance import Covariance
from study.sampler.means import linear_mean
from study.sampler.parts import Constant
from study.sampler.stationary import RBF, Matern
from study.sampler.terms import Prior, Term

# Initial value and bounds; the bounds keep 32-bit arithmetic right.
SIGNAL_BOUNDS = (1e-2, 1e2)
FEATURE_SCALE_BOUNDS = (5e-2, 5e1)
PARAMETER_SCALE_BOUNDS = (5e-2, 1e2)
NOISE_BOUNDS = (1e-4, 1e1)

SIGNAL_PRIOR = Prior(0.0, 1.5)
FEATURE_NOISE_PRIOR = Prior(log(0.1), 1.5)
PARAMETER_NOISE_PRIOR = Prior(-5.0, 1.0)  # log-normal(-4, 1)


@dataclass(frozen=True)
class Layout:
    """Which columns of a candidate are what: k features, then e coordinates of d parameters."""

    features: int
    coordinates: int
    parameters: int


def new_covariance(kernel: str, mean: str, layout: Layout) -> Covariance:
    """The whole covariance by its names in `study.sampler.options`, before learning.

    Args:
        kernel: one of `options.KERNELS` but "alternate", which is two of them by turns.
        mean: "constant" or "linear".
        layout: of the candidates.
    """
    term = _signal_term(kernel, layout)
    if mean == "linear":
        term = term + linear_mean(layout.features)
    noise = FEATURE_NOISE_PRIOR if feature_only(kernel) else PARAMETER_NOISE_PRIOR
    start = _start(noise, NOISE_BOUNDS)
    return Covariance(term.kernel, start, NOISE_BOUNDS, (*term.priors, noise))


def feature_only(kernel: str) -> bool:
    """Whether candidates of equal features are all the same to this kernel."""
    return kernel in ("rbf", "rbf_ard", "matern_ard")


def mismatch_covariance(layout: Layout) -> Covariance:
    """Of simulated minus shown features: smooth over the parameters."""
    return new_covariance("euclidean", "constant", layout)


def _signal_term(kernel: str, layout: Layout) -> Term:
    """The covariance without mean and noise."""
    if feature_only(kernel):
        return _signal() * _over_features(kernel, layout)
    if kernel == "euclidean":
        return _signal() * _over_parameters(layout)
    features, parameters = _over_features("rbf_ard", layout), _over_parameters(layout)
    if kernel == "product":
        return _signal() * features * parameters
    return _signal() * features + _signal() * parameters


def _signal() -> Term:
    """The variance s^2."""
    return Term(Constant(1.0, SIGNAL_BOUNDS), (SIGNAL_PRIOR,))


def _over_features(kernel: str, layout: Layout) -> Term:
    """The kernel of the first k columns."""
    count = 1 if kernel == "rbf" else layout.features
    scales = (sqrt(layout.features),) * count
    kind = Matern if kernel == "matern_ard" else RBF
    inner = kind(scales, FEATURE_SCALE_BOUNDS, slice(0, layout.features))
    return Term(inner, (Prior(log(sqrt(layout.features)), 1.0),) * count)


def _over_parameters(layout: Layout) -> Term:
    """The squared exponential of the last e columns."""
    prior = Prior(sqrt(2.0) + log(layout.parameters) / 2.0 - 3.0, sqrt(3.0))
    count = layout.coordinates
    scales = (_start(prior, PARAMETER_SCALE_BOUNDS),) * count
    columns = slice(layout.features, layout.features + count)
    return Term(RBF(scales, PARAMETER_SCALE_BOUNDS, columns), (prior,) * count)


def _start(prior: Prior, bounds: tuple[float, float]) -> float:
    """The likeliest value of a constant before any trial, within its bounds."""
    return min(max(exp(prior.mode), bounds[0]), bounds[1])
