import numpy as np
import pytest
from scipy.stats import qmc

from storage.points import sobol_points
from taichi_nmm.parameters import GAINS, LOW_LEVEL_GAINS, lower_bounds, upper_bounds


@pytest.mark.filterwarnings("error")
def test_points_are_of_one_long_run_warn_of_no_length_and_fill_the_bounds_evenly():
    whole = sobol_points(3, 0, 512, GAINS)
    for first, count in ((0, 100), (100, 7), (107, 405), (511, 1)):
        assert np.array_equal(
            sobol_points(3, first, count, GAINS), whole[first : first + count]
        )
    assert sobol_points(0, 0, 5, GAINS).shape == (5, 16)
    points = sobol_points(3, 0, 1024, GAINS)
    unit = (points - lower_bounds()) / (upper_bounds() - lower_bounds())
    assert unit.min() >= 0 and unit.max() <= 1
    counts = [np.histogram(column, bins=16, range=(0, 1))[0] for column in unit.T]
    # a Sobol sequence's promise, not a random one's
    assert np.all(np.array(counts) == 64)
    assert qmc.discrepancy(unit[:, :4]) < 1e-3
    assert not np.any(sobol_points(3, 0, 8, GAINS) == sobol_points(4, 0, 8, GAINS))
    theta_ref = LOW_LEVEL_GAINS[7]
    group = (*GAINS, theta_ref)
    points = sobol_points(3, 0, 256, group)
    unit = (points[:, 16] - theta_ref.low) / (theta_ref.high - theta_ref.low)
    assert np.histogram(unit, bins=16, range=(0, 1))[0].tolist() == [16] * 16
    assert np.array_equal(sobol_points(3, 100, 7, group), points[100:107])
