"""Features of points by a function of the user's, called once a batch and not trusted."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]
Features = Callable[[Floats], Floats]


def call_features(
    function: Features, points: Floats, width: int | None = None, *, to_choose: bool = True
) -> Floats:
    """Features [n, k] of points [n, d]; NaN is a gap, infinity a value.

    Args:
        function: of the user.
        points: as rows of `study.sampler.space`.
        width: k, where it is known.
        to_choose: one of the points is to be proposed; else gaps in all of them are no error.

    Raises:
        InputError: the function raised (its exception is the cause), or returned something else.
    """
    try:
        returned = function(points.copy())
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise InputError("features(params)", what, "features [n, k], no exception") from error
    try:
        features = np.array(returned, dtype=np.float64)
    except (TypeError, ValueError):
        name = type(returned).__name__
        raise InputError("features(params)", name, "an array of numbers [n, k]") from None
    features = features[:, None] if features.ndim == 1 else features
    expected = f"[{len(points)}, {'k' if width is None else width}]"
    if features.ndim != 2 or len(features) != len(points) or width not in (None, features.shape[1]):
        raise InputError("features(params).shape", features.shape, expected)
    if not features.shape[1]:
        raise InputError("features(params).shape", features.shape, "at least one feature")
    if to_choose and len(features) and np.isnan(features).any(axis=1).all():
        raise InputError("features(params)", "no row without NaN", f"finite numbers {expected}")
    return features
