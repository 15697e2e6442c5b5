"""The posterior along one feature: at its distinct values, or at nodes.

Between nodes everything is all but straight.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.sampler.points import Points
from study.sampler.posterior import Posterior

Floats = NDArray[np.float64]

# A squared exponential bends by 1 / (8 x 100^2) = 1.3e-5 of its height between two nodes.
NODES_A_LENGTH = 100


@dataclass(frozen=True, eq=False)
class Shared:
    """Few points that stand for the many candidates of one feature.

    Attributes:
        points: distinct features, or nodes.
        values: the distinct features of the candidates, ascending.
        place: which of them each candidate has, [m].
    """

    points: Points
    values: Floats
    place: NDArray[np.int64]

    @classmethod
    def of(cls, posterior: Posterior, points: Points) -> "Shared":
        """For m candidates; nodes only where the posterior may be approximate."""
        values, place = points.distinct
        nodes = _nodes(posterior, values) if posterior.fast else values
        return cls(Points(nodes[:, None], np.empty((len(nodes), 0))), values, place)

    def spread(self, computed: Floats) -> Floats:
        """What was computed at the points, at all candidates, [m]."""
        nodes = self.points.features[:, 0]
        if len(nodes) != len(self.values):
            computed = np.interp(self.values, nodes, computed)
        return computed[self.place]


def _nodes(posterior: Posterior, values: Floats) -> Floats:
    """Evenly spaced values, or the values themselves if they are fewer."""
    length = posterior.kernel.shortest
    span = float(values[-1] - values[0])
    count = int(min(np.ceil(span / length * NODES_A_LENGTH), len(values))) + 1
    return values if count >= len(values) else np.linspace(values[0], values[-1], count)
