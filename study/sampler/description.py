"""What an object of this package looks like at a prompt: the call that makes one like it."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from optuna.samplers import BaseSampler

NAMES_SHOWN = 3


def table_text(rows: int, parameters: int, features: Sequence[str]) -> str:
    """Size and features of a table, as the arguments of a call."""
    names = ", ".join(features[:NAMES_SHOWN]) + (", ..." if len(features) > NAMES_SHOWN else "")
    counts = (_count(rows, "row"), _count(parameters, "parameter"))
    return f"{', '.join(counts)}, {_count(len(features), 'feature')}: {names}"


def call_text(function: Callable[..., Any], arguments: Mapping[str, Any]) -> str:
    """The arguments of a call that are not those it has by default.

    Args:
        function: that was called; its first argument, if it has no default of its own, is `self`.
        arguments: by name, of all parameters of the function and perhaps of others.
    """
    parts = []
    for place, (name, parameter) in enumerate(inspect.signature(function).parameters.items()):
        if name == "self" or _equal(arguments[name], parameter.default):
            continue
        shown = _shown(arguments[name])
        parts.append(shown if place == 1 else f"{name}={shown}")
    return ", ".join(parts)


def _count(number: int, thing: str) -> str:
    """So many things."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def _equal(value: Any, default: Any) -> bool:
    """Whether a value is the default; what compares in another way is not."""
    return value is default or (type(value) is type(default) and bool(value == default))


def _shown(value: Any) -> str:
    """A value; functions and samplers by their names, which say more than their addresses."""
    if isinstance(value, BaseSampler):
        return str(value)
    if inspect.isroutine(value):
        return str(value.__qualname__)
    return repr(value)
