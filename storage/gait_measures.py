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

OBJECTIVE = "walked_fraction"
SLOWEST_MPS = 0.4  # who goes slower may be about to stand, which survives any ground


def objective(rows: NDArray[np.void], horizon_s: float) -> NDArray[np.float64]:
    """Share of the horizon that is walked, on average over the settings.

    That is the survived fraction of whoever walks, and the distance of whoever hardly does.
    Distance alone found gaits that climb stairs on fewer bodies.

    Args:
        rows: `RESULT_DTYPE`, [n, settings].
        horizon_s: of a walk.

    Returns:
        [n], 1 for those that never fall.
    """
    walked_s = np.minimum(rows["duration_s"], np.maximum(_distance(rows), 0.0) / SLOWEST_MPS)
    fraction: NDArray[np.float64] = walked_s.mean(axis=1) / horizon_s
    return fraction


def _distance(rows: NDArray[np.void]) -> NDArray[np.float64]:
    """Metres; of a walker that diverged, none."""
    return np.where(rows["end_reason"] == DIVERGED, 0.0, rows["distance_m"])


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
