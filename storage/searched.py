"""What the points of a store are points of: the gains, and the low-level gains searched with them.

Arrays of points have a column a parameter: the 16 gains, then those of `searched`, in the order of
`LOW_LEVEL_GAINS`.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAINS, LOW_LEVEL_GAINS, LOW_LEVEL_NAMES, Parameter


def searched_parameters(names: Sequence[str], field: str = "searched") -> tuple[Parameter, ...]:
    """The low-level gains of these names, in the order of `LOW_LEVEL_GAINS`.

    Raises:
        InputError: an unknown name, or one given twice; `field` is what the user calls the list.
    """
    for name in names:
        if name not in LOW_LEVEL_NAMES:
            raise InputError(field, name, f"any of {', '.join(LOW_LEVEL_NAMES)}")
        if list(names).count(name) > 1:
            raise InputError(field, name, "each name once")
    return tuple(parameter for parameter in LOW_LEVEL_GAINS if parameter.name in names)


def split_points(
    points: NDArray[np.float64], searched: tuple[Parameter, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What `taichi_nmm.simulate` takes: gains [n, 16] and low-level gains [n, 8].

    Args:
        points: [n, 16 + k].
        searched: the k low-level gains in the last columns; the others keep their defaults.
    """
    low_level = np.tile([parameter.default for parameter in LOW_LEVEL_GAINS], (len(points), 1))
    for column, parameter in enumerate(searched, start=len(GAINS)):
        low_level[:, LOW_LEVEL_NAMES.index(parameter.name)] = points[:, column]
    return points[:, : len(GAINS)], low_level
