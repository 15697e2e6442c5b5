"""Published ranges of able-bodied walking at natural cadence, to hold a simulated gait against.

Joint angles and ground forces follow the natural-cadence ensemble means and standard deviations of
Winter (1991), The Biomechanics and Motor Control of Human Gait, also in Winter (2009). The tables
are approximate: read at uneven steps, good to about 3 deg and 0.05 body weights; enough to judge by
eye or to steer a search, not to fit. Muscle phases are the electromyographic on and off times of
Perry (1992), Gait Analysis, rounded to a few percent.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

SOURCE = "human ± 1 sd, approximate, after Winter (1991)"
EMG_SOURCE = "human EMG on, approximate, after Perry (1992)"


@dataclass(frozen=True)
class HumanRange:
    """Mean and standard deviation of a quantity over a stride, 0 % = heel strike.

    Attributes:
        rows: (percent of stride, mean, standard deviation), percent from 0 to 100.
    """

    rows: tuple[tuple[float, float, float], ...]

    def at(self, percent: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and standard deviation at these percentages, each of their shape."""
        table = np.array(self.rows)
        curves = PchipInterpolator(table[:, 0], table[:, 1:])(percent)
        return curves[..., 0], curves[..., 1]


HIP_FLEXION_DEG = HumanRange((
    (0, 19.5, 7.0), (5, 18.5, 7.0), (10, 16.5, 6.9), (15, 13.0, 6.8), (20, 8.5, 6.7),
    (25, 4.0, 6.7), (30, 0.0, 6.6), (35, -3.7, 6.5), (40, -7.0, 6.5), (45, -9.7, 6.6),
    (50, -11.2, 6.8), (55, -10.2, 7.0), (60, -5.0, 7.2), (65, 2.8, 7.1), (70, 10.5, 6.8),
    (75, 16.5, 6.6), (80, 20.2, 6.6), (85, 22.0, 6.7), (90, 21.3, 6.9), (95, 19.8, 7.0),
    (100, 19.5, 7.0),
))  # fmt: skip

KNEE_FLEXION_DEG = HumanRange((
    (0, 4.0, 5.2), (5, 11.5, 5.7), (10, 18.0, 6.0), (15, 21.0, 6.2), (20, 19.8, 6.0),
    (25, 16.2, 5.7), (30, 12.3, 5.4), (35, 9.4, 5.3), (40, 8.0, 5.3), (45, 9.3, 5.7),
    (50, 14.3, 6.5), (55, 24.0, 7.4), (60, 38.2, 7.8), (65, 53.0, 7.0), (70, 62.3, 5.9),
    (73, 64.3, 5.4), (76, 62.8, 5.2), (80, 56.0, 5.6), (85, 42.0, 6.6), (90, 24.0, 6.8),
    (95, 8.2, 5.6), (97.5, 3.6, 5.1), (100, 4.0, 5.2),
))  # fmt: skip

DORSIFLEXION_DEG = HumanRange((
    (0, 0.0, 4.2), (3, -3.2, 4.4), (6, -4.9, 4.6), (10, -3.4, 4.4), (15, 0.8, 4.0),
    (20, 3.6, 3.8), (25, 5.5, 3.7), (30, 6.9, 3.6), (35, 8.2, 3.7), (40, 9.3, 3.8),
    (44, 9.7, 4.0), (48, 8.2, 4.5), (52, 3.3, 5.2), (56, -5.7, 6.0), (60, -15.9, 6.4),
    (63, -19.7, 6.4), (66, -17.6, 6.2), (70, -11.3, 5.6), (75, -4.4, 4.9), (80, -0.4, 4.4),
    (85, 1.4, 4.1), (89, 1.9, 4.0), (95, 0.6, 4.1), (100, 0.0, 4.2),
))  # fmt: skip

VERTICAL_FORCE_BW = HumanRange((
    (0, 0.02, 0.02), (2, 0.35, 0.12), (5, 0.66, 0.14), (8, 0.92, 0.13), (11, 1.07, 0.11),
    (14, 1.12, 0.09), (17, 1.08, 0.08), (20, 0.98, 0.08), (25, 0.82, 0.08), (30, 0.75, 0.08),
    (35, 0.80, 0.08), (40, 0.94, 0.07), (45, 1.07, 0.07), (48, 1.10, 0.08), (51, 1.02, 0.11),
    (54, 0.74, 0.14), (57, 0.36, 0.12), (60, 0.09, 0.06), (62, 0.0, 0.0), (100, 0.0, 0.0),
))  # fmt: skip

FORWARD_FORCE_BW = HumanRange((
    (0, 0.0, 0.01), (2, 0.0, 0.04), (5, -0.09, 0.04), (8, -0.15, 0.04), (11, -0.17, 0.04),
    (14, -0.15, 0.04), (20, -0.09, 0.03), (26, -0.03, 0.02), (31, 0.0, 0.02), (37, 0.06, 0.02),
    (43, 0.14, 0.03), (48, 0.20, 0.03), (51, 0.21, 0.03), (54, 0.17, 0.04), (57, 0.09, 0.03),
    (60, 0.02, 0.02), (62, 0.0, 0.0), (100, 0.0, 0.0),
))  # fmt: skip

# On and off in percent of the stride; an interval that spans the heel strike is given as two.
EMG_ON_PERCENT: dict[str, tuple[tuple[float, float], ...]] = {
    "SOL": ((7, 52),),
    "TA": ((0, 13), (56, 100)),
    "GAS": ((9, 50),),
    "VAS": ((0, 18), (90, 100)),
    "HAM": ((0, 12), (80, 100)),
    "GLU": ((0, 25), (95, 100)),
    "HFL": ((54, 76),),
}
