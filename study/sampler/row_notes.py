"""What is left in a trial by a table's sampler: user attributes, to be read and sorted by."""

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from study.sampler.history import (
    FEATURES_ATTRIBUTE,
    OFF_TABLE,
    ROW_ATTRIBUTE,
    SCORE_ATTRIBUTE,
)


def notes_of(row: int, features: NDArray[np.float64]) -> dict[str, Any]:
    """The row, or OFF_TABLE, and its features [k], those unknown as None."""
    values = [value if isfinite(value) else None for value in features.tolist()]
    notes: dict[str, Any] = {ROW_ATTRIBUTE: row}
    if len(values) == 1:
        notes[SCORE_ATTRIBUTE] = values[0]
    if len(values) > 1 or row == OFF_TABLE:
        notes[FEATURES_ATTRIBUTE] = values
    return notes


def taken_back(width: int, listed: bool) -> dict[str, Any]:
    """What is left in a trial that ran something else than was noted; notes cannot be removed.

    Args:
        width: k, the number of features.
        listed: of one feature, whether it may stand in the trial as a list, too: that of a point
            off the table.
    """
    notes: dict[str, Any] = {ROW_ATTRIBUTE: OFF_TABLE}
    if width == 1:
        notes[SCORE_ATTRIBUTE] = None
    if width > 1 or listed:
        notes[FEATURES_ATTRIBUTE] = None
    return notes
