"""What a feature-kernel sampler can be told, checked when it is made."""

from collections.abc import Mapping
from dataclasses import dataclass

from optuna.distributions import BaseDistribution

from taichi_nmm.errors import InputError

KERNELS = ("rbf", "rbf_ard", "matern_ard", "euclidean", "sum", "product", "alternate")
MEANS = ("constant", "linear")
ACQUISITIONS = ("ei", "log_ei", "ucb", "thompson")
COST_TRANSFORMS = ("none", "rank", "log")
CONSTRAINTS = "constraints"  # of `feasibility`: what `trial.set_constraint` was told


@dataclass(frozen=True)
class Options:
    """The options of `FeatureKernelSampler`, where they are explained."""

    kernel: str
    mean: str
    acquisition: str
    exploration: float
    prior: str | None
    prior_weight: float
    mismatch: str | None
    feasibility: str | None
    cost_transform: str
    off_grid: int
    n_candidates: int
    n_startup_trials: int
    refit_every: int
    fast: bool
    strict: bool
    extra_parameters: frozenset[str]
    nearest: float | None
    space: Mapping[str, BaseDistribution] | None

    def __post_init__(self) -> None:
        """Refuse what no sampler can do."""
        _one_of("kernel", self.kernel, KERNELS)
        _one_of("mean", self.mean, MEANS)
        _one_of("acquisition", self.acquisition, ACQUISITIONS)
        _one_of("cost_transform", self.cost_transform, COST_TRANSFORMS)
        for name, low in (("n_startup_trials", 1), ("refit_every", 1), ("n_candidates", 1)):
            _at_least(name, getattr(self, name), low)
        for name in ("off_grid", "prior_weight", "exploration"):
            _at_least(name, getattr(self, name), 0)
        if self.nearest is not None:
            _at_least("nearest", self.nearest, 0)

    @property
    def uses_features(self) -> bool:
        """Whether likeness of features counts at all."""
        return self.kernel != "euclidean" or self.mean == "linear"


def _one_of(name: str, value: object, allowed: tuple[str, ...]) -> None:
    """Refuse a value that is none of those allowed."""
    if value not in allowed:
        raise InputError(name, value, f"one of {', '.join(allowed)}")


def _at_least(name: str, value: float, low: int) -> None:
    """Refuse a number below `low`, and NaN."""
    if not value >= low:
        raise InputError(name, value, f"{low} or more")
