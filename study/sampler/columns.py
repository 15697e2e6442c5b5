"""Columns of a table, checked: parameters become numbers with a distribution, features a matrix."""

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]


def parameter_column(
    name: str, values: ArrayLike, length: int, given: BaseDistribution | None
) -> tuple[Floats, BaseDistribution]:
    """A parameter's column as numbers [n] (categorical: indices), and its distribution.

    Args:
        name: of the parameter.
        values: [n], without gaps.
        length: n.
        given: its distribution; None: floats, integers or choices, as the values are.
    """
    try:
        column = np.asarray(values)
    except ValueError:  # lists of different lengths
        raise InputError(f"table.{name}.shape", "ragged", "[n], n at least 1") from None
    if column.dtype.kind in "US":  # made words of numbers and gaps among words, if there were any
        column = np.asarray(values, dtype=object)
    if column.ndim != 1 or not len(column):
        raise InputError(f"table.{name}.shape", column.shape, "[n], n at least 1")
    if len(column) != length:
        raise InputError(f"table.{name}.shape", column.shape, f"({length},), as the features")
    if isinstance(given, CategoricalDistribution):
        return _choices(name, column, given)
    if given is None and column.dtype.kind not in "iuf":
        return _choices(name, column, None)
    numbers = _finite(name, column)
    return numbers, given or _numeric(column.dtype.kind, numbers)


def feature_matrix(features: ArrayLike, names: Sequence[str] | None) -> Floats:
    """Features as [n, k]; NaN is a gap, infinity a value."""
    try:
        matrix = np.array(features, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError("table.features", type(features).__name__, "numbers, [n, k]") from None
    matrix = matrix[:, None] if matrix.ndim == 1 else matrix
    if matrix.ndim != 2 or not matrix.size:
        raise InputError("table.features.shape", matrix.shape, "[n, k], n and k at least 1")
    if names is not None and len(names) != matrix.shape[1]:
        raise InputError("table.feature_names", list(names), f"{matrix.shape[1]} names")
    return matrix


def _numeric(kind: str, numbers: Floats) -> BaseDistribution:
    """The distribution of a column [n] without one: its kind, from its least to its greatest."""
    low, high = float(numbers.min()), float(numbers.max())
    if kind in "iu":
        return IntDistribution(int(low), int(high))
    return FloatDistribution(low, high)


def _finite(name: str, column: NDArray[Any]) -> Floats:
    """A column as finite floats, [n], or an error that names the first row that is none."""
    try:
        numbers = column.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"table.{name}", str(column[0]), "numbers") from None
    bad = np.flatnonzero(~np.isfinite(numbers))
    if len(bad):
        raise InputError(f"table.{name}[{bad[0]}]", float(numbers[bad[0]]), "a finite number")
    return numbers + 0.0  # no negative zero: rows are told apart by their bits


def _choices(
    name: str, column: NDArray[Any], given: CategoricalDistribution | None
) -> tuple[Floats, CategoricalDistribution]:
    """Indices of choices: those given, or the values in the order in which they appear."""
    listed = [_choice(value, given) for value in column.tolist()]
    for row, value in enumerate(listed):
        if not isinstance(value, Hashable):
            raise InputError(f"table.{name}[{row}]", value, "a number, a word or a flag")
    if given is None:
        _require_no_gap(name, listed)
    choices = tuple(dict.fromkeys(listed)) if given is None else given.choices
    index = {choice: float(place) for place, choice in enumerate(choices)}
    for row, value in enumerate(listed):
        if value not in index:
            raise InputError(f"table.{name}[{row}]", value, f"one of {choices}")
    return np.array([index[value] for value in listed]), given or CategoricalDistribution(choices)


def _choice(value: Any, given: CategoricalDistribution | None) -> Any:
    """A value of a column; a gap is None where None is among the choices: pandas has NaN for it."""
    missing = given is not None and _is_gap(value) and None in given.choices
    return None if missing else value


def _is_gap(value: Any) -> bool:
    """NaN, and what else is not equal to itself."""
    try:
        return bool(value != value)
    except (TypeError, ValueError):  # pandas.NA, which is not even unequal
        return True


def _require_no_gap(name: str, values: list[Any]) -> None:
    """Refuse what may be a gap: NaN, and None that does not stand among words or flags."""
    others = [value for value in values if value is not None and not _is_gap(value)]
    words = bool(others) and all(isinstance(value, str | bool) for value in others)
    for row, value in enumerate(values):
        if _is_gap(value) or (value is None and not words):
            allowed = (
                f"a value; or None as a choice: space={{{name!r}: CategoricalDistribution([...])}}"
            )
            raise InputError(f"table.{name}[{row}]", value, allowed)
