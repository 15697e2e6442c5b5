"""What the user says of a feature, in the model's mean."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from study.sampler.acquisition import MOST_CANDIDATES, Model, log_expected_improvement
from study.sampler.gp import KERNELS
from study.sampler.transforms import SLOPE, Points, PriorMean, log_excess
from taichi_nmm.errors import InputError

NAMES = ("score", "error", "-odd")


@pytest.mark.parametrize(
    ("prior", "guess"),
    [("score", (0, 1.0)), ("-error", (1, -1.0)), ("-odd", (2, 1.0)), ("--odd", (2, -1.0))],
)
def test_a_minus_stands_for_low_values(prior: str, guess: tuple[int, float]) -> None:
    found = PriorMean.of(prior, NAMES)
    assert (found.column, found.sign) == guess
    features = np.arange(12.0).reshape(4, 3)
    assert_allclose(found.merit(features), guess[1] * features[:, guess[0]])


@pytest.mark.parametrize("prior", ["", "-", "speed", "-speed", "+score"])
def test_what_is_no_feature_is_refused(prior: str) -> None:
    with pytest.raises(InputError, match=r"prior: .* one of score, error, -odd, or one with a mi"):
        PriorMean.of(prior, NAMES)


def predicted(model: Model, points: Points) -> np.ndarray:
    """The mean of the cost of points, as the expected improvement is given it, [m]."""
    means = []

    def spied(mean: np.ndarray, sd: np.ndarray, best: float) -> np.ndarray:
        means.append(mean)
        return log_expected_improvement(mean, sd, best)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("study.sampler.acquisition.log_expected_improvement", spied)
        model.utility(points, np.ones(len(points), dtype=bool), np.random.default_rng(0))
    return np.asarray(means[0])


def costs_that_fall_by(shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Costs whose `log_excess` has this shape, [n], and that logarithm; n is even."""
    fall = shape - shape.min()
    fall *= np.log(2.0) / np.median(fall[fall > 0])
    cost = np.expm1(fall)  # the median excess is 1
    assert_allclose(log_excess(cost), fall, atol=1e-12)
    return cost, fall


def no_limits(trials: int) -> np.ndarray:
    return np.empty((trials, 0))


def points(scores: np.ndarray, seed: int) -> Points:
    """With the score as the second of two features, and two coordinates."""
    rng = np.random.default_rng(seed)
    other = rng.standard_normal(len(scores))
    return Points(np.column_stack([other, scores]), rng.uniform(size=(len(scores), 2)))


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_where_nothing_is_left_to_explain_the_cost_falls_by_the_slope(
    kernel: str, sign: float
) -> None:
    """Costs that follow the guess exactly: only their scale, and no residual, is left to learn.

    The scores of the trials have unit variance, so that the costs' own spread is their slope.
    """
    scores = np.array([-1.5, -0.7, 0.1, 0.4, 0.9, 1.6])
    scores = (scores - scores.mean()) / scores.std()
    fall = -sign * scores
    if KERNELS[kernel].by_order:
        cost, fall = costs_that_fall_by(fall)
    else:
        cost = 100.0 + 3.0 * fall
        fall = cost
    seen = points(scores, 0)
    none = points(np.empty(0), 0)
    model = Model(KERNELS[kernel], PriorMean(1, sign), 2, seen, cost, no_limits(6), none, {})
    some = points(np.array([-3.0, -0.2, 0.0, 0.7, 5.0]), 1)
    mean = predicted(model, some)
    expected = -SLOPE * fall.std() * sign * (some.features[:, 1] - some.features[0, 1])
    assert_allclose(mean - mean[0], expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("cost", [0.0, 1e9])
def test_after_one_trial_the_ranking_is_the_order_of_the_utility(cost: float) -> None:
    """One cost has no spread: it is taken to be one, and like candidates differ by the guess."""
    model = Model(
        KERNELS["additive"],
        PriorMean(1, 1.0),
        2,
        points(np.zeros(1), 0),
        np.array([cost]),
        no_limits(1),
        points(np.empty(0), 0),
        {},
    )
    features = np.column_stack([np.zeros(5), [0.0, 0.1, 0.2, 0.3, 0.4]])
    alike = Points(features, np.full((5, 2), 0.5))
    assert np.diff(predicted(model, alike)) == pytest.approx(-SLOPE * 0.1)
    utility = model.utility(alike, np.ones(5, dtype=bool), np.random.default_rng(0))
    assert np.all(np.diff(utility) > 0)


def test_a_guess_that_trials_contradict_is_turned() -> None:
    scores = np.linspace(-2, 2, 15)
    seen = points(scores, 0)
    model = Model(
        KERNELS["additive"],
        PriorMean(1, 1.0),
        2,
        seen,
        np.exp(scores),
        no_limits(15),
        points(np.empty(0), 0),
        {},
    )
    some = points(np.array([-1.8, 1.8]), 1)
    mean = predicted(model, some)
    assert mean[0] < mean[1]


def test_of_many_candidates_those_that_the_guess_thinks_best_are_looked_at() -> None:
    """Costs follow it but for a hundredth, which another feature explains."""
    scores = np.linspace(-2, 2, 12)
    seen = points(scores / scores.std(), 0)
    other, scores = seen.features.T
    cost, _ = costs_that_fall_by(-scores + 0.01 * other)
    model = Model(
        KERNELS["additive"],
        PriorMean(1, 1.0),
        2,
        seen,
        cost,
        no_limits(12),
        points(np.empty(0), 0),
        {},
    )
    many = points(np.random.default_rng(1).standard_normal(2 * MOST_CANDIDATES), 2)
    offered = np.ones(len(many), dtype=bool)
    looked_at = model._looked_at(many, offered, np.random.default_rng(0))
    assert len(looked_at) == MOST_CANDIDATES
    best = np.argsort(-many.features[:, 1])[:200]  # half of what is looked at: ten times as many
    assert set(best) <= set(looked_at)
