"""Kernels over features, over parameters, and over both; each with priors on its constants.

A candidate is a row [k + e]: k features in standard units, then e coordinates in the unit cube of
the parameters. Costs are in standard units too.

| constant | unit | prior on its logarithm: normal around | sd |
|---|---|---|---|
| s^2, signal variance | cost^2 | log 1 | 1.5 |
| v, variance of a slope | (cost / feature)^2 | log 0.3 | 1.5 |
| l, length scale of a feature | feature | log sqrt k | 1 |
| l, length scale of parameters | their range | sqrt 2 + (log d) / 2 - 3 | sqrt 3 |
| noise of alike features | cost^2 | log 0.1 | 1.5 |
| noise over parameters | cost^2 | -5 | 1 |

Length scales of parameters follow Hvarfner, Hellsten, Nardi 2024 ("Vanilla Bayesian optimization
performs great in high dimensions"): log-normal with mu = sqrt 2 + (log d) / 2, sigma = sqrt 3, so
that the complexity assumed does not grow with d. A log-normal density of l is, as a function of
log l and up to a factor, a normal density around mu - sigma^2; so is BoTorch's log-normal(-4, 1) of
the noise around -5.

Parameter sets with the same features differ in cost, and no repetition would show it: over
features, noise is that spread, and is expected to be large. Where nothing else tells such sets
apart, it is also a chance that the next one is better (`Model`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from math import exp, log, sqrt

from study.sampler.covariance import Covariance
from study.sampler.parts import Constant, Linear
from study.sampler.stationary import RBF
from study.sampler.terms import Prior, Term

# Bounds; they keep 32-bit arithmetic right.
SIGNAL_BOUNDS = (1e-2, 1e2)
SLOPE_BOUNDS = (1e-4, 1e2)
FEATURE_SCALE_BOUNDS = (5e-2, 5e1)
PARAMETER_SCALE_BOUNDS = (5e-2, 1e2)
NOISE_BOUNDS = (1e-4, 1e1)

SIGNAL_PRIOR = Prior(0.0, 1.5)
SLOPE_PRIOR = Prior(log(0.3), 1.5)
FEATURE_NOISE_PRIOR = Prior(log(0.1), 1.5)
PARAMETER_NOISE_PRIOR = Prior(-5.0, 1.0)  # log-normal(-4, 1)


@dataclass(frozen=True)
class Layout:
    """Which columns of a candidate are what: k features, then e coordinates of d parameters."""

    features: int
    coordinates: int
    parameters: int


@dataclass(frozen=True)
class Kernel:
    """What a kernel's name stands for.

    Attributes:
        terms: that are added up.
        of_features: features are looked at.
        of_parameters: coordinates are looked at; if not, candidates of equal features are the same.
        by_order: features count by their order, costs by their logarithm; else both as they are.
    """

    terms: tuple[Callable[[Layout], Term], ...]
    of_features: bool
    of_parameters: bool
    by_order: bool


def new_covariance(kernel: Kernel, layout: Layout) -> Covariance:
    """The whole covariance before learning, for candidates of this layout."""
    term = reduce(Term.__add__, [new_term(layout) for new_term in kernel.terms])
    noise = FEATURE_NOISE_PRIOR if kernel.of_features else PARAMETER_NOISE_PRIOR
    start = _start(noise, NOISE_BOUNDS)
    return Covariance(term.kernel, start, NOISE_BOUNDS, (*term.priors, noise))


def _slopes(layout: Layout) -> Term:
    """v phi^T phi' over the features: a cost that is linear in them.

    With slopes w ~ N(0, v I) this is the covariance of w^T phi (Rasmussen, Williams 2006, section
    2.7): what the slopes are, and how sure that is, follows from the trials with the rest.
    """
    start = Constant(exp(SLOPE_PRIOR.mode), SLOPE_BOUNDS)
    return Term(start, (SLOPE_PRIOR,)) * Term(Linear(slice(0, layout.features)), ())


def _likeness(layout: Layout) -> Term:
    """A squared exponential of the features, a length scale each."""
    return _signal() * _over_features(layout, layout.features)


def _shared_likeness(layout: Layout) -> Term:
    """A squared exponential of the features, one length scale for all."""
    return _signal() * _over_features(layout, 1)


def _nearness(layout: Layout) -> Term:
    """A squared exponential of the parameters, one length scale for all."""
    return _signal() * _over_parameters(layout, 1)


def _nearness_each(layout: Layout) -> Term:
    """A squared exponential of the parameters, a length scale each."""
    return _signal() * _over_parameters(layout, layout.coordinates)


def _signal() -> Term:
    """The variance s^2."""
    return Term(Constant(1.0, SIGNAL_BOUNDS), (SIGNAL_PRIOR,))


def _over_features(layout: Layout, scales: int) -> Term:
    """The squared exponential of the first k columns."""
    mode = sqrt(layout.features)
    inner = RBF((mode,) * scales, FEATURE_SCALE_BOUNDS, slice(0, layout.features))
    return Term(inner, (Prior(log(mode), 1.0),) * scales)


def _over_parameters(layout: Layout, scales: int) -> Term:
    """The squared exponential of the last e columns."""
    prior = Prior(sqrt(2.0) + log(layout.parameters) / 2.0 - 3.0, sqrt(3.0))
    columns = slice(layout.features, layout.features + layout.coordinates)
    start = _start(prior, PARAMETER_SCALE_BOUNDS)
    return Term(RBF((start,) * scales, PARAMETER_SCALE_BOUNDS, columns), (prior,) * scales)


def _start(prior: Prior, bounds: tuple[float, float]) -> float:
    """The likeliest value of a constant before any trial, within its bounds."""
    return min(max(exp(prior.mode), bounds[0]), bounds[1])


ADDITIVE = Kernel((_slopes, _likeness, _nearness), True, True, by_order=True)
NEARNESS = Kernel((_nearness,), False, True, by_order=True)  # `ADDITIVE` without features
KERNELS = {
    "additive": ADDITIVE,
    "rbf": Kernel((_shared_likeness,), True, False, by_order=False),
    "rbf_ard": Kernel((_likeness,), True, False, by_order=False),
    "euclidean": Kernel((_nearness_each,), False, True, by_order=False),
}
