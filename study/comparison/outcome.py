"""What became of a trial: its cost, and whether it walked."""

import numpy as np
from numpy.typing import NDArray

from study.objective import COST_FUNCTIONS
from taichi_nmm.result import COMPLETED

WALKING_SPEED_MPS = 0.3  # slower, a walker that lasted to the end has stood rather than walked


def walked(rows: NDArray[np.void]) -> NDArray[np.bool_]:
    """Which result rows lasted to the end and got somewhere, bool [n]."""
    fast = rows["mean_speed_mps"] >= WALKING_SPEED_MPS
    return np.asarray((rows["end_reason"] == COMPLETED) & fast)


def fell(rows: NDArray[np.void]) -> NDArray[np.bool_]:
    """Which result rows did not last to the end (fallen or diverged), bool [n]."""
    return np.asarray(rows["end_reason"] != COMPLETED)


def costs(rows: NDArray[np.void], cost: str) -> NDArray[np.float64]:
    """The named cost ("smooth" or "walking") of result rows, finite, [n]."""
    return COST_FUNCTIONS[cost](rows)


def finite(rows: NDArray[np.void]) -> NDArray[np.void]:
    """The rows with zero where a walker that diverged left no number, [n].

    Samplers never see a trial of no value, and a table of results has no gaps.
    """
    clean = rows.copy()
    for name in rows.dtype.names or ():
        if rows.dtype[name].kind == "f":
            clean[name] = np.nan_to_num(rows[name], nan=0.0, posinf=0.0, neginf=0.0)
    return clean
