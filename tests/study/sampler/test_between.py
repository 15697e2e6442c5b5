"""What rows tell of points between them: kriging against its linear system, and the choice."""

from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.distance import cdist

from study import FeatureTable
from study.sampler import between, gp
from study.sampler.covariance import EUCLIDEAN, GuessError, fall, new_covariance
from study.sampler.transforms import new_columns
from study.sampler.worlds import Ensemble

D = 3
RNG = np.random.default_rng(0)
UNIT = RNG.random((400, D))
BOWL = ((UNIT - 0.45) ** 2).sum(axis=1)
# Half of all walkers fall, each for reasons of its own.
FALLS = np.where(RNG.random(400) < 0.5, 2.0 + RNG.random(400), BOWL)


def covariance():
    return new_covariance(EUCLIDEAN, new_columns(0, D), D)


def matern(a, b, theta):
    """t^2 (1 + q + q^2 / 3) exp(-q), q = sqrt 5 times the distance in length scales."""
    variance, *lengths = np.exp(theta[:-1])
    q = np.sqrt(5.0) * cdist(a / lengths, b / lengths)
    return variance * (1.0 + q + q**2 / 3.0) * np.exp(-q)


def test_kriging_is_the_solution_of_its_system():
    """Weights of sum 1 with the least expected error: K w + lambda = k, 1 . w = 1."""
    theta = np.log([1.5, 0.4, 0.9, 2.0, 1e-3])
    x, points = UNIT[:50], RNG.random((7, D))
    columns = np.column_stack([BOWL[:50], FALLS[:50], 100.0 + BOWL[:50]])
    system = np.ones((51, 51))
    system[:50, :50] = matern(x, x, theta) + (1e-3 + gp.JITTER) * np.eye(50)
    system[50, 50] = 0.0
    right = np.vstack([matern(x, points, theta), np.ones(7)])
    weights = np.linalg.solve(system, right)[:50]
    found = between.kriged(covariance(), theta, x, columns, points)
    assert_allclose(found, weights.T @ columns, rtol=1e-8)


def test_where_kriging_has_no_solution_the_nearest_rows_are_asked(monkeypatch):
    monkeypatch.setattr(between, "cholesky", lambda *_: (np.empty((50, 50)), True))
    x, columns, points = UNIT[:50], BOWL[:50, None], UNIT[50:53]
    found = between.kriged(covariance(), covariance().start, x, columns, points)
    assert_allclose(found, between.nearest_mean(x, columns, points))


def error_at_the_best(guess, mean):
    """Mean error of the guesses of the best ten rows, each left out."""
    errors = []
    for row in np.argsort(mean)[:10]:
        others = np.arange(len(mean)) != row
        rows = between.Between(UNIT[others], guess, beside=1)
        place = UNIT[row][None]
        errors.append(rows.at(mean[others, None], place, place)[0, 0] - mean[row])
    return float(np.mean(errors))


def test_smooth_costs_are_kriged_and_the_best_place_is_no_longer_slandered():
    guess = between.chosen_guess(UNIT, BOWL)
    assert isinstance(guess, partial) and guess.func is between.kriged
    slander = error_at_the_best(between.nearest_mean, BOWL)
    assert slander > 0.0
    assert abs(error_at_the_best(guess, BOWL)) < 0.1 * slander


@pytest.mark.parametrize(
    "mean",
    [
        pytest.param(FALLS, id="jagged"),
        pytest.param(RNG.random(400), id="noise"),
        pytest.param(np.zeros(400), id="equal"),
    ],
)
def test_costs_that_are_not_smooth_are_those_of_the_nearest_rows(mean):
    assert between.chosen_guess(UNIT, mean) is between.nearest_mean


@pytest.mark.parametrize("count", [1, 2, between.LEAST_TAUGHT - 1])
def test_few_rows_teach_nothing(count):
    guess = between.chosen_guess(UNIT[:count], BOWL[:count])
    assert guess is between.nearest_mean
    rows = between.Between(UNIT[:count], guess, beside=1)
    found = rows.at(BOWL[:count, None], UNIT[50:53], UNIT[:1])
    assert np.isfinite(found).all()


def test_each_point_is_guessed_from_the_rows_near_its_centre():
    centres = np.array([[0.1, 0.1, 0.1], [0.9, 0.9, 0.9]])
    points = centres + 0.02
    columns = np.arange(400.0)[:, None]
    seen = []

    def guess(x, own, asked):
        seen.append((x, asked))
        return own[:1].repeat(len(asked), axis=0)

    between.Between(UNIT, guess, beside=1).at(columns, points, centres)
    for (x, asked), centre, point in zip(seen, centres, points, strict=True):
        away = np.linalg.norm(UNIT - centre, axis=1)
        nearest = np.sort(np.argsort(away)[: between.NEAR_POOL])
        assert_allclose(x, UNIT[nearest])
        assert_allclose(asked, point[None])


