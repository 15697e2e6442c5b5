"""What a sampler knows of a study's features at present: the trials, and its model of them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from study.sampler.evidence import Evidence
from study.sampler.guess import Guess
from study.sampler.kernels import Kernel
from study.sampler.model import Constants, Model
from study.sampler.points import Points
from study.sampler.trust import is_doubtful

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Present:
    """The finished trials of a study, and what the sampler makes of them.

    Attributes:
        names: of the k features.
        features: of the n trials, in units of their own, NaN where unknown, [n, k].
        seen: the trials as the kernel sees them.
        cost: of each, lower is better, [n].
        candidates: rows that may be proposed, or points anywhere, as the kernel sees them.
        owners: of each column of their features, the number of the feature.
        parameters: d.
        kernel: of the sampler.
        guess: of the user.
        learns_trust: whether the sampler may leave trials to the parameters.
        constants: known so far.
    """

    names: tuple[str, ...]
    features: Floats
    seen: Points
    cost: Floats
    candidates: Points
    owners: tuple[int, ...]
    parameters: int
    kernel: Kernel
    guess: Guess | None
    learns_trust: bool
    constants: Constants

    @cached_property
    def model(self) -> Model:
        """The sampler's, as it is where the features are followed."""
        return self._model(self.seen, self.guess)

    @cached_property
    def blind(self) -> Model | None:
        """The same learned where all have the same features; None: nothing else is looked at.

        Not the one over the parameters alone that the sampler falls back on: that learns no mean,
        and falls behind also where features say nothing at all.
        """
        if not self.kernel.of_parameters:
            return None
        alike = Points(np.zeros_like(self.seen.features), self.seen.coordinates)
        return self._model(alike, None)

    @property
    def is_doubted(self) -> bool:
        """Whether every other trial is left to the parameters at present."""
        told = self.guess is not None
        return self.learns_trust and any(is_doubtful(self.cost, turn, told) for turn in (0, 1))

    def _model(self, seen: Points, guess: Guess | None) -> Model:
        """After the finished trials, whatever others show and whichever limits there are."""
        unknown = np.empty((len(self.cost), 0))
        evidence = Evidence(seen, self.cost, unknown, seen.take(np.arange(0)))
        return Model(self.kernel, guess, self.parameters, evidence, self.constants)
