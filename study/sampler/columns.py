"""Columns of arrays, files and stores, checked: the content of a table."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from importlib.util import find_spec
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unicodedata import normalize

import numpy as np
from numpy.typing import ArrayLike, NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
    json_to_distribution,
)

from storage.inputs import checks, typed
from storage.inputs.errors import InputError, listed
from study.sampler.arrays import Floats
from study.sampler.rows import Rows
from study.sampler.space import Number, Space, first_not_taken
from study.sampler.worlds import Better, Outcomes, Worlds, limits_in_worlds, matrix_of

if TYPE_CHECKING:
    # Slow to load: where a file is read.
    from storage.foreign_tables import ForeignTable

Bounds = Mapping[str, tuple[float, float]]

LARGEST_EXACT = 2**53  # of whole numbers in float64
CHOICES = (str, bool, np.bool_, Real, type(None))
KINDS = (
    "numbers, words or flags; of a date or a time make a number, such as the days from "
    "the first"
)
EXACT_WHOLE = (
    "whole numbers up to 2^53, which a float holds; longer ones by space=, as choices"
)


def checked_rows(
    parameters: Mapping[str, ArrayLike],
    features: ArrayLike | None,
    feature_names: Sequence[str] | None = None,
    *,
    bounds: Bounds | None = None,
    space: Mapping[str, BaseDistribution] | None = None,
    outcomes: Outcomes | None = None,
    better: Better | None = None,
    limits: Mapping[str, Outcomes] | None = None,
) -> Rows:
    """The content of a table; arguments and errors are those of `FeatureTable.from_arrays`."""
    if not parameters:
        raise InputError("table.parameters", "none", "at least one column")
    bounds, space = bounds or {}, space or {}
    for field, named in (("table.bounds", bounds), ("table.space", space)):
        unknown = [name for name in named if name not in parameters]
        if unknown:
            allowed = f"one of {listed(sorted(parameters), unknown[0])}"
            raise InputError(field, unknown[0], allowed)
    for name, ends in bounds.items():
        if name in space:
            allowed = "none beside space=, which has the name"
            raise InputError(f"table.bounds.{name}", ends, allowed)
    worlds = None if outcomes is None else Worlds.of(outcomes, better)
    if worlds is None and better is not None:
        raise InputError("table.better", better, "none without outcomes")
    if features is None and worlds is None:
        raise InputError("table.features", "none", "features, outcomes, or both")
    if features is None and worlds is not None:
        if feature_names:
            raise InputError("table.feature_names", list(feature_names), "0 names")
        matrix = np.empty((len(worlds.costs), 0))
    else:
        matrix = feature_matrix(features, feature_names)
    if worlds is not None and len(worlds.costs) != len(matrix):
        allowed = f"{len(matrix)} rows, as the features"
        raise InputError("table.outcomes", f"{len(worlds.costs)} rows", allowed)
    names = tuple(feature_names or (f"feature_{i}" for i in range(matrix.shape[1])))
    raw = np.empty((len(matrix), len(parameters)))
    distributions: dict[str, BaseDistribution] = {}
    for (name, values), column in zip(parameters.items(), raw.T, strict=True):
        given = space.get(name)
        column[:], own = _parameter_column(name, values, len(matrix), given)
        if name in bounds:
            if isinstance(own, CategoricalDistribution):
                allowed = "none: the parameter is categorical"
                raise InputError(f"table.bounds.{name}", bounds[name], allowed)
            own = _within(own, *bounds[name])
        distributions[name] = own
        if isinstance(own, Number):
            _require_inside(name, own, column)
        if isinstance(own, FloatDistribution):  # beyond an end by rounding alone
            np.clip(column, own.low, own.high, out=column)
    return Rows(
        space=Space.of(distributions),
        parameters=raw,
        feature_names=names,
        features=matrix,
        worlds=worlds,
        limits=limits_in_worlds(limits or {}, len(matrix)),
    )


def _require_inside(name: str, own: Number, column: Floats) -> None:
    """Refuse a number of a column [n] that its distribution has not."""
    row = first_not_taken(own, column, own)
    if row is None:
        return
    value = float(column[row])
    allowed = f"{own.low:g} to {own.high:g}"
    if own.low <= value <= own.high:
        allowed = f"a value of {own}"
    raise InputError(f"table.{name}[{row}]", value, allowed)


def _parameter_column(
    name: str, values: ArrayLike, length: int, given: BaseDistribution | None
) -> tuple[Floats, BaseDistribution]:
    """A parameter's column as numbers [length] (categorical: indices), and its distribution.

    None is given: floats, integers or choices, as the values are.
    """
    try:
        column = np.asarray(checks.unmasked(values))
    except ValueError:  # lists of different lengths
        raise InputError(f"table.{name}.shape", "ragged", "[n], n at least 1") from None
    if column.dtype.kind in "US":
        # NumPy made words of numbers and gaps among words, if there were any.
        column = np.asarray(values, dtype=object)
    if column.ndim != 1 or not len(column):
        raise InputError(f"table.{name}.shape", column.shape, "[n], n at least 1")
    if len(column) != length:
        allowed = f"({length},), as features or outcomes have rows"
        raise InputError(f"table.{name}.shape", column.shape, allowed)
    if column.dtype.kind == "O" and given is None:
        column = _without_decimals(column)
    may_hide_flags = column.dtype.kind in "iuf" and isinstance(values, list | tuple)
    if may_hide_flags and any(isinstance(value, bool) for value in values):  # type: ignore[union-attr]
        column = np.array(values, dtype=object)
    if given is None and column.dtype.kind not in "iuf":
        return _choices(name, column, given)
    if isinstance(given, CategoricalDistribution):
        return _choices(name, column, given)
    try:
        if column.dtype.kind in "mM":
            raise TypeError
        numbers = column.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"table.{name}", str(column[0]), "numbers") from None
    bad = np.flatnonzero(~np.isfinite(numbers))
    if len(bad):
        field = f"table.{name}[{bad[0]}]"
        raise InputError(field, float(numbers[bad[0]]), "a finite number")
    for row in np.flatnonzero(np.abs(numbers) >= LARGEST_EXACT).tolist():
        value: Any = column[row]
        if column.dtype.kind == "f" and isinstance(values, list | tuple):
            value = values[row]
        is_whole = isinstance(value, int | np.integer)  # its float may be that of 2^53
        if is_whole and abs(int(value)) > LARGEST_EXACT:
            raise InputError(f"table.{name}[{row}]", int(value), EXACT_WHOLE)
    numbers = numbers + 0.0  # no negative zero: rows are compared by their bits
    if given is not None:
        return numbers, given
    low, high = float(numbers.min()), float(numbers.max())
    if column.dtype.kind in "iu":
        return numbers, IntDistribution(int(low), int(high))
    return numbers, FloatDistribution(low, high)


def _within(distribution: BaseDistribution, low: float, high: float) -> Number:
    """A distribution of numbers with these bounds: floats, where whole numbers cannot have them."""
    are_whole = float(low).is_integer() and float(high).is_integer()
    if are_whole and isinstance(distribution, IntDistribution):
        return IntDistribution(int(low), int(high))
    return FloatDistribution(float(low), float(high))


def _without_decimals(column: NDArray[Any]) -> NDArray[Any]:
    """Decimals as databases have them, as floats, or whole numbers if all are; else as it is."""
    listed = column.tolist()
    decimals = [value for value in listed if isinstance(value, Decimal)]
    if not decimals or not all(isinstance(value, Decimal | Real) for value in listed):
        return column
    are_whole = all(value == int(value) for value in listed)
    if are_whole and all(value.as_tuple().exponent == 0 for value in decimals):
        return np.array([int(value) for value in listed])
    return np.array([float(value) for value in listed])


def feature_matrix(features: ArrayLike | None, names: Sequence[str] | None) -> Floats:
    """Features as [n, k]; NaN is a gap, infinity a value."""
    matrix = matrix_of("table.features", features, "k")
    whole = np.asarray(features)
    if whole.dtype.kind in "iu" and np.abs(matrix).max() >= LARGEST_EXACT:
        for column, own in zip(matrix.T, whole.reshape(matrix.shape).T, strict=True):
            if len(np.unique(own)) > len(np.unique(column)):
                allowed = (
                    "whole numbers up to 2^53, or of which no two are the same float"
                )
                raise InputError(
                    "table.features", int(own[np.abs(column).argmax()]), allowed
                )
    if names is not None and len(names) != matrix.shape[1]:
        raise InputError("table.feature_names", list(names), f"{matrix.shape[1]} names")
    return matrix


def _choices(
    name: str, column: NDArray[Any], given: CategoricalDistribution | None
) -> tuple[Floats, CategoricalDistribution]:
    """Indices of choices: those given, or the values in the order in which they appear.

    What may be a gap is refused: NaN, and None that does not stand among words or
    flags.
    """
    listed = column.tolist()
    if given is not None and None in given.choices:  # pandas has NaN for it
        listed = [None if _is_gap(value) else value for value in listed]
    _require_no_flag_among_numbers(name, listed if given is None else given.choices)
    if given is None:
        _require_told_apart(name, listed)
        for row, value in enumerate(listed):
            is_choice = isinstance(value, CHOICES) and not typed.is_clock(value)
            if not is_choice and not _is_gap(value):
                raise InputError(f"table.{name}[{row}]", value, KINDS)
            if typed.is_meant(value):
                allowed = "a number, not a word that looks like one; or a choice, declared as such"
                for odd, other in enumerate(listed):
                    if isinstance(other, str) and not typed.is_meant(other):
                        allowed += f" (row {odd} has {other!r})"
                        break
                raise InputError(f"table.{name}[{row}]", value, allowed)
        others = [value for value in listed if value is not None and not _is_gap(value)]
        words = bool(others) and all(isinstance(value, str | bool) for value in others)
        choice = f"space={{{name!r}: CategoricalDistribution([...])}}"
        for row, value in enumerate(listed):
            if _is_gap(value) or (value is None and not words):
                allowed = f"a value; or None as a choice: {choice}"
                raise InputError(f"table.{name}[{row}]", value, allowed)
    choices = tuple(dict.fromkeys(listed)) if given is None else given.choices
    index = {choice: float(place) for place, choice in enumerate(choices)}
    for row, value in enumerate(listed):
        if value not in index:
            raise InputError(f"table.{name}[{row}]", value, f"one of {choices}")
    places = np.array([index[value] for value in listed])
    return places, given or CategoricalDistribution(choices)


def _require_told_apart(name: str, values: Sequence[Any]) -> None:
    """Refuse words that look the same, but for blanks around them or the codes of their letters."""
    known = dict[str, tuple[int, str]]()
    for row, value in enumerate(values):
        if isinstance(value, str):
            first, same = known.setdefault(
                normalize("NFC", value.strip()), (row, value)
            )
            if same != value:
                allowed = (
                    f"a word that does not look the same as {same!r} in row {first}"
                )
                raise InputError(f"table.{name}[{row}]", value, allowed)


def _require_no_flag_among_numbers(name: str, values: Sequence[Any]) -> None:
    """Refuse True beside 1: choices are told apart by equality, in Optuna too."""
    known = dict[Any, Any]()
    for row, value in enumerate(values):
        if not isinstance(value, bool | Real):
            continue
        first = known.setdefault(value, value)
        if isinstance(first, bool) is not isinstance(value, bool):
            allowed = f"flags or numbers, not both: it equals {first!r}; or words"
            raise InputError(f"table.{name}[{row}]", value, allowed)


def _is_gap(value: Any) -> bool:
    """NaN, and what else is not equal to itself."""
    try:
        return bool(value != value)
    except (TypeError, ValueError):  # pandas.NA, which is not even unequal
        return True


@dataclass(frozen=True)
class FileColumns:
    """Where a table was read from.

    Attributes:
        path: of a Parquet file, a folder of them, or a store.
        features: names of k columns.
        parameters: names of d columns; None: those of the store.
        space: distributions of some parameters, by name; None: of none.
        bounds: (low, high) of some parameters, by name; None: those that a store was
            made with.
    """

    path: Path
    features: Sequence[str]
    parameters: Sequence[str] | None
    space: Mapping[str, BaseDistribution] | None
    bounds: Bounds | None

    def read(self) -> Rows:
        """Read the columns, and check them."""
        if not self.features:
            raise InputError("features", "none", "at least one column")
        # Where the sampler is installed alone, Arrow may be missing, and stores are.
        if find_spec("pyarrow") is None:
            raise InputError(
                "store", str(self.path), "an installed pyarrow, which reads it"
            )
        if self.parameters is None and find_spec("storage.store") is None:
            raise InputError(
                "parameters", "none", "columns; only taichi-nmm whole reads stores"
            )
        if self.parameters is None:
            return self._of_store()
        from storage.foreign_tables import ForeignTable

        wanted = dict.fromkeys([*self.parameters, *self.features])
        table = ForeignTable.read("store", self.path, list(wanted), of_columns="column")
        columns = {name: table.values(name) for name in self.parameters}
        features = _features(table, self.features)
        return checked_rows(
            columns, features, self.features, bounds=self.bounds, space=self.space
        )

    def _of_store(self) -> Rows:
        """The columns of a store, with its parameters and their bounds."""
        from storage.foreign_tables import ForeignTable  # PyArrow is slow to load
        from storage.store import open_store

        store = open_store(self.path)
        store.require_bounds()
        ranges = store.bounds
        others = [name for name in store.columns if name not in ranges]
        for name in self.features:
            if name not in others:
                raise InputError("score", name, f"one of {listed(others, name)}")
        features = _features(
            ForeignTable("score", store.table(self.features)), self.features
        )
        columns, bounds, space = store_parameters(ranges, store.points())
        space |= self.space or {}
        return checked_rows(
            columns,
            features,
            self.features,
            bounds=self.bounds or bounds,
            space=space,
        )


def store_parameters(
    ranges: Mapping[str, Mapping[str, Any]], matrix: Floats
) -> tuple[
    dict[str, NDArray[Any]], dict[str, tuple[float, float]], dict[str, BaseDistribution]
]:
    """The parameters of a store as studies suggest them, of columns [n, p]; a choice is its number.

    Columns by name, [n] each; bounds of plain floats; distributions of all others.
    `ranges` are those of the store's specification.
    """
    columns: dict[str, NDArray[Any]] = dict(zip(ranges, matrix.T, strict=True))
    bounds, space = {}, {}
    for name, ends in ranges.items():
        if "distribution" not in ends:
            bounds[name] = ends["low"], ends["high"]
            continue
        try:
            own = space[name] = json_to_distribution(json.dumps(ends["distribution"]))
            if isinstance(own, CategoricalDistribution):
                if not np.isin(columns[name], np.arange(len(own.choices))).all():
                    raise ValueError("a number that is none of its choices")
                columns[name] = np.array(own.choices, dtype=object)[
                    columns[name].astype(int)
                ]
        except (KeyError, TypeError, ValueError) as error:
            allowed = f"a distribution of Optuna ({error})"
            raise InputError(
                f"store.gains.{name}", ends["distribution"], allowed
            ) from None
    return columns, bounds, space


def _features(table: "ForeignTable", names: Sequence[str]) -> Floats:
    """Columns of numbers, [n, k]."""
    matrix = np.empty((len(table), len(names)))
    for name, target in zip(names, matrix.T, strict=True):
        target[:] = table.numbers(name)
    return matrix
