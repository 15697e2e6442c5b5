"""How far a gait is from the published ranges of people, a number a curve."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.pictures.gait_cycle import PANELS
from study.pictures.strides import PERCENT, Strides

ACCURACY = {"deg": 3.0, "bw": 0.05}  # of the published tables: `study.pictures.human_ranges`


@dataclass(frozen=True)
class Distance:
    """Of a walker's mean stride from the mean of people.

    Attributes:
        rmse: root of the mean squared difference, in the curve's unit.
        deviations: the same in standard deviations of people; one that is less than the tables'
            accuracy counts as that.
    """

    rmse: float
    deviations: float


def human_distances(strides: Strides) -> dict[str, Distance]:
    """The distance of each of `PANELS`; none where the strides are too few for a mean."""
    if not strides.enough:
        return {}
    found = {}
    for name, panel in PANELS.items():
        mean, sd = panel.human.at(PERCENT)
        difference = getattr(strides, name).mean(axis=0) - mean
        scaled = difference / np.maximum(sd, ACCURACY[name.rpartition("_")[2]])
        found[name] = Distance(_root_mean_square(difference), _root_mean_square(scaled))
    return found


def _root_mean_square(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
