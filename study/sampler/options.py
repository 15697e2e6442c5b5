"""What a feature-kernel sampler can be told, checked when it is made."""

from collections.abc import Mapping
from dataclasses import dataclass

from optuna.distributions import BaseDistribution

from study.sampler.gp import ADDITIVE, KERNELS, Kernel
from taichi_nmm.checks import is_number
from taichi_nmm.errors import InputError


@dataclass(frozen=True)
class Options:
    """The options of `FeatureKernelSampler`, where they are explained."""

    kernel: str
    prior: str | None
    off_grid: int
    nearest: float | None
    space: Mapping[str, BaseDistribution] | None
    extra_parameters: frozenset[str]
    strict: bool

    def __post_init__(self) -> None:
        """Refuse what no sampler can do."""
        if self.kernel not in KERNELS:
            raise InputError("kernel", self.kernel, f"one of {', '.join(KERNELS)}")
        if self.nearest is not None and not (is_number(self.nearest) and self.nearest >= 0):
            raise InputError("nearest", self.nearest, "0 or more")

    @property
    def model(self) -> Kernel:
        """What the kernel's name stands for."""
        return KERNELS[self.kernel]

    @property
    def learns_trust(self) -> bool:
        """Whether features are trusted as far as trials bear them out."""
        return self.model is ADDITIVE

    @property
    def uses_features(self) -> bool:
        """Whether features count at all."""
        return self.model.of_features or self.prior is not None
