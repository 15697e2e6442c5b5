"""The posterior along one feature: at its distinct values, or at nodes.

Between nodes everything is all but straight.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.gaussian_process.kernels import Kernel, Product, Sum

from study.sampler.points import Points
from study.sampler.posterior import Posterior
from study.sampler.terms import Slice

Floats = NDArray[np.float64]

NODES_A_LENGTH = (
    100  # a squared exponential bends by 1 / (8 x 100^2) = 1.3e-5 of its height between
)


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


def predict_distinct(posterior: Posterior, points: Points) -> tuple[Floats, Floats]:
    """As `posterior.predict`, of m candidates with one feature, [m] each."""
    shared = Shared.of(posterior, points)
    mean, variance = posterior.predict(shared.points)
    return shared.spread(mean), shared.spread(variance)


def _nodes(posterior: Posterior, values: Floats) -> Floats:
    """Evenly spaced values, or the values themselves if they are fewer."""
    length = _length_scale(posterior.regressor.kernel_)
    span = float(values[-1] - values[0])
    count = int(min(np.ceil(span / length * NODES_A_LENGTH), len(values))) + 1
    return values if count >= len(values) else np.linspace(values[0], values[-1], count)


def _length_scale(kernel: Kernel) -> float:
    """The smallest length scale in a kernel."""
    if isinstance(kernel, Sum | Product):
        return min(_length_scale(kernel.k1), _length_scale(kernel.k2))
    if isinstance(kernel, Slice):
        return _length_scale(kernel.kernel)
    return float(np.min(getattr(kernel, "length_scale", np.inf)))
