"""What the search breeds gaits for, and what tells them apart."""

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.result import DIVERGED

# Columns of a result, each with the range that an archive covers: what lies beyond is in its last
# cell. Slow and fast, short and long steps, feet that are lifted little and much.
MEASURES: tuple[tuple[str, float, float], ...] = (
    ("mean_speed_mps", 0.4, 2.0),
    ("step_length_mean_m", 0.3, 1.0),
    ("knee_peak_swing_rad", 0.5, 1.8),
)
MEASURE_NAMES = tuple(name for name, _, _ in MEASURES)
MEASURE_RANGES = tuple((low, high) for _, low, high in MEASURES)
MEASURE_CELLS = (8,) * len(MEASURES)

OBJECTIVE_MPS = "progress_mps"


def objective(rows: NDArray[np.void], horizon_s: float) -> NDArray[np.float64]:
    """Distance over the horizon, on average over the settings: a gait that falls early is slow.

    Survival alone would prefer, of two gaits that fall at the same step of a stair, the slower one.

    Args:
        rows: `RESULT_DTYPE`, [n, settings].
        horizon_s: of a walk.

    Returns:
        [n], in m/s.
    """
    went_m = np.where(rows["end_reason"] == DIVERGED, 0.0, rows["distance_m"])
    progress: NDArray[np.float64] = went_m.mean(axis=1) / horizon_s
    return progress


def measures(rows: NDArray[np.void]) -> NDArray[np.float64]:
    """The `MEASURES` on average over the settings, each weighted by how long it was walked.

    Args:
        rows: `RESULT_DTYPE`, [n, settings].

    Returns:
        [n, m].
    """
    walked_s = np.maximum(rows["duration_s"], 1e-3)  # a walker may diverge at once
    weight = walked_s / walked_s.sum(axis=1, keepdims=True)
    finite = (np.nan_to_num(rows[name], posinf=0.0, neginf=0.0) for name in MEASURE_NAMES)
    return np.column_stack([(values * weight).sum(axis=1) for values in finite])


def cells(measured: NDArray[np.float64]) -> NDArray[np.int64]:
    """Numbers of the archive's cells that measures [n, m] lie in, [n]."""
    low, high = np.transpose(MEASURE_RANGES)
    place = (measured - low) / (high - low) * MEASURE_CELLS
    inside = np.clip(place.astype(np.int64), 0, np.array(MEASURE_CELLS) - 1)
    return np.asarray(np.ravel_multi_index(tuple(inside.T), MEASURE_CELLS), dtype=np.int64)
