"""The two costs of Antonova, Rai, Atkeson 2016, as functions of result rows.

What the paper leaves open: the speed term of the smooth cost is taken as a deviation, and the
distance of a walker that fell backward as zero, since 1/(1 + d) has a pole at -1 m.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm import checks
from taichi_nmm.errors import InputError
from taichi_nmm.result import COMPLETED, HUMAN_SPEED_MPS

FALL_COST = 300.0
SPEED_WEIGHT = 100.0
NEEDED = (
    "distance_m", "duration_s", "mean_speed_mps", "cost_of_transport_jpkgpm", "end_reason",
)  # fmt: skip


def _rows(field: str, value: Any) -> Any:
    """Result rows: a structured array with the columns that a cost is made of."""
    names = getattr(getattr(value, "dtype", None), "names", None) or ()
    for name in NEEDED:
        if name not in names or value.dtype[name].kind not in "fiu":
            raise InputError(field, value, f"rows of a Result, with numbers in the column {name}")
    return value


_checked = checks.checked(rows=_rows, target_speed_mps=checks.number())


@_checked
def smooth_cost(
    rows: NDArray[np.void], target_speed_mps: float = HUMAN_SPEED_MPS
) -> NDArray[np.float64]:
    """1/(1 + t) + 0.3/(1 + d) + 0.01 |s - s_target| of each row, [n].

    t is the time walked in s, d the final hip position in m, s the mean speed in m/s.
    """
    distance = np.maximum(rows["distance_m"], 0.0)
    speed_error = np.abs(rows["mean_speed_mps"] - target_speed_mps)
    return np.asarray(
        1.0 / (1.0 + rows["duration_s"]) + 0.3 / (1.0 + distance) + 0.01 * speed_error
    )


@_checked
def walking_cost(
    rows: NDArray[np.void], target_speed_mps: float = HUMAN_SPEED_MPS
) -> NDArray[np.float64]:
    """300 - x_fall of a walker that fell, else 100 |v - v_target| + cost of transport, [n].

    x_fall is the distance before the fall in m, the cost of transport in J/(kg m). A walker that
    stood still until the end counts as walking, and pays 130 for its speed.
    """
    fell = FALL_COST - np.maximum(rows["distance_m"], 0.0)
    walked = (
        SPEED_WEIGHT * np.abs(rows["mean_speed_mps"] - target_speed_mps)
        + rows["cost_of_transport_jpkgpm"]
    )
    return np.asarray(np.where(rows["end_reason"] == COMPLETED, walked, fell))
