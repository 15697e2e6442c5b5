"""A feature taken as a prior: the share of candidates that it thinks no better."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FeaturePrior:
    """Ranks by one feature.

    Attributes:
        column: of the feature.
        sign: 1 where high values are good, -1 where low ones are.
        known: its values at the candidates, signed, in ascending order.
    """

    column: int
    sign: float
    known: Floats

    @classmethod
    def of(cls, name: str, names: tuple[str, ...], features: Floats) -> "FeaturePrior":
        """The prior called `name` (with a minus, its opposite), over features [n, k].

        Raises:
            InputError: there is no such feature.
        """
        sign, bare = (-1.0, name[1:]) if name not in names and name[:1] == "-" else (1.0, name)
        if bare not in names:
            raise InputError("prior", name, f"one of {', '.join(names)}, or one with a minus")
        column = names.index(bare)
        values = sign * features[:, column]
        return cls(column, sign, np.sort(values[np.isfinite(values)]))

    def log_rank(self, features: Floats) -> Floats:
        """log of the share of the known candidates that are no better than these [m, k], [m]."""
        no_better = np.searchsorted(self.known, self.sign * features[:, self.column], side="right")
        return np.asarray(np.log(np.clip(no_better, 1, None) / max(len(self.known), 1)))
