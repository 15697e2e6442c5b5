"""Pools of which a similarity is known: factors of it, the posterior, and what a study finds."""

import numpy as np
import optuna
import pytest
import scipy
from numpy.testing import assert_allclose, assert_array_equal
from optuna.distributions import CategoricalDistribution

from study import FeatureKernelSampler, FeatureTable
from study.sampler.covariance import SIMILARITY
from study.sampler.similarity import Alike, factor_of_gram, factor_of_graph
from study.sampler.transforms import Points, log_excess
from tests.study.conftest import refused
from tests.study.sampler.studies import model_after, told

PLACES = np.random.default_rng(3).random((300, 2))
APART = ((PLACES[:, None] - PLACES[None]) ** 2).sum(axis=2)
GRAM = np.exp(-0.5 * APART / 0.3**2)
COST = np.hypot(*(PLACES - [0.7, 0.2]).T) + 0.05 * np.sin(20.0 * PLACES[:, 0])
RING = np.roll(np.eye(40), 1, axis=0) + np.roll(np.eye(40), -1, axis=0)


def trials_to_best(table, seed, cost=COST, rank=3):
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=seed))
    for number in range(1, 41):
        trial = study.ask()
        row = trial.suggest_int("row", 0, len(cost) - 1)
        assert study.tell(trial, float(cost[row])).user_attrs["row"] == row
        if cost[row] <= np.sort(cost)[rank - 1]:
            return number
    return 41


def test_factors_give_the_covariance_again():
    factor = factor_of_gram(GRAM)
    assert factor.shape[1] < 150  # it is smooth
    assert_allclose(factor @ factor.T, GRAM, atol=1e-4)
    assert_allclose(
        factor_of_gram(GRAM.astype("f4")) @ factor[7], GRAM[:, 7], atol=1e-3
    )
    plain = factor_of_gram(np.eye(5))
    assert_array_equal(plain @ plain.T, np.eye(5))
    graph = factor_of_graph(scipy.sparse.csr_array(RING), 4.0)
    laplacian = np.eye(40) - RING / 2.0
    matern = np.linalg.matrix_power(3.0 / 16.0 * np.eye(40) + laplacian, 3)
    expected = np.linalg.inv(scipy.linalg.sqrtm(matern).real)  # (...)^-3/2
    assert_allclose(graph @ graph.T, expected / expected[0, 0], atol=1e-8)


def test_no_node_of_a_graph_stands_out_before_a_trial():
    """At the rim, where nodes have few neighbours, the raw covariance is largest."""
    path = np.diag(np.ones(29), 1) + np.diag(np.ones(29), -1)
    path[:, 7] = path[7] = 0.0  # and one has none
    factor = factor_of_graph(path, 10.0)
    assert_allclose((factor**2).sum(axis=1), 1.0)
    assert (factor @ factor.T)[20, 21] > 0.9 and abs((factor @ factor.T)[7, 8]) < 1e-9


def test_the_posterior_is_that_of_the_gram_matrix():
    alike = Alike(factor_of_gram(GRAM))
    points = Points.of(alike.columns, np.empty((300, 0)))
    model = model_after(points.take(np.arange(9)), COST[:9], SIMILARITY, alike)
    size, noise = np.exp(model.posterior.theta)
    y = log_excess(COST[:9], COST[:9])
    gain = size * GRAM[:, :9] @ np.linalg.inv(size * GRAM[:9, :9] + noise * np.eye(9))
    mean, variance = model.posterior.predict(points)
    assert_allclose(mean, y.mean() + gain @ (y - y.mean()), atol=1e-3)
    left = size * np.diag(GRAM - gain @ GRAM[:9]) + noise
    assert_allclose(variance, y.var() * left, atol=1e-3)


def test_likeness_finds_the_best_rows_sooner_than_chance():
    table = FeatureTable.from_kernel(GRAM)
    assert repr(table).startswith(
        "FeatureTable(300 rows, 1 parameter, similarity of rank "
    )
    found = [trials_to_best(table, seed) for seed in range(6)]
    assert np.mean(found) < 20  # at random 75
    ring = np.minimum(np.arange(40), 40 - np.arange(40)) ** 1.5
    graph = FeatureTable.from_graph(RING)
    # At random it would be 20.5.
    assert np.mean([trials_to_best(graph, seed, ring, 1) for seed in range(6)]) < 15


def test_rows_may_have_names_and_a_study_is_examined():
    words = [f"molecule {row}" for row in range(300)]
    table = FeatureTable.from_kernel(GRAM, {"name": words})
    sampler = FeatureKernelSampler(table, seed=1)
    study, choices = optuna.create_study(sampler=sampler), [*words, "other"]
    space = {"name": CategoricalDistribution(choices)}
    told(study, space, {"name": "other"}, 0.0)  # of no row: it has no likeness
    with pytest.warns(UserWarning, match="no row of the table are ignored"):
        study.optimize(
            lambda t: COST[words.index(t.suggest_categorical("name", choices))],
            n_trials=20,
        )
    worth, best = str(sampler.worth(study)), sampler.best(study)
    assert "worth" in worth or "explain" in worth
    assert best.row == words.index(best.params["name"])


GRAPH, KERNEL = FeatureTable.from_graph, FeatureTable.from_kernel


@pytest.mark.parametrize(
    ("make", "given", "match"),
    [
        (KERNEL, np.ones((2, 3)), r"^table.gram.shape: \(2, 3\) .* \[n, n\]"),
        (KERNEL, [["a"]], r"^table.gram\[0, 0\]: .a. .* an array of numbers"),
        (KERNEL, np.array([["a"]]), r"^table.gram: '<U1' .* numbers"),
        (
            KERNEL,
            [[np.nan]],
            "^table.gram: 'not symmetric, or not finite' .* semidefinite",
        ),
        (
            KERNEL,
            [[1.0, 0.5], [0.2, 1.0]],
            "^table.gram: 'not symmetric, or not finite'",
        ),
        (
            KERNEL,
            [[1.0, 2.0], [2.0, 1.0]],
            "^table.gram: 'no variance that row 0 can have' .* semidefinite",
        ),
        (
            KERNEL,
            [[1.0, 0.0], [0.0, -1.0]],
            r"^table.gram\[1, same\]: -1.0 .* semidefinite",
        ),
        (KERNEL, np.zeros((2, 2)), "^table.gram"),
        (GRAPH, np.ones((2, 3)), r"^table.weights.shape: \(2, 3\)"),
        (GRAPH, "road", "^table.weights: 'str' .* weights of edges"),
        (GRAPH, -RING, "^table.weights: 'a negative or infinite weight'"),
        (GRAPH, np.triu(RING), "^table.weights: 'not symmetric'"),
        (
            lambda rows: KERNEL(GRAM, {"row": rows}),
            [1, 2, 3],
            r"^table.row.shape: \(3,\)",
        ),
        (
            lambda near: FeatureKernelSampler(KERNEL(GRAM), off_grid=near),
            9,
            r"^off_grid: 9 .* a similarity knows its rows alone",
        ),
    ],
)
def test_what_is_refused(make, given, match):
    with refused(match):
        make(given)
