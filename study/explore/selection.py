"""Which rows of a store are selected: a text, "column low..high, column low..high".

The page's script reads the same text (scripts/brush.mjs), so that a brush needs no server.
"""

import re
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.errors import InputError

RANGE = re.compile(r"\s*(\w+)\s+(\S+?)\.\.(\S+)\s*")

Ranges = dict[str, tuple[float, float]]


def read_selection(text: str, columns: Sequence[str]) -> Ranges:
    """The ranges of a text, by column; of two of a column the last counts.

    Raises:
        InputError: another form, or another column than these.
    """
    found = {}
    for part in filter(str.strip, text.split(",")):
        match = RANGE.fullmatch(part)
        if match is None:
            raise InputError("selection", part.strip(), "column low..high, column low..high, ...")
        name, *ends = match.groups()
        if name not in columns:
            raise InputError("selection", name, f"one of {', '.join(columns)}")
        found[name] = (_number(ends[0]), _number(ends[1]))
    return found


def selected(
    ranges: Ranges, column: Callable[[str], NDArray[np.float64]], rows: int
) -> NDArray[np.bool_]:
    """Which rows lie within all ranges, ends included, [n]; one without a number does not."""
    inside = np.ones(rows, dtype=bool)
    for name, (low, high) in ranges.items():
        values = column(name)
        inside &= (values >= low) & (values <= high)
    return inside


def selection_text(ranges: Ranges) -> str:
    """The text that reads as these ranges."""
    return ", ".join(f"{name} {low:g}..{high:g}" for name, (low, high) in ranges.items())


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError("selection", text, "a number") from None
