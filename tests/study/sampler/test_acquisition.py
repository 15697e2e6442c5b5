"""Expected improvement against its integral, ties, and kept constraints."""

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.stats import norm

from study import FeatureTable
from study.sampler import acquisition
from study.sampler.acquisition import argmax_random_tie, log_expected_improvement
from study.sampler.covariance import KERNELS, WITH_WORLDS
from study.sampler.history import read_limits
from study.sampler.transforms import Points
from study.sampler.worlds import Ensemble, Worlds
from tests.study.sampler.studies import model_after, study_of


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
    counts = np.bincount(
        [argmax_random_tie(values, rng) for _ in range(3000)], minlength=4
    )
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
        exact, _ = quad(
            lambda t: (z - t) * norm.pdf(t), z - 12, z, epsabs=0, epsrel=1e-12
        )
        assert_allclose(found, np.log(exact), rtol=1e-8)
    else:  # phi(z) / z^2 (1 - 3/z^2 + ...)
        assert_allclose(
            found, norm.logpdf(z) - 2 * np.log(-z) + np.log1p(-3 / z**2), rtol=1e-7
        )


# The model.
@pytest.mark.parametrize("kernel", KERNELS)
def test_noise_is_a_chance_of_improvement_only_where_it_is_the_spread_of_alike_candidates(
    kernel,
):
    """Costs at random; where parameters are looked at, candidates that are alike are the same."""
    seen = Points.of(np.zeros((40, 1)), np.full((40, 2), 0.5))
    cost = np.random.default_rng(0).uniform(1.0, 2.0, 40)
    model = model_after(seen, cost, KERNELS[kernel])
    _, variance = model.posterior.predict(model.visible(seen.take(np.arange(1))))
    share = float(variance[0]) / float(np.var(model.cost()))
    assert share > 0.9 if kernel == "rbf" else share < 0.1


def test_of_many_candidates_those_that_worlds_rank_first_are_looked_at():
    """Costs follow them but for a hundredth."""
    rng = np.random.default_rng(1)
    outcomes = rng.standard_normal((2 * acquisition.MOST_IN_WORLDS, 3))
    ensemble = Ensemble(Worlds.of(outcomes, "lower"), outcomes)
    many = Points.of(ensemble.columns, rng.uniform(size=(len(outcomes), 2)))
    seen = many.take(np.arange(12))
    cost = np.exp(ensemble.mean[:12] + 0.01 * rng.standard_normal(12))
    model = model_after(seen, cost, WITH_WORLDS, ensemble)
    looked_at = model._looked_at(many, np.ones(len(many), dtype=bool), rng)
    assert len(looked_at) == acquisition.MOST_IN_WORLDS
    # half of what is looked at: ten times as many
    best = np.argsort(ensemble.mean)[:200]
    assert len(set(best) & set(looked_at)) > 190


# Constraints.
def test_limits_are_the_constraints_that_trials_have_and_are_kept_with_the_normal_probability():
    one = optuna.create_trial(value=0.0, constraints={"x": 1.0, "y": -np.inf})
    other = optuna.create_trial(value=0.0, constraints={"y": -2.0})
    assert_allclose(read_limits([one, other]), [[1.0, -2.0], [np.nan, -2.0]])
    assert read_limits([one]).shape == (1, 2)
    assert read_limits([optuna.create_trial(value=0.0)]).shape == (1, 0)
    mean, sd = np.array([-1.0, 0.0, 2.0, 60.0]), np.array([0.5, 1.0, 4.0, 1.0])
    assert_allclose(
        acquisition.log_chance_below_zero(mean, sd**2), norm.logcdf(-mean / sd)
    )


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(("told", "fewer"), [(lambda over: over, 3), (np.sign, 0)])
def test_a_sampler_that_knows_breaks_limits_less_often(kernel, told, fewer):
    """The cost falls towards a region that is forbidden, and a little into it.

    Told how far it was, by 4 trials or more of 20; told only whether, less often, over
    some seeds: a smooth process over the parameters cannot have a step.
    """
    a, side = np.random.default_rng(0).uniform(size=(2, 300))
    table = FeatureTable.from_arrays({"a": a, "side": side}, a)

    def broken(knows, seed):
        def objective(trial):
            value = trial.suggest_float("a", 0, 1)
            if knows:
                trial.set_constraint("edge", float(told(value - 0.6)))
            return -min(value, 0.65) + 0.3 * trial.suggest_float("side", 0, 1)

        study = study_of(table, objective, 20, seed=seed, kernel=kernel)
        values = [trial.params["a"] for trial in study.trials]
        assert not knows or max(v for v in values if v <= 0.6) > 0.5
        return sum(v > 0.6 for v in values)

    seeds = range(3)
    knowing = sum(broken(knows=True, seed=seed) for seed in seeds)
    ignorant = sum(broken(knows=False, seed=seed) for seed in seeds)
    assert knowing < ignorant - fewer * len(seeds)


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