def test_rows_near_a_centre_are_found_once_and_few_are_kept():
    rows = between.Between(UNIT)
    centres = RNG.random((3 * between.KEPT_POOLS, D))
    for centre in [*centres, *centres[-3:]]:
        squares = ((UNIT - centre) ** 2).sum(axis=1)
        nearest = np.sort(np.argsort(squares)[: between.NEAR_POOL])
        assert rows.pool(centre).tolist() == nearest.tolist()
    assert len(rows._pools) <= between.KEPT_POOLS
    assert rows.pool(centres[-1]) is rows.pool(centres[-1])


def test_features_beside_worlds_are_the_nearest_rows_mean():
    """Kriging knows the worlds' length scales alone: of jagged features it makes wild ones."""
    columns = np.column_stack([FALLS, BOWL])
    guess = between.chosen_guess(UNIT, BOWL)
    points = UNIT[:5] + 0.01
    found = between.Between(UNIT, guess, beside=1).at(columns, points, UNIT[:5])
    plain = between.Between(UNIT).at(columns, points, UNIT[:5])
    assert_allclose(found[:, 0], plain[:, 0])
    assert np.abs(found[:, 1] - plain[:, 1]).min() > 0.0


def test_a_table_decides_once_and_not_for_goals_that_are_drawn():
    parameters = {f"x{column}": UNIT[:, column] for column in range(D)}
    costs = 1.0 + np.column_stack([BOWL, 1.5 * BOWL])
    rows = FeatureTable.from_arrays(parameters, outcomes=costs).rows
    ensemble = rows.ensemble(np.ones(1))
    chosen = rows.between(ensemble)
    assert isinstance(chosen.guess, partial) and rows.between(ensemble) is chosen
    assert rows.between().guess is between.nearest_mean
    drawn = Ensemble(rows.worlds, costs)
    assert rows.between(drawn).guess is between.nearest_mean
    assert ensemble.is_smooth and not drawn.is_smooth


# The best rows lie anywhere, each alone: those around it cost what the table does.
ALONE = np.where(RNG.random(400) < 0.1, -4.0 + 0.1 * RNG.random(400), 1.0)


def test_a_guess_is_doubted_where_it_is_off_by_more_than_costs_differ():
    alone = (ALONE - ALONE.mean()) / ALONE.std()
    best = np.argsort(alone, kind="stable")[: between.BEST_ROWS]
    errors, nearest = [], []
    for row in best:
        others = np.arange(len(alone)) != row
        x, place = UNIT[others], UNIT[row][None]
        errors.append(between.nearest_mean(x, alone[others, None], place) - alone[row])
        nearest.append(cdist(place, x).min())
    found = between.error_of_guess(UNIT, alone)
    assert found is not None and found.variance > 1.0
    assert_allclose(found.variance, np.mean(np.square(errors)))
    assert_allclose(found.length, np.median(nearest) / 2.0, rtol=1e-6)


@pytest.mark.parametrize(
    "mean",
    [
        pytest.param(BOWL / BOWL.std(), id="smooth"),
        pytest.param(np.zeros(400), id="equal"),
        pytest.param(ALONE[: between.LEAST_TAUGHT - 1], id="few rows"),
    ],
)
def test_a_guess_that_tells_something_is_believed(mean):
    assert between.error_of_guess(UNIT[: len(mean)], mean) is None


def test_the_gap_is_none_at_a_row_and_grows_with_the_distance():
    columns = np.column_stack([BOWL, np.zeros(400)])
    error = GuessError(1.0, 0.05)
    rows = between.Between(UNIT, beside=2, error=error)
    step = np.array([1.0, 0.0, 0.0])
    away = np.array([0.0, 0.01, 0.03, 40.0])
    points = UNIT[7] + away[:, None] * step
    found = rows.at(columns, points, UNIT[7][None])
    plain = between.Between(UNIT, beside=2).at(columns, points, UNIT[7][None])
    assert_allclose(found[:, 0], plain[:, 0])
    assert_allclose(plain[:, 1], 0.0)
    nearest = cdist(points, UNIT).min(axis=1)
    k = fall(-0.5 * (nearest / error.length) ** 2, rough=True)
    assert_allclose(found[:, 1], np.sqrt(1.0 - k**2), atol=1e-6)
    assert found[0, 1] < 1e-3 and found[-1, 1] == 1.0
    assert (np.diff(found[:, 1]) > 0.0).all()


def test_only_a_table_of_costs_doubts_its_guess_and_a_row_is_as_it_was():
    parameters = {f"x{column}": UNIT[:, column] for column in range(D)}
    outcomes = 5.0 + np.column_stack([ALONE, ALONE])
    table = FeatureTable.from_arrays(parameters, outcomes=outcomes)
    ensemble = table.rows.ensemble(np.ones(1))
    assert ensemble.guess_error is not None
    assert table.rows.between(ensemble).error == ensemble.guess_error
    assert_allclose(ensemble.columns[:, -1], 0.0)
    ranked = FeatureTable.from_arrays(parameters, outcomes=outcomes, better="lower")
    assert ranked.rows.ensemble(np.ones(1)).guess_error is None
    assert Ensemble(table.rows.worlds, outcomes).guess_error is None  # drawn goals
    single = FeatureTable.from_arrays(parameters, outcomes=outcomes[:, :1])
    assert single.rows.ensemble(np.ones(1)).guess_error is None
