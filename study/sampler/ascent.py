"""Points that climb the utility from where they are, by its derivatives."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
import scipy

from study.sampler.acquisition import Model
from study.sampler.arrays import Floats, Mask
from study.sampler.transforms import Points

STEPS = 60  # at most, of L-BFGS


Pull = Callable[[Floats], Floats]
"""Derivatives by coordinates, [m, e], from a number's derivatives by columns, [m, p]."""


class Chart(Protocol):
    """What the model sees of any point of the unit cube."""

    def placed(self, unit: Floats) -> tuple[Points, Pull]:
        """Points at coordinates [m, e], and what pulls derivatives back to these."""


class Plain:
    """A chart of coordinates alone."""

    def placed(self, unit: Floats) -> tuple[Points, Pull]:
        """See `Chart`."""
        return Points(np.empty((len(unit), 0)), unit), lambda slopes: slopes


def climbed(
    model: Model, chart: Chart, starts: Floats, movable: Mask, steps: int = STEPS
) -> Floats:
    """Where points of the unit cube come to that climb the utility, [s, e].

    All climb at once, as in BoTorch: the sum of their utilities is maximised, each of
    which depends on its own point.

    Args:
        model: of the trial.
        chart: what it sees of a point.
        starts: [s, e].
        movable: coordinates that may change, [e].
    """
    if not movable.any():
        return starts

    def placed(moved: Floats) -> Floats:
        unit = starts.copy()
        unit[:, movable] = moved.reshape(len(starts), -1)
        return unit

    def descent(moved: Floats) -> tuple[float, Floats]:
        unit = placed(moved)
        points, pull = chart.placed(unit)
        utility, slopes = model.slopes(points)
        return -float(utility.sum()), -pull(slopes)[:, movable].ravel()

    first = starts[:, movable].ravel()
    found = scipy.optimize.minimize(
        descent,
        first,
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.0, 1.0)] * len(first),
        options={"maxiter": steps},
    )
    return placed(found.x)
