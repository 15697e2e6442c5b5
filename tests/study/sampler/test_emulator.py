"""What worlds say between the rows: what is right at rows, errors elsewhere, and any table."""

from time import process_time

import numpy as np
import pytest
from numpy.testing import assert_allclose
from optuna.distributions import FloatDistribution
from sklearn.gaussian_process.kernels import Matern

from study import FeatureTable
from study.sampler.covariance import WORLD
from study.sampler.emulator import PESSIMISM

RNG = np.random.default_rng(6)
UNIT = RNG.uniform(size=(500, 3))
UNIT[1] = UNIT[0] + 1e-12  # as near as bred rows may be
SMOOTH = RNG.multivariate_normal(np.zeros(500), Matern(0.5, nu=2.5)(UNIT), 4).T
NOISE = RNG.standard_normal((500, 4))


def columns_of(costs):
    """Of rows by their costs in worlds [m, w], in units of a table: worlds, one, mean."""
    mean = costs.mean(axis=1)
    parts = (costs - mean[:, None]) / np.sqrt(costs.shape[1])
    return np.column_stack([parts, np.ones(len(costs)), mean])


def emulator_of(unit, costs):
    """Of costs in worlds [m, w], without features beside them, and the worlds."""
    columns = {f"x{place}": column for place, column in enumerate(unit.T)}
    space = dict.fromkeys(columns, FloatDistribution(0.0, 1.0))
    given = {"outcomes": costs, "better": "lower", "space": space}
    rows = FeatureTable.from_arrays(columns, **given).rows
    ensemble = rows.ensemble(np.ones(1))
    return rows.emulator(ensemble), ensemble


def size_of(columns):
    """Squares of what rows are off by in the mean and, as is expected of them, in worlds, [m]."""
    worlds = (columns[:, :-2] ** 2).sum(axis=1)
    return columns[:, -1] ** 2 + np.exp(WORLD.mode) * worlds


def told(emulator, places):
    """Columns, and their errors, at places each by the rows around it."""
    found = np.array([emulator.at(place) for place in places])
    c = emulator.columns.shape[1]
    assert_allclose(found[:, c + 1 :], places / emulator.shape.scales)
    found[:, c - 1] -= PESSIMISM * found[:, c]  # how much worse it is counted
    return found[:, :c], found[:, c]


@pytest.mark.parametrize("costs", [SMOOTH, SMOOTH + 0.02 * NOISE, NOISE])
def test_errors_are_as_large_as_it_says_and_grow_away_from_rows(costs):
    """Where costs are noise, by their spread alone, and within a factor of two."""
    emulator, ensemble = emulator_of(UNIT[:400], costs[:400])
    known = columns_of(ensemble.standard(costs))
    found, error = told(emulator, UNIT[400:])
    spread = np.sqrt(np.mean(size_of(known - known.mean(axis=0))))
    if costs is NOISE:
        assert 0.5 * spread < error.mean() < 2.0 * spread
        return
    assert 0.3 < np.mean(size_of(found - known[400:]) / error**2) < 3.0
    own, least = told(emulator, UNIT[:50])
    assert size_of(own - known[:50]).mean() < (0.25 * error.mean()) ** 2
    _, far = told(emulator, np.outer([0.5, 1.2, 3.0], np.ones(3)))
    assert least.max() < 0.5 * error.mean() < 0.25 * spread
    assert far[0] < 0.5 * far[1] < 0.5 * far[2] + 1e-9


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("count", [1, 2, 5, 40])
@pytest.mark.parametrize(
    "costs", [SMOOTH, SMOOTH[:, :1], SMOOTH[:, [0, 0]], 0.0 * SMOOTH]
)
def test_of_any_table_columns_errors_and_slopes_are_finite(costs, count):
    emulator, _ = emulator_of(UNIT[:count], costs[:count])
    points, pull = emulator.around(UNIT[:2]).placed(UNIT[:60])
    slopes = pull(np.ones_like(points.matrix))
    assert np.isfinite(points.matrix).all() and np.isfinite(slopes).all()


def test_a_large_table_takes_no_longer_than_a_proposal():
    unit = np.random.default_rng(1).random((20_000, 8))
    start = process_time()
    emulator, _ = emulator_of(unit, unit[:, :, None].mean(axis=1) + unit[:, :6] ** 2)
    emulator.around(unit[:6]).placed(unit[:512])
    assert process_time() - start < 1.0
