"""Costs in worlds as a Gaussian process: against NumPy, and what the sampler makes of it."""

import pickle
from itertools import product
from typing import Any

import numpy as np
import optuna
import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from scipy.stats import multivariate_normal

from study import FeatureTable, WorldSampler
from study.sampler import worlds as module
from study.sampler.worlds import LENGTHS, NOISE, PRIOR, SHIFT, SIZES, WORLD_WEIGHTS, Worlds
from taichi_nmm.errors import InputError

SPACE = {"x": FloatDistribution(0.0, 1.0), "y": FloatDistribution(1.0, 100.0, log=True)}
ROWS = np.random.default_rng(5).random((60, 2))
PLACES = np.array([[0.2, 0.2], [0.2, 0.3], [0.8, 0.7], [0.8, 0.8]])  # of the best, in four worlds


def cost(unit: Any, place: Any) -> Any:
    return 0.1 + 10.0 * ((np.atleast_2d(unit) - place) ** 2).sum(axis=1)


def table(costs: Any = None, space: Any = SPACE) -> FeatureTable:
    columns = {"x": ROWS[:, 0], "y": 100.0 ** ROWS[:, 1]}
    costs = np.column_stack([cost(ROWS, place) for place in PLACES]) if costs is None else costs
    return FeatureTable.from_arrays(columns, costs, space=space)


def robot(trial: optuna.Trial, place: Any = (0.85, 0.75)) -> float:
    x, y = trial.suggest_float("x", 0, 1), trial.suggest_float("y", 1, 100, log=True)
    return float(cost([x, np.log(y) / np.log(100.0)], np.array(place))[0])


def studied(sampler: WorldSampler, trials: int, sign: float = 1.0) -> optuna.Study:
    study = optuna.create_study(sampler=sampler, direction="minimize" if sign > 0 else "maximize")
    study.optimize(lambda trial: sign * robot(trial), n_trials=trials)
    return study


def test_the_posterior_is_that_of_the_covariance_in_the_docstring() -> None:
    rng, known = np.random.default_rng(1), Worlds(ROWS, table().rows.features)
    seen, values, points = rng.random((7, 2)), rng.standard_normal(7), rng.random((5, 2))
    mean, deviation = module.posterior(known, seen, values, points, known.near(points))
    every = np.vstack([seen, points])
    m, d = known.near(every)
    apart = np.sqrt(((every[:, None] - every[None]) ** 2).sum(axis=2))
    scores, found = [], []
    for constants in product(WORLD_WEIGHTS, SIZES, LENGTHS):
        a, t, length = constants
        z = np.sqrt(5.0) * apart / length
        k = a**2 * d @ d.T + SHIFT**2 + t**2 * (1 + z + z**2 / 3) * np.exp(-z)
        own = k[:7, :7] + NOISE**2 * np.eye(7)
        prior = sum(
            (np.log(v / mid) / s) ** 2 for v, (mid, s) in zip(constants, PRIOR, strict=True)
        )
        scores.append(multivariate_normal(m[:7], own).logpdf(values) - 0.5 * prior)
        gain = k[7:, :7] @ np.linalg.inv(own)
        found.append((m[7:] + gain @ (values - m[:7]), np.diag(k[7:, 7:] - gain @ k[:7, 7:])))
    expected, variance = found[int(np.argmax(scores))]
    np.testing.assert_allclose(mean, expected, rtol=1e-8)
    np.testing.assert_allclose(deviation**2, variance, rtol=1e-6)


def test_a_row_has_its_own_costs_and_a_point_off_the_table_those_of_its_neighbours() -> None:
    known = Worlds(ROWS, table().rows.features)
    mean, parts = known.near(ROWS)
    np.testing.assert_allclose(mean, known.mean, atol=1e-3)
    np.testing.assert_allclose(parts, known.parts, atol=1e-3)
    assert known.is_log and abs(known.standard(known.costs).std() - 1.0) < 1e-12
    assert not Worlds(ROWS, known.costs - 1.0).is_log


def test_it_begins_with_the_ranking_learns_the_world_and_leaves_the_table() -> None:
    costs = table().rows.features
    study = studied(WorldSampler(table(), seed=1), 15)
    first = study.trials[0].params["x"]
    assert first == ROWS[np.argmin(np.log(costs).mean(axis=1)), 0]
    rows = cost(ROWS, np.array([0.85, 0.75]))
    values = [trial.values[0] for trial in study.trials]
    assert min(values[:5]) <= np.sort(rows)[2]  # among the best three rows of this robot
    assert min(values) < rows.min() and study.best_params["x"] not in ROWS[:, 0]


def test_proposals_depend_on_the_trials_and_the_seed_alone() -> None:
    whole = studied(WorldSampler(table(), seed=3), 8)
    half = studied(pickle.loads(pickle.dumps(WorldSampler(table(), seed=3))), 4)
    half.sampler = WorldSampler(table(), seed=3)
    half.optimize(robot, n_trials=4)
    params = [trial.params for trial in whole.trials]
    assert params == [trial.params for trial in half.trials]
    assert params != [trial.params for trial in studied(WorldSampler(table(), seed=4), 8).trials]
    negative = WorldSampler(table(-table().rows.features), seed=3)
    assert studied(negative, 8, sign=-1.0).best_value > -min(t.values[0] for t in whole.trials) - 1
    assert repr(negative) == "WorldSampler(FeatureTable(60 rows, 2 parameters, 4 features: " \
        "feature_0, feature_1, feature_2, ...), seed=3)"  # fmt: skip


def test_trials_that_run_elsewhere_are_not_proposed_again_and_infinite_costs_are_told() -> None:
    study = optuna.create_study(sampler=WorldSampler(table(), seed=1))
    asked = [study.ask(SPACE) for _ in range(3)]
    assert len({tuple(trial.params.values()) for trial in asked}) == 3
    for trial, value in zip(asked, (np.inf, 2.0, -np.inf), strict=True):
        study.tell(trial, value)
    more = [study.ask(SPACE) for _ in range(3)]
    assert len({tuple(trial.params.values()) for trial in (*asked, *more)}) == 6


def test_choices_and_whole_numbers_stay_what_they_are_and_gaps_are_left_out() -> None:
    rng = np.random.default_rng(2)
    columns = {"n": rng.integers(1, 9, 40), "kind": rng.choice(["a", "b"], 40), "x": rng.random(40)}
    costs = rng.random((40, 3)) + 0.5
    costs[:20, 1], costs[3] = np.nan, 0.01
    costs[3, 1] = np.nan
    space = {"n": IntDistribution(1, 9), "kind": CategoricalDistribution(["a", "b"])}
    sampler = WorldSampler(FeatureTable.from_arrays(columns, costs, space=space), seed=1)
    study = optuna.create_study(sampler=sampler)
    study.optimize(lambda t: t.suggest_int("n", 1, 9) + (t.suggest_categorical("kind", ["a", "b"])
                   == "a") + t.suggest_float("x", columns["x"].min(), columns["x"].max())
                   + t.suggest_float("other", 0, 1), n_trials=12)  # fmt: skip
    assert study.trials[0].params["x"] in columns["x"][20:] and study.best_value < 4.0


@pytest.mark.parametrize(("costs", "match"), [
    (np.ones((60, 1)), "^table: 1 .* 2 worlds or more"),
    (np.where(np.arange(180).reshape(60, 3) % 3 == 1, np.nan, 1.0), "^table: 'gaps in all rows'"),
])  # fmt: skip
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_tables_that_are_refused(costs: Any, match: str) -> None:
    with pytest.raises(InputError, match=match):
        WorldSampler(table(costs), seed=1)
