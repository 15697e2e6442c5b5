"""Expected improvement against its integral, ties, the prior mean, and kept constraints."""

from typing import Any

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose
from optuna.trial import TrialState
from scipy.integrate import quad
from scipy.stats import norm

from study import FeatureTable
from study.sampler import acquisition
from study.sampler.acquisition import Model, argmax_random_tie, log_expected_improvement
from study.sampler.gp import KERNELS
from study.sampler.history import read_limits
from study.sampler.transforms import SLOPE, Points, PriorMean, log_excess
from taichi_nmm.errors import InputError
from tests.study.sampler.studies import study_of


@pytest.mark.parametrize("mean", [-2.0, 0.0, 1.3, 4.0])
@pytest.mark.parametrize("sd", [0.5, 1.0, 3.0])
def test_expected_improvement_is_its_integral(mean, sd):
    best = 0.5
    gain = lambda cost: (best - cost) * norm.pdf(cost, mean, sd)  # noqa: E731
    expected, _ = quad(gain, mean - 12 * sd, best, epsabs=1e-15)
    found = np.exp(log_expected_improvement(np.array([mean]), np.array([sd]), best))
    assert_allclose(found, expected, rtol=1e-6, atol=1e-13)


@pytest.mark.parametrize("value", [2.0, 0.0])
def test_the_largest_value_wins_and_equal_ones_are_drawn_evenly(value):
    values = np.array([value, -1.0, value * (1 + 1e-12), value])
    rng = np.random.default_rng(0)
    counts = np.bincount([argmax_random_tie(values, rng) for _ in range(3000)], minlength=4)
    assert counts[1] == 0
    assert_allclose(counts[[0, 2, 3]], 1000, atol=120)
    assert argmax_random_tie(np.array([-np.inf, 3.0]), rng) == 1
    assert {argmax_random_tie(np.full(3, -np.inf), rng) for _ in range(40)} == {0, 1, 2}


def test_log_improvement_is_finite_and_falls():
    mean = np.concatenate([np.linspace(0, 50, 400), np.logspace(1.71, 9, 400)])
    found = log_expected_improvement(mean, np.ones_like(mean), best=0.0)
    assert np.isfinite(found).all()
    assert np.all(np.diff(found) < 0)
    assert norm.pdf(mean[-1]) == 0.0  # where the plain one underflows
    with np.errstate(all="raise"):  # without doubt it is that of the gain
        found = log_expected_improvement(np.array([1.0, 3.0]), np.zeros(2), best=2.0)
    assert found.tolist() == [0.0, -np.inf]


@pytest.mark.parametrize("z", [-1.5, -8.0, -30.0, -900.0, -1100.0, -2e6])
def test_log_improvement_has_the_tail_of_its_series(z):
    found = log_expected_improvement(np.array([-z]), np.ones(1), best=0.0)[0]
    if z > -30:
        exact, _ = quad(lambda t: (z - t) * norm.pdf(t), z - 12, z, epsabs=0, epsrel=1e-12)
        assert_allclose(found, np.log(exact), rtol=1e-8)
    else:  # phi(z) / z^2 (1 - 3/z^2 + ...)
        assert_allclose(found, norm.logpdf(z) - 2 * np.log(-z) + np.log1p(-3 / z**2), rtol=1e-7)


# The model, and the prior mean.
NAMES = ("score", "error", "-odd")


@pytest.mark.parametrize(("prior", "column", "sign"), [
    ("score", 0, 1.0), ("-error", 1, -1.0), ("-odd", 2, 1.0), ("--odd", 2, -1.0),
])  # fmt: skip
def test_a_minus_stands_for_low_values(prior, column, sign):
    found = PriorMean.of(prior, NAMES)
    assert found is not None and (found.column, found.sign) == (column, sign)
    features = np.arange(12.0).reshape(4, 3)
    assert_allclose(found.merit(features), sign * features[:, column])


@pytest.mark.parametrize("prior", ["", "-", "speed", "-speed", "+score"])
def test_what_is_no_feature_is_refused(prior):
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
    assert_allclose(log_excess(cost, cost), fall, atol=1e-12)
    return cost, fall


def points(scores: np.ndarray, seed: int) -> Points:
    """With the score as the second of two features, and two coordinates."""
    rng = np.random.default_rng(seed)
    other = rng.standard_normal(len(scores))
    return Points(np.column_stack([other, scores]), rng.uniform(size=(len(scores), 2)))


def model_of(seen: Points, cost: Any, kernel: str = "additive", sign: float = 1.0) -> Model:
    """After trials without limits, with high or low values of the second feature thought good."""
    limits = np.empty((len(seen), 0))
    prior_mean = PriorMean(1, sign) if sign else None
    return Model(KERNELS[kernel], prior_mean, 2, seen, cost, limits, seen.take(np.arange(0)), {})


