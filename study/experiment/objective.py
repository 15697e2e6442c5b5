"""What became of a trial: its cost, and whether it walked."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.cost import smooth_cost, walking_cost
from taichi_nmm.result import COMPLETED, END_REASONS, SCORE_FIELDS

COST_FUNCTIONS = {"smooth": smooth_cost, "walking": walking_cost}  # the paper's two
WALKING_SPEED_MPS = 0.3  # slower, a walker that lasted to the end has stood rather than walked

# What is kept of a trial beside its cost: how it ended, and the components of the score.
OUTCOMES = ("duration_s", "distance_m", "mean_speed_mps", "cost_of_transport_jpkgpm")
KEPT = (*OUTCOMES, *(name for name, _ in SCORE_FIELDS))

MEASURES = ("duration_s", "distance_m", "mean_speed_mps")  # what words about a walk name

# What a reader of a study database wants to know of a trial, beside its parameters and cost.
ATTRIBUTES = (
    "duration_s", "distance_m", "mean_speed_mps", "end_reason", "walked", "phi_printed",
    "phi_corrected", "survived_fraction",
)  # fmt: skip


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


def metric_name(cost: str) -> str:
    """What the named cost is called where a study shows it: as its function in `taichi_nmm`."""
    return COST_FUNCTIONS[cost].__name__


def finite(rows: NDArray[np.void]) -> NDArray[np.void]:
    """The rows with zero where a walker that diverged left no number, [n].

    Samplers never see a trial of no value, and a table of results has no gaps.
    """
    clean = rows.copy()
    for name in rows.dtype.names or ():
        if rows.dtype[name].kind == "f":
            clean[name] = np.nan_to_num(rows[name], nan=0.0, posinf=0.0, neginf=0.0)
    return clean


def attributes(rows: NDArray[np.void]) -> dict[str, Any]:
    """`ATTRIBUTES` of one result row, [1], as plain values."""
    columns = {"walked": walked(rows), "end_reason": np.array(END_REASONS)[rows["end_reason"]]}
    found = {name: columns[name] if name in columns else rows[name] for name in ATTRIBUTES}
    return {name: values[0].item() for name, values in found.items()}


def row_text(row: np.void) -> str:
    """How the walk of a result row ended, in words."""
    shown = {name: row[name] for name in MEASURES}
    return outcome_text(shown | {"end_reason": END_REASONS[row["end_reason"]]})


def outcome_text(shown: Mapping[str, Any]) -> str:
    """How a walk ended, in words: from end_reason, duration_s, distance_m and mean_speed_mps."""
    reason = shown["end_reason"]
    how = "walked" if reason == END_REASONS[COMPLETED] else f"{reason} after"
    reached = f"{shown['duration_s']:.1f} s, {shown['distance_m']:.1f} m"
    return f"{how} {reached} at {shown['mean_speed_mps']:.2f} m/s"
