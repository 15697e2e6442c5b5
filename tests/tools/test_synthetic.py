"""The synthetic problems: features that are worth what they are said to be, decided by seeds."""

import numpy as np
import pytest
from scipy.stats import spearmanr

from taichi_nmm.errors import InputError
from tools import synthetic
from tools.synthetic import DIMENSION, NAMES, PROBLEMS, Problem, problem

SEEDS = range(5)


def worth(made: Problem) -> float:
    """Rank correlation of feature and cost over the table."""
    rows = made.rows()
    return float(spearmanr(made.features(rows)[:, 0], made.cost(rows)).statistic)


@pytest.mark.parametrize("seed", SEEDS)
def test_informative_features_rank_rows_as_costs_and_the_useless_says_nothing(seed: int) -> None:
    assert 0.75 < worth(problem("informative", seed)) < 0.97
    assert 0.75 < worth(problem("informative-bowl", seed)) < 0.97
    made = problem("useless", seed)
    assert abs(worth(made)) < 0.06
    rows = made.rows()
    columns = np.hstack([rows, rows**2, made.features(rows)])
    explained = np.corrcoef(columns, rowvar=False)[-1, :-1]
    assert np.abs(explained).max() < 0.08


@pytest.mark.parametrize("seed", SEEDS)
def test_the_misleading_feature_is_right_of_most_rows_and_wrong_of_the_best(seed: int) -> None:
    made = problem("misleading", seed)
    rows = made.rows()
    costs, feature = made.cost(rows), made.features(rows)[:, 0]
    assert worth(made) > 0.7
    promising = np.argsort(feature)[:60]
    rng = np.random.default_rng(seed)
    at_random = [costs[rng.permutation(len(rows))[:60]].min() for _ in range(100)]
    # Following it is no better than drawing rows at random; the true order would find the best.
    assert costs[promising].min() > np.quantile(at_random, 0.1)
    best = np.argsort(costs)[: round(0.002 * len(rows))]
    assert len(best) == 8 and not set(best) & set(promising)


@pytest.mark.parametrize("name", PROBLEMS)
def test_an_instance_is_decided_by_its_seed(name: str) -> None:
    first, again, other = problem(name, 1), problem(name, 1), problem(name, 2)
    rows = first.rows(6)
    np.testing.assert_array_equal(rows, again.rows(6))
    np.testing.assert_array_equal(first.cost(rows), again.cost(rows))
    np.testing.assert_array_equal(first.features(rows), again.features(rows))
    assert not np.array_equal(rows, other.rows(6))
    assert not np.array_equal(first.features(rows), other.features(rows))
    # Rows fill the box and cost the sum of their terms.
    made = problem(name, 0)
    rows = made.rows(8)
    terms = made.terms(rows)
    assert terms.shape == rows.shape and terms.min() >= -1e-9
    np.testing.assert_allclose(made.cost(rows), terms.sum(axis=1))
    rows = made.rows()
    assert rows.shape == (2**synthetic.SOBOL_BITS, DIMENSION)
    assert np.abs(rows).max() <= made.half_width
    assert np.abs(rows.mean(axis=0)).max() < 0.01 * made.half_width
    assert tuple(made.space) == NAMES
    assert made.features(rows).shape == (len(rows), 1)


def test_problems_of_one_landscape_share_cost_and_rows_and_an_unknown_one_is_named() -> None:
    misleading, useless = problem("misleading", 4), problem("useless", 4)
    rows = misleading.rows(6)
    np.testing.assert_array_equal(rows, useless.rows(6))
    np.testing.assert_array_equal(misleading.cost(rows), useless.cost(rows))
    assert useless.cost_at(dict(zip(NAMES, rows[7], strict=True))) == useless.cost(rows[7:8])[0]
    with pytest.raises(InputError, match=r"problem.*informative"):
        problem("hard", 0)