@pytest.mark.parametrize("kernel", KERNELS)
def test_noise_is_a_chance_of_improvement_only_where_it_is_the_spread_of_alike_candidates(kernel):
    """Costs at random; where parameters are looked at, candidates that are alike are the same."""
    seen = Points(np.zeros((40, 1)), np.full((40, 2), 0.5))
    cost = np.random.default_rng(0).uniform(1.0, 2.0, 40)
    model = model_of(seen, cost, kernel, sign=0.0)
    visible = {"features": model.kernel.of_features, "coordinates": model.kernel.of_parameters}
    _, variance = model.posterior.predict(seen.take(np.arange(1)).only(**visible))
    share = float(variance[0]) / float(np.var(model.cost()))
    assert share > 0.9 if kernel in ("rbf", "rbf_ard") else share < 0.1


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_where_nothing_is_left_to_explain_the_cost_falls_by_the_slope(kernel, sign):
    """Costs that follow the prior mean exactly: their scale alone is left to learn.

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
    model = model_of(points(scores, 0), cost, kernel, sign)
    some = points(np.array([-3.0, -0.2, 0.0, 0.7, 5.0]), 1)
    mean = predicted(model, some)
    expected = -SLOPE * fall.std() * sign * (some.features[:, 1] - some.features[0, 1])
    assert_allclose(mean - mean[0], expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("cost", [0.0, 1e9])
def test_after_one_trial_the_ranking_is_the_order_of_the_utility(cost):
    """One cost has no spread, which is taken to be one: candidates differ by the prior mean."""
    model = model_of(points(np.zeros(1), 0), np.array([cost]))
    features = np.column_stack([np.zeros(5), [0.0, 0.1, 0.2, 0.3, 0.4]])
    alike = Points(features, np.full((5, 2), 0.5))
    assert np.diff(predicted(model, alike)) == pytest.approx(-SLOPE * 0.1)
    utility = model.utility(alike, np.ones(5, dtype=bool), np.random.default_rng(0))
    assert np.all(np.diff(utility) > 0)


def test_a_prior_that_trials_contradict_is_turned():
    scores = np.linspace(-2, 2, 15)
    model = model_of(points(scores, 0), np.exp(scores))
    bad, good = predicted(model, points(np.array([-1.8, 1.8]), 1))
    assert bad < good


def test_of_many_candidates_those_that_the_prior_ranks_first_are_looked_at():
    """Costs follow it but for a hundredth, which another feature explains."""
    scores = np.linspace(-2, 2, 12)
    seen = points(scores / scores.std(), 0)
    other, scores = seen.features.T
    cost, _ = costs_that_fall_by(-scores + 0.01 * other)
    model = model_of(seen, cost)
    many = points(np.random.default_rng(1).standard_normal(2 * acquisition.MOST_CANDIDATES), 2)
    offered = np.ones(len(many), dtype=bool)
    looked_at = model._looked_at(many, offered, np.random.default_rng(0))
    assert len(looked_at) == acquisition.MOST_CANDIDATES
    best = np.argsort(-many.features[:, 1])[:200]  # half of what is looked at: ten times as many
    assert set(best) <= set(looked_at)


# Constraints.
def test_limits_are_the_constraints_that_trials_have_and_are_kept_with_the_normal_probability():
    one = optuna.create_trial(value=0.0, constraints={"x": 1.0, "y": -np.inf})
    other = optuna.create_trial(value=0.0, constraints={"y": -2.0})
    assert_allclose(read_limits([one, other]), [[1.0, -2.0], [np.nan, -2.0]])
    assert read_limits([one]).shape == (1, 2)
    assert read_limits([optuna.create_trial(value=0.0)]).shape == (1, 0)
    mean, sd = np.array([-1.0, 0.0, 2.0, 60.0]), np.array([0.5, 1.0, 4.0, 1.0])
    assert_allclose(acquisition.log_kept(mean, sd**2), norm.logcdf(-mean / sd))


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(("told", "fewer"), [(lambda over: over, 3), (np.sign, 0)])
def test_a_sampler_that_knows_breaks_limits_less_often(kernel, told, fewer):
    """The cost falls towards a region that is forbidden, and a little into it.

    Told how far it was, by 4 trials or more of 20; told only whether, less often: a smooth process
    over the parameters cannot have a step.
    """
    a, side = np.random.default_rng(0).uniform(size=(2, 300))
    table = FeatureTable.from_arrays({"a": a, "side": side}, a)

    def broken(knows):
        def objective(trial):
            value = trial.suggest_float("a", 0, 1)
            if knows:
                trial.set_constraint("edge", float(told(value - 0.6)))
            return -min(value, 0.65) + 0.3 * trial.suggest_float("side", 0, 1)

        study = study_of(table, objective, 20, seed=2, kernel=kernel)
        values = [trial.params["a"] for trial in study.trials]
        assert not knows or max(v for v in values if v <= 0.6) > 0.5
        return sum(v > 0.6 for v in values)

    assert broken(knows=True) < broken(knows=False) - fewer


def test_before_any_candidate_holds_the_likeliest_is_sought():
    a = np.linspace(0, 1, 200)

    def objective(trial):
        value = trial.suggest_float("a", 0, 1)
        trial.set_constraint("far", value - 0.02)
        return value

    enqueued = [{"a": float(a[row])} for row in (150, 180)]
    table = FeatureTable.from_arrays({"a": a}, a)
    study = study_of(table, objective, 12, seed=0, enqueued=enqueued)
    assert min(trial.params["a"] for trial in study.trials) <= 0.02


def test_limits_of_pruned_and_failed_trials_do_no_harm():
    a = np.linspace(0, 1, 60)
    study = study_of(FeatureTable.from_arrays({"a": a}, a))

    def told(trial):
        value = trial.suggest_float("a", 0, 1)
        trial.set_constraint("0", value - 0.6)
        trial.set_constraint("1", -1.0)
        return -value

    for state in (TrialState.FAIL, TrialState.PRUNED):
        trial = study.ask()
        told(trial)
        study.tell(trial, state=state)
    study.optimize(told, n_trials=3)
    assert len(study.get_trials(states=(TrialState.COMPLETE,))) == 3
