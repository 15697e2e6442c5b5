"""Named checks of what a caller gives, and `checked`, which applies them at a public door.

A check takes the field's name and the value, and returns what to go on with; a value that cannot be
used is an `InputError`. Types are checked here, once: what follows may rely on them.
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

from taichi_nmm.errors import InputError

Check: TypeAlias = Callable[[str, Any], Any]
P = ParamSpec("P")
R = TypeVar("R")

# Above zero whatever a library does to the processor: Taichi's code takes smaller ones for zero.
LEAST_POSITIVE = sys.float_info.min
LARGEST_SEED = 2**128 - 1  # of those that NumPy takes from the machine
MOST_ROWS = 10_000_000  # of a batch that is made from its size alone


def checked(prefix: str = "", /, **checks: Check) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A function whose arguments of these names are checked, `prefix` before their names.

    A default is not checked. A wrong number of arguments stays Python's own TypeError.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        known = signature(function)

        @wraps(function)
        def door(*args: P.args, **kwargs: P.kwargs) -> R:
            given = known.bind(*args, **kwargs)
            for name in checks.keys() & given.arguments.keys():
                given.arguments[name] = checks[name](prefix + name, given.arguments[name])
            return function(*given.args, **given.kwargs)

        return door

    return decorate


def check_fields(record: object, prefix: str, **checks: Check) -> None:
    """The same for the fields of a frozen dataclass, in its `__post_init__`."""
    for name, check in checks.items():
        object.__setattr__(record, name, check(prefix + name, getattr(record, name)))


def number(low: float = -math.inf, high: float = math.inf, allowed: str = "") -> Check:
    """A finite number from `low` to `high`; `allowed` says it in other words."""

    def check(field: str, value: Any) -> Any:
        if not is_number(value) or not (math.isfinite(value) and low <= value <= high):
            raise InputError(field, value, allowed or _ends("a finite number", low, high))
        return value or abs(value)  # no negative zero

    return check


def is_number(value: Any) -> bool:
    """Whether it is a number that a float can hold: infinity and NaN are, flags are not."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return False
    try:
        float(value)
    except OverflowError:  # a whole number of hundreds of digits
        return False
    return True


def whole(low: float = -math.inf, high: float = math.inf) -> Check:
    """A whole number from `low` to `high`."""

    def check(field: str, value: Any) -> Any:
        if isinstance(value, bool) or not isinstance(value, int | np.integer):
            raise InputError(field, value, _ends("a whole number", low, high))
        if not low <= value <= high:
            raise InputError(field, value, _ends("a whole number", low, high))
        return value

    return check


def _ends(kind: str, low: float, high: float) -> str:
    least = f" from {low}" if low > -math.inf else ""
    return kind + least + (f" to {high}" if high < math.inf else "")


def seed(field: str, value: Any) -> Any:
    """A seed: a whole number, or a NumPy `SeedSequence`."""
    if isinstance(value, np.random.SeedSequence):
        return value
    return whole(0, LARGEST_SEED)(field, value)


def text(field: str, value: Any) -> Any:
    """A string."""
    if not isinstance(value, str):
        raise InputError(field, value, "a string")
    return value


def word(*choices: str) -> Check:
    """One of some words."""

    def check(field: str, value: Any) -> Any:
        if not isinstance(value, str) or value not in choices:
            raise InputError(field, value, " or ".join(choices))
        return value

    return check


def path(field: str, value: Any) -> Any:
    """A path: a string or a `pathlib.Path`."""
    if not isinstance(value, str | os.PathLike) or isinstance(os.fspath(value), bytes):
        raise InputError(field, value, "a path: a string or a pathlib.Path")
    return value


def flag(field: str, value: Any) -> Any:
    """True or false."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(field, value, "True or False")
    return value


def function(field: str, value: Any) -> Any:
    """A function."""
    if not callable(value):
        raise InputError(field, value, "a function")
    return value


def instance(*kinds: type) -> Check:
    """An object of one of some classes."""
    names = " or ".join(f"a {kind.__name__}" for kind in kinds)

    def check(field: str, value: Any) -> Any:
        if not isinstance(value, kinds):
            raise InputError(field, value, names)
        return value

    return check


def optional(check: Check) -> Check:
    """None, or what passes the check."""
    return lambda field, value: None if value is None else check(field, value)


def each(check: Check, least: int = 0) -> Check:
    """Several values, each of which passes the check; as a tuple. One string is not several."""

    def check_all(field: str, values: Any) -> Any:
        try:
            listed = None if isinstance(values, str | bytes | Mapping) else tuple(values)
        except TypeError:
            listed = None
        if listed is None or len(listed) < least:
            raise InputError(field, values, f"a list{f' of {least} or more' if least else ''}")
        return tuple(check(f"{field}[{place}]", value) for place, value in enumerate(listed))

    return check_all


def by_name(check: Check) -> Check:
    """A mapping of names to values, each of which passes the check; as a new dictionary."""

    def check_all(field: str, values: Any) -> Any:
        if not isinstance(values, Mapping) or not all(isinstance(name, str) for name in values):
            raise InputError(field, values, "values by name: a dictionary whose keys are strings")
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


def anything(field: str, value: Any) -> Any:
    """Whatever it is: another one will check it."""
    return value


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
        raise InputError(field, values, "an array of numbers") from None


def unmasked(values: Any) -> Any:
    """A masked array of numbers with NaN under its mask; anything else as it is.

    `np.asarray` would show the values that the mask hides.
    """
    if not np.ma.is_masked(values):
        return values
    return values.astype(np.float64).filled(np.nan)


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
        rows = rows.astype(np.intp)  # of nothing, NumPy makes numbers that are not whole
    if rows.ndim != 1 or rows.dtype.kind not in "iu":
        raise InputError(field, values, "whole numbers, [k]")
    outside = rows[(rows < 0) | (rows >= count)]
    if len(outside):
        raise InputError(field, outside[0].item(), f"0 to {count - 1}")
    return rows
