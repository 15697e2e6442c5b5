"""Checks of what a caller gives, and `checked`, which applies them to a function's arguments.

A check takes the field's name and the value, and returns the value to go on with; a
value that cannot be used is an `InputError`. Configurations (`config`) are checked by
the same functions.
"""

import math
import os
import sys
from collections.abc import Callable, Mapping
from functools import wraps
from inspect import signature
from typing import Any, ParamSpec, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from storage.inputs.errors import InputError

Check: TypeAlias = Callable[[str, Any], Any]
P = ParamSpec("P")
R = TypeVar("R")

# The least normal number: code of Taichi treats smaller ones as zero.
LEAST_POSITIVE = sys.float_info.min
LARGEST_SEED = 2**128 - 1  # of those that NumPy takes from the machine
MOST_ROWS = 10_000_000  # of a batch that is made from its size alone


def checked(
    prefix: str = "", /, **checks: Check
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Check arguments of these names; errors name them with `prefix` before.

    A default is not checked. A wrong number of arguments stays Python's own TypeError.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        known = signature(function)

        @wraps(function)
        def door(*args: P.args, **kwargs: P.kwargs) -> R:
            given = known.bind(*args, **kwargs)
            for name in checks.keys() & given.arguments.keys():
                given.arguments[name] = checks[name](
                    prefix + name, given.arguments[name]
                )
            return function(*given.args, **given.kwargs)

        return door

    return decorate


def check_fields(record: object, prefix: str, **checks: Check) -> None:
    """Check fields of a frozen dataclass, in its `__post_init__`."""
    for name, check in checks.items():
        object.__setattr__(record, name, check(prefix + name, getattr(record, name)))


def that(holds: Callable[[Any], bool], allowed: str) -> Check:
    """A value for which `holds` is true, as it is."""

    def check(field: str, value: Any) -> Any:
        if not holds(value):
            raise InputError(field, value, allowed)
        return value

    return check


def number(low: float = -math.inf, high: float = math.inf, allowed: str = "") -> Check:
    """A finite number from `low` to `high`, as Python's; `allowed` describes it in other words."""
    allowed = allowed or _within("a finite number", low, high)

    def check(field: str, value: Any) -> Any:
        if not is_number(value) or not (math.isfinite(value) and low <= value <= high):
            raise InputError(field, value, allowed)
        if isinstance(value, int | np.integer):
            return int(value)
        return float(value) or 0.0  # no negative zero

    return check


def is_number(value: Any) -> bool:
    """Whether it is a number that a float can hold: infinity and NaN are, flags are not."""
    if isinstance(value, bool) or not isinstance(
        value, int | float | np.integer | np.floating
    ):
        return False
    try:
        float(value)
    except OverflowError:  # a whole number of hundreds of digits
        return False
    return True


def whole(low: float = -math.inf, high: float = math.inf) -> Check:
    """A whole number from `low` to `high`, as Python's."""
    allowed = _within("a whole number", low, high)

    def check(field: str, value: Any) -> Any:
        is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        if not is_whole or not low <= value <= high:
            raise InputError(field, value, allowed)
        return int(value)

    return check


def _within(kind: str, low: float, high: float) -> str:
    least = f" from {low}" if low > -math.inf else ""
    return kind + least + (f" to {high}" if high < math.inf else "")


def seed(field: str, value: Any) -> Any:
    """A seed: a whole number, or a NumPy `SeedSequence`."""
    if isinstance(value, np.random.SeedSequence):
        return value
    return whole(0, LARGEST_SEED)(field, value)


def _names_a_file(value: Any) -> bool:
    return isinstance(value, str | os.PathLike) and not isinstance(
        os.fspath(value), bytes
    )


text = that(lambda value: isinstance(value, str), "a string")
flag = that(lambda value: isinstance(value, bool | np.bool_), "True or False")
function = that(callable, "a function")
path = that(_names_a_file, "a path: a string or a pathlib.Path")
anything = that(lambda value: True, "")
"""Another check will follow."""


def word(*choices: str) -> Check:
    """One of some words."""
    return that(
        lambda value: isinstance(value, str) and value in choices, " or ".join(choices)
    )


def instance(*kinds: type) -> Check:
    """An object of one of some classes."""
    names = " or ".join(f"a {kind.__name__}" for kind in kinds)
    return that(lambda value: isinstance(value, kinds), names)


def optional(check: Check) -> Check:
    """None, or a value that passes the check."""
    return lambda field, value: None if value is None else check(field, value)


def each(check: Check, least: int = 0) -> Check:
    """Several values, each of which passes the check; as a tuple. One string is not several."""

    def check_all(field: str, values: Any) -> Any:
        try:
            listed = (
                None if isinstance(values, str | bytes | Mapping) else tuple(values)
            )
        except TypeError:
            listed = None
        if listed is None or len(listed) < least:
            raise InputError(
                field, values, f"a list{f' of {least} or more' if least else ''}"
            )
        return tuple(
            check(f"{field}[{place}]", value) for place, value in enumerate(listed)
        )

    return check_all


def by_name(check: Check) -> Check:
    """A mapping of names to values, each of which passes the check; as a new dictionary."""

    def check_all(field: str, values: Any) -> Any:
        if not isinstance(values, Mapping) or not all(
            isinstance(name, str) for name in values
        ):
            raise InputError(
                field, values, "values by name: a dictionary whose keys are strings"
            )
        return {name: check(f"{field}.{name}", value) for name, value in values.items()}

    return check_all


def interval(low: float = -math.inf, high: float = math.inf) -> Check:
    """Two finite numbers from `low` to `high`, the first no larger; as a tuple."""

    def check(field: str, value: Any) -> Any:
        ends = each(number(low, high))(field, value)
        if len(ends) != 2 or ends[0] > ends[1]:
            raise InputError(field, value, "(low, high), low <= high")
        return ends

    return check


def numbers(field: str, values: Any) -> NDArray[np.float64]:
    """An array of numbers as float64, of any shape; NaN and infinity are numbers.

    A masked value is NaN, as it is in pandas.
    """
    try:
        array = np.asarray(unmasked(values))
        if array.dtype.kind not in "biufO":
            raise TypeError
        return array.astype(np.float64, copy=False)
    except (TypeError, ValueError, OverflowError):
        where, value = first_that_is_no_number(field, values)
        raise InputError(where, value, "an array of numbers") from None


def first_that_is_no_number(field: str, values: Any) -> tuple[str, Any]:
    """Where the first value of an array stands that no float can hold, and the value.

    The field and the kind of the whole, where it is no array of values.
    """
    try:
        array = np.asarray(values, dtype=object)
    except ValueError:  # of different lengths
        return field, "lists of different lengths"
    if not array.ndim:
        return field, values
    is_time = getattr(values, "dtype", array.dtype).kind in "mM"
    for place in np.ndindex(array.shape):
        value = array[place]
        if is_time or not (
            value is None or isinstance(value, bool) or is_number(value)
        ):
            shown = str(np.asarray(values)[place]) if is_time else value
            return f"{field}[{', '.join(map(str, place))}]", shown
    return field, values


def unmasked(values: Any) -> Any:
    """Masked numbers as NaN: of an array, or of the arrays in a list; anything else as it is.

    `np.asarray` would show the values that the mask hides.
    """
    if isinstance(values, list | tuple) and any(
        np.ma.is_masked(each) for each in values
    ):
        return [unmasked(each) for each in values]
    if not np.ma.is_masked(values):
        return values
    # pandas has filled its own by now
    return np.ma.filled(values.astype(np.float64), np.nan)


def finite(field: str, values: Any) -> NDArray[np.float64]:
    """An array of finite numbers as float64, of any shape."""
    array = numbers(field, values)
    outside = array[~np.isfinite(array)]
    if outside.size:
        raise InputError(field, float(outside.flat[0]), "finite numbers")
    return array


def row_numbers(field: str, values: Any, count: int) -> NDArray[Any]:
    """Numbers of rows, each from 0 to `count` - 1, in any order; [k]."""
    try:
        rows = np.asarray(unmasked(values))
    except ValueError:  # lists of different lengths
        raise InputError(field, values, "whole numbers, [k]") from None
    if rows.shape == (0,):
        # of nothing, NumPy makes numbers that are not whole
        rows = rows.astype(np.intp)
    if rows.ndim != 1 or rows.dtype.kind not in "iu":
        raise InputError(field, values, "whole numbers, [k]")
    outside = rows[(rows < 0) | (rows >= count)]
    if len(outside):
        raise InputError(field, outside[0].item(), f"0 to {count - 1}")
    return rows
