"""The order that covers what a ground may be like, against its rule and against Bayes's."""

import numpy as np
import pytest

from study import features
from study.features import RELIABILITY, chances, covering_order, earliness


def test_the_first_row_is_the_best_on_the_plainest_ground() -> None:
    plainest = np.array([0.8, 0.9, 0.9, np.nan])
    survival = np.array([[0.9, 0.9], [0.1, 0.2], [0.1, 0.3], [1.0, 1.0]])
    assert covering_order(plainest, survival).tolist() == [1, 0, 2, 3]


def test_a_row_for_what_the_first_one_does_not_survive_comes_before_a_better_one() -> None:
    everywhere_but_up, its_like, up = [0.9, 0.9, 0.1], [0.9, 0.8, 0.1], [0.0, 0.0, 0.9]
    survival = np.array([its_like, up, everywhere_but_up])
    assert covering_order(np.array([0.8, 0.0, 0.9]), survival).tolist() == [2, 1, 0]


def test_a_chance_is_relative_to_the_best_on_that_ground() -> None:
    survival = np.array([[1.0, 0.2, 0.0], [0.5, 0.4, 0.0]])
    one, eighth = RELIABILITY, RELIABILITY / 8
    np.testing.assert_allclose(chances(survival), [[one, eighth, 0.0], [eighth, one, 0.0]])


def test_equal_rows_come_in_their_order() -> None:
    assert covering_order(np.ones(5), np.full((5, 2), 0.5)).tolist() == [0, 1, 2, 3, 4]


def test_rows_beyond_those_that_cover_follow_by_their_mean(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(features, "COVERING", 3)
    survival = np.random.default_rng(1).uniform(size=(20, 4))
    order = covering_order(np.ones(20), survival)
    assert sorted(order) == list(range(20))
    rest = chances(survival).mean(axis=1)[order[3:]]
    assert (np.diff(rest) <= 0).all()


def test_the_next_row_is_the_likeliest_to_walk_after_so_many_falls() -> None:
    survival = np.random.default_rng(2).uniform(size=(30, 4)) ** 2
    plainest = np.random.default_rng(3).uniform(size=30)
    order, belief = covering_order(plainest, survival), np.full(4, 0.25)
    for place, row in enumerate(order[:10]):
        likely = plainest.copy() if place == 0 else chances(survival) @ belief
        likely[order[:place]] = -1.0
        assert row == np.argmax(likely)
        belief *= 1.0 - chances(survival)[row]  # of each ground, given that it fell
        belief /= belief.sum()


def test_rows_that_are_not_to_be_tried_have_no_place() -> None:
    plainest, survival = np.array([0.2, np.nan, 0.9]), np.array([[0.2], [1.0], [0.9]])
    np.testing.assert_array_equal(earliness(plainest, survival), [2.0, np.nan, 3.0])
    assert np.isnan(earliness(np.full(3, np.nan), survival)).all()
