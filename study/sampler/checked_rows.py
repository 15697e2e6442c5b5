"""The columns of a table made rows: checked one by one, then against bounds and distributions."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution

from study.sampler.columns import Floats, feature_matrix, parameter_column
from study.sampler.points import columns_of, let_go, new_matrix
from study.sampler.rows import Rows
from study.sampler.space import STEP_TOLERANCE, Space
from taichi_nmm.errors import InputError

Bounds = Mapping[str, tuple[float, float]]


def make_rows(
    parameters: Mapping[str, ArrayLike],
    features: ArrayLike,
    feature_names: Sequence[str] | None,
    bounds: Bounds | None,
    space: Mapping[str, BaseDistribution] | None,
) -> Rows:
    """n rows of d parameters and k features.

    Args:
        parameters: d columns by name, [n] each.
        features: [n, k], or [n] for one.
        feature_names: k names; None: feature_0, feature_1, ...
        bounds: (low, high) of some numeric parameters, by name.
        space: distributions of some parameters, by name.

    Raises:
        InputError: naming the column and row that cannot be used.
    """
    if not parameters:
        raise InputError("table.parameters", "none", "at least one column")
    _require_known("table.bounds", bounds, parameters)
    _require_known("table.space", space, parameters)
    matrix = feature_matrix(features, feature_names)
    names = tuple(feature_names or (f"feature_{i}" for i in range(matrix.shape[1])))
    raw = new_matrix(len(matrix), len(parameters))
    distributions: dict[str, BaseDistribution] = {}
    for (name, values), column in zip(parameters.items(), columns_of(raw), strict=True):
        given = None if space is None else space.get(name)
        numbers, distribution = parameter_column(name, values, len(matrix), given)
        if bounds is not None and name in bounds and given is None:
            distribution = _widened(name, distribution, bounds[name])
        column[:] = numbers
        let_go(np.asarray(values))
        distributions[name] = distribution
    rows = Rows(Space.of(distributions), raw, names, matrix)
    _require_inside(rows)
    return rows


def _require_known(
    field: str, given: Mapping[str, Any] | None, parameters: Mapping[str, Any]
) -> None:
    """Refuse bounds or distributions of a name that no column has."""
    for name in given or ():
        if name not in parameters:
            raise InputError(field, name, f"one of {', '.join(sorted(parameters))}")


def _widened(
    name: str, distribution: BaseDistribution, bounds: tuple[float, float]
) -> BaseDistribution:
    """The distribution of a column with the bounds asked for."""
    if isinstance(distribution, CategoricalDistribution):
        raise InputError(f"table.bounds.{name}", bounds, "none: the parameter is categorical")
    low, high = bounds
    if not low <= high:
        raise InputError(f"table.bounds.{name}", bounds, "(low, high), low <= high")
    return type(distribution)(low, high)  # type: ignore[call-arg]


def _require_inside(rows: Rows) -> None:
    """Refuse rows that their own distribution does not hold."""
    named = rows.space.as_dict().items()
    for (name, distribution), values in zip(named, columns_of(rows.parameters), strict=True):
        if isinstance(distribution, CategoricalDistribution):
            continue
        low, high = distribution.low, distribution.high  # type: ignore[attr-defined]
        outside = np.flatnonzero(~((low <= values) & (values <= high)))
        if len(outside):
            row = int(outside[0])
            raise InputError(f"table.{name}[{row}]", float(values[row]), f"{low:g} to {high:g}")
        if isinstance(distribution, FloatDistribution) and distribution.step is None:
            continue
        row_off_grid = _first_off_grid(values, distribution)
        if row_off_grid is not None:
            value = float(values[row_off_grid])
            raise InputError(f"table.{name}[{row_off_grid}]", value, f"a value of {distribution}")


def _first_off_grid(values: Floats, distribution: BaseDistribution) -> int | None:
    """The first of the values [n] that lies between the steps of its parameter."""
    low, step = distribution.low, distribution.step  # type: ignore[attr-defined]
    steps = (values - low) / step
    off = np.flatnonzero(np.abs(steps - np.round(steps)) > STEP_TOLERANCE)
    return int(off[0]) if len(off) else None
