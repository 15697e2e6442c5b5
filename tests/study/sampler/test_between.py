"""What rows tell of points between them: kriging against its linear system, and the choice."""

from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.distance import cdist

from study import FeatureTable
from study.sampler import between, gp
from study.sampler.covariance import EUCLIDEAN, new_covariance
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
