"""What the user says of a feature: which end of it is good.

Until trials say otherwise, the cost is expected to fall by one standard deviation for each standard
deviation of the feature, and the slope to be uncertain by that of `kernels.SLOPE_PRIOR`: m(x) =
-SLOPE phi(x), in standard units, is the mean of the process (Rasmussen, Williams 2006, section 2.7;
Cully et al. 2015 take a simulated performance for the mean of theirs).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.sampler.points import Points
from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]

SLOPE = 1.0  # of the cost, in its standard deviations, by one of the feature


@dataclass(frozen=True)
class Guess:
    """A ranking of candidates by one feature.

    Attributes:
        column: of the feature.
        sign: 1 where high values are good, -1 where low ones are.
    """

    column: int
    sign: float

    @classmethod
    def of(cls, prior: str, names: tuple[str, ...]) -> "Guess":
        """What the option `prior` says of features with these names.

        Raises:
            InputError: there is no such feature.
        """
        sign, name = (-1.0, prior[1:]) if prior not in names and prior[:1] == "-" else (1.0, prior)
        if name not in names:
            raise InputError("prior", prior, f"one of {', '.join(names)}, or one with a minus")
        return cls(names.index(name), sign)

    def merit(self, features: Floats) -> Floats:
        """How good candidates [m, k] are thought, in the units of the features, [m]."""
        return self.sign * features[:, self.column]

    def cost(self, points: Points) -> Floats:
        """m(x) of points in standard units, [m]."""
        return -SLOPE * self.merit(points.features)
