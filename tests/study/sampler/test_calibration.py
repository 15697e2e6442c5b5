"""Intervals and chances rest on how far off earlier predictions were."""

from types import SimpleNamespace

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from optuna.distributions import FloatDistribution
from scipy.optimize import minimize
from scipy.special import expit, logit
from scipy.stats import norm
from scipy.stats import t as student

from study import FeatureKernelSampler, FeatureTable
from study.sampler.calibration import (
    COST,
    GOAL,
    LARGEST_ERROR,
    LEAST_SLOPE,
    ODDS_MODES,
    ODDS_SDS,
    Calibration,
    Odds,
    reading_of,
)
from study.sampler.evidence import FAMILIAR
from study.sampler.history import placed
from tests.study.sampler import campaigns
from tests.study.sampler.replayed import replayed
from tests.study.sampler.studies import told

LINE = np.linspace(0.0, 1.0, 40)
SPACE = {"x": FloatDistribution(0.0, 1.0)}
COSTS = np.column_stack([0.3 + (LINE - place) ** 2 for place in (0.3, 0.4, 0.5, 0.6)])
NOTHING = np.array([np.nan])


def study_on(outcomes=COSTS, values=(), limits=(), features=None, **options):
    """A study over the line, after trials of every fourth row."""
    table = FeatureTable.from_arrays({"x": LINE}, features, outcomes=outcomes)
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1, **options))
    for place, value in enumerate(values):
        known = {"limit": limits[place]} if place < len(limits) else {}
        told(study, SPACE, {"x": LINE[4 * place]}, value, **known)
    return study


def errors_of(study):
    return study.sampler._policy.present(study).errors


# Student's t of the errors.
def test_without_an_error_only_what_is_expected_counts():
    found = Calibration.of(NOTHING)
    expected = (COST.bias, COST.scale, COST.scale_trials)
    assert (found.bias, found.scale, found.freedom) == pytest.approx(expected)
    low, high = found.ends(np.zeros(1), np.array([4.0]))
    reach = 2.0 * found.scale * student.ppf(0.975, found.freedom)
    assert_allclose([high - low, high + low], [[2.0 * reach], [4.0 * found.bias]])


def test_many_errors_tell_bias_and_scale():
    rng = np.random.default_rng(1)
    for bias, scale in ((0.0, 0.5), (0.5, 1.0), (-0.5, 0.8)):
        found = Calibration.of(bias + scale * rng.normal(size=4000))
        assert found.bias == pytest.approx(bias, abs=0.05)
        assert found.scale == pytest.approx(scale, rel=0.05)
        chance = found.chance_below(1.0, np.zeros(1), np.ones(1))
        wanted = student.cdf((1.0 - found.bias) / found.scale, found.freedom)
        assert_allclose(chance, wanted)


def test_one_error_widens_and_none_is_endless():
    plain, wider, widest = (
        Calibration.of(np.array([error])).reach for error in (0.3, 2.0, LARGEST_ERROR)
    )
    assert plain < wider < widest
    assert Calibration.of(np.array([1e300])).reach == widest
    assert Calibration.of(np.array([np.nan, 2.0])).reach == wider


# Odds of a success.
RNG = np.random.default_rng(2)
SAID = RNG.uniform(0.01, 0.99, 30)


@pytest.mark.parametrize(
    ("said", "happened"),
    [
        (SAID, RNG.uniform(size=30) < SAID**2),
        (np.full(16, 0.997), np.zeros(16, dtype=bool)),
        (np.full(8, 0.01), np.ones(8, dtype=bool)),
        (0.9 * SAID**8 + 0.003, RNG.uniform(size=30) < 0.7),
        (SAID, SAID < 0.5),
    ],
    ids=["like", "sure and wrong", "came against all odds", "low and likely", "turned"],
)
def test_odds_are_the_likeliest_under_their_prior(said, happened):
    """No search without derivatives finds likelier ones."""

    def misfit(theta):
        log_odds = theta[0] + theta[1] * logit(said)
        log_prior = norm.logpdf(theta, ODDS_MODES, ODDS_SDS).sum()
        return np.logaddexp(0.0, np.where(happened, -1, 1) * log_odds).sum() - log_prior

    found = Odds.of(said, happened)
    bounds = [(-9.0, 9.0), (LEAST_SLOPE, 3.0)]
    wanted = minimize(
        misfit, ODDS_MODES, method="Nelder-Mead", tol=1e-10, bounds=bounds
    )
    assert misfit([found.shift, found.slope]) < wanted.fun + 1e-4
    assert found.slope >= LEAST_SLOPE
    chances = expit(wanted.x[0] + wanted.x[1] * logit(said))
    assert_allclose(found.chance(said), chances, atol=0.01)


def test_what_fails_more_often_than_was_said_becomes_less_likely():
    said = np.full(12, 0.9)
    chances = [
        Odds.of(said, np.arange(12) < successes).chance(np.array([0.9]))[0]
        for successes in (0, 6, 12)
    ]
    assert chances[0] < 0.25 < 0.4 < chances[1] < 0.7 < 0.85 < chances[2]


def test_chances_keep_their_order_however_small_or_large():
    found = Odds.of(SAID, SAID < 0.5)
    chances = found.chance(np.array([1e-12, 1e-6, 0.2, 0.8, 1.0 - 1e-6, 1.0 - 1e-12]))
    assert (np.diff(chances) > 1e-3).all()


JAGGED = np.random.default_rng(5).uniform(0.3, 6.0, (40, 4))  # nothing between rows


def test_where_costs_jump_a_chance_follows_what_became_of_those_before():
    """The model's t of its errors first; then what successes and failures made of it."""
    study = study_on(JAGGED, values=[6.0, 0.5, 6.0, 6.0, 0.4, 6.0], success=1.0)
    found, plain = study.sampler.predict(study), errors_of(study)
    t = Calibration.of(plain[:, 0])
    said = [
        Calibration.of(plain[:n, 0]).chance_of(plain[n, [GOAL]])[0] for n in range(6)
    ]
    odds = Odds.of(np.array(said), np.array([0, 1, 0, 0, 1, 0]) > 0)
    policy = study.sampler._policy
    history = policy._history(study, optuna.trial.create_trial(value=0.0))
    model = policy._model(history, 6)
    mean, variance = reading_of(model, policy._points(model.ensemble))
    (goal,) = model.standard(np.array([1.0]), model.costs)
    assert model.ensemble.jumps
    assert_allclose(found.success, odds.chance(t.chance_below(goal, mean, variance)))


def test_smooth_costs_keep_the_chance_of_their_t():
    study = study_on(values=[0.35, 0.6, 0.31, 0.5], success=0.33)
    policy = study.sampler._policy
    history = policy._history(study, optuna.trial.create_trial(value=0.0))
    model = policy._model(history, 4)
    mean, variance = reading_of(model, policy._points(model.ensemble))
    (goal,) = model.standard(np.array([0.33]), model.costs)
    t = Calibration.of(errors_of(study)[:, 0])
    assert not model.ensemble.jumps
    wanted = t.chance_below(goal, mean, variance)
    assert_allclose(study.sampler.predict(study).success, wanted)


# Errors of past trials.
@pytest.mark.parametrize("features", [None, np.column_stack([LINE, LINE**2])])
def test_each_trial_is_predicted_by_those_before_it(features):
    outcomes = COSTS if features is None else None
    values = [0.35, 0.6, 0.31, 0.5, 0.9, 0.4]
    limits = [-1.0, -0.5, -2.0, 0.3, 0.1, -0.7]
    found = errors_of(study_on(outcomes, values, limits, features))
    assert found.shape == (6, 3)
    for number in range(6):
        before = study_on(outcomes, values[:number], limits[:number], features)
        policy = before.sampler._policy
        history = policy._history(before, optuna.trial.create_trial(value=0.0))
        model = policy._model(history, number)
        point = policy._seen(
            placed(policy.rows, [{"x": LINE[4 * number]}]), model.ensemble
        )
        is_told = number > 1 or features is None
        assert np.isnan(found[number, 0]) != is_told
        if is_told:
            mean, variance = reading_of(model, point)
            y = model.standard(np.array(values[number : number + 1]), model.costs)
            assert_allclose(found[number, 0], (y - mean) / np.sqrt(variance))
    assert np.isnan(found[:3, 1]).all() and np.isfinite(found[3:, 1]).all()


def test_errors_are_computed_once_and_the_same_by_another_process():
    study = study_on(values=[0.35, 0.6, 0.31, 0.5])
    first, known = errors_of(study), study.sampler._policy.past_errors
    kept = {key: id(value) for key, value in known.items()}
    study.sampler.predict(study)
    assert {key: id(value) for key, value in known.items()} == kept
    other = FeatureKernelSampler(study.sampler._policy._table, seed=9)
    study.sampler, told = other, study.sampler.errors
    assert_allclose(errors_of(study), first)
    assert other.errors.keys() == told.keys()
    third = FeatureKernelSampler(study.sampler._policy._table, seed=9)
    study.sampler, third.errors = third, told
    assert_allclose(errors_of(study), first)
    assert_allclose([*third.errors.values()], [*told.values()])


def test_a_machine_unlike_all_worlds_is_predicted_with_more_doubt():
    def width(factor):
        found = study_on(values=factor * COSTS[::4, 1][:6]).sampler
        study = study_on(values=factor * COSTS[::4, 1][:6])
        predicted = found.predict(study)
        return np.median(np.log(predicted.high / predicted.low))

    noisy = np.where(np.arange(6) % 2, 3.0, 1.0)
    assert width(noisy) > 3.0 * width(np.ones(6))


# What is said.
def test_no_cost_is_expected_below_all_that_was_simulated_or_read():
    """Two trials beside each other, one of which failed: a line through them runs away."""
    study = study_on(success=0.4)
    told(study, SPACE, {"x": LINE[18]}, 6.0)
    told(study, SPACE, {"x": LINE[16]}, 0.5)
    found = study.sampler.predict(study)
    assert found.value.min() >= COSTS.min() * (1.0 - 1e-9)
    assert found.value.max() <= 6.0 * (1.0 + 1e-9)
    assert found.success.max() < 0.9 and found.high.max() < 60.0


@pytest.mark.parametrize("broken", range(4))
def test_after_one_broken_limit_of_four_nothing_is_impossible_or_certain(broken):
    limits = np.where(np.arange(4) == broken, 1.0, -1.0)
    found = study_on(values=[0.4, 0.5, 0.6, 0.45], limits=limits).sampler
    study = study_on(values=[0.4, 0.5, 0.6, 0.45], limits=limits)
    kept = found.predict(study).kept
    assert kept.min() > 0.1 and kept.max() < 0.95


def test_the_best_reading_is_recommended_and_repeats_count_as_their_mean():
    study = study_on(values=[0.42, 0.36, 0.33, 0.31, 0.32])
    assert study.sampler.best(study).number == 3
    for value in (0.5, 0.52):  # the best reading was luck
        told(study, SPACE, {"x": LINE[12]}, value)
    assert study.sampler.best(study).number == 4


def test_repeats_count_as_the_mean_of_their_values_not_of_the_units_of_the_model():
    study = study_on(values=[101.0])
    told(study, SPACE, {"x": LINE[0]}, 1.0)
    told(study, SPACE, {"x": LINE[4]}, 45.0)
    assert study.sampler.best(study).number == 2


def test_the_best_reading_is_told_beside_what_is_expected():
    study = study_on(values=[0.42, 0.36, 0.33, 0.9])
    for value in (0.29, 0.31):
        told(study, SPACE, {"x": LINE[9]}, value)
    best = study.sampler.best(study)
    assert best.reading == pytest.approx(0.3) and best.value != best.reading
    assert f"read 0.3; expected {best.value:.4g} (" in str(best)


def test_a_trial_that_runs_tells_nothing_of_what_to_expect():
    study = study_on(values=[0.42, 0.36, 0.33])
    before = study.sampler.predict(study)
    trial = study.ask()
    running = {"x": trial.suggest_float("x", 0.0, 1.0)}
    found = study.sampler.predict(study)
    assert_array_equal([found.low, found.high], [before.low, before.high])
    (alone,) = study.sampler.predict(study, [running]).high
    study.tell(trial, state=optuna.trial.TrialState.FAIL)
    assert alone == study.sampler.predict(study, [running]).high


@pytest.mark.parametrize("value", [2e-4, -5.0])
def test_a_reading_far_below_all_worlds_is_the_best_and_its_interval_unknown(value):
    """The logarithm of the worlds' costs has no such number."""
    study = study_on(values=[2.0 * value, value, value])
    told(study, SPACE, {"x": LINE[20]}, min(0.9 * value, 1.1 * value))
    best = study.sampler.best(study)
    assert best.value == study.best_value and np.isnan([best.low, best.high]).all()


def test_errors_are_counted_in_the_units_that_costs_have_now():
    """From the eighth trial on they are those of the trials: the errors before are, too."""
    rng = np.random.default_rng(2)
    x = rng.random((200, 2))
    worlds = np.column_stack(
        [0.3 + ((x - at) ** 2).sum(axis=1) for at in rng.uniform(0.3, 0.7, (12, 2))]
    )
    table = FeatureTable.from_arrays({"a": x[:, 0], "b": x[:, 1]}, outcomes=worlds)
    space = table.rows.space.as_dict()
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))
    at = [0.1, 0.8]  # beyond all worlds
    for _ in range(FAMILIAR - 1):
        trial = study.ask(space)
        away = np.array([trial.params[name] for name in "ab"]) - at
        study.tell(trial, 0.3 + (away**2).sum())
    before = errors_of(study)[:, 0]
    trial = study.ask(space)
    study.tell(trial, 0.31)
    found = study.sampler._policy.present(study)
    assert found.model.of_table is None
    assert not np.allclose(found.errors[2:-1, 0], before[2:])
    assert np.isnan(found.errors[:2, 0]).all()  # two trials tell of no scale


def test_a_valley_that_no_other_trial_confirms_is_recommended():
    """By two standard deviations of the model trial 5 was better."""
    values = 0.31 + 0.5 * (LINE[::4] - 0.45) ** 2
    values[7] = 0.3
    study = study_on(values=values.tolist())
    assert study.sampler.best(study).number == 7


@pytest.mark.parametrize("alike", [COSTS[:, :1], np.repeat(COSTS[:, :1], 5, axis=1)])
def test_of_worlds_that_do_not_differ_none_is_named(alike):
    study = study_on(alike, values=[0.4, 0.5, 0.6, 0.45])
    assert "no world is more like the robot" in study.sampler.worth(study).verdict


# The harness.
@pytest.mark.slow
def test_the_harness_counts_what_was_said_and_what_happened():
    said = [
        each
        for kind in campaigns.KINDS
        for each in campaigns.campaign(kind, is_like=False, seed=3)
    ]
    assert len(said) == len(campaigns.KINDS) * campaigns.TRIALS
    known = [each for each in said if np.isfinite(each.low)]
    held = np.mean([each.low <= each.value <= each.high for each in known])
    assert len(known) > 100 and held > 0.8
    lines = "\n".join(campaigns.tables(said))
    assert "unlike" in lines and "recommend after 25, knobs" in lines


def test_a_comparison_is_replayed_trial_by_trial():
    """As a sampler predicts that knows the trials before each."""
    experiment = SimpleNamespace(
        name="line", trial_s=1.0, objective=SimpleNamespace(success=lambda _: 0.35)
    )
    values = [0.5, 0.32, 0.6, 0.34]
    study = study_on(values=values[:3], success=0.35)
    task = SimpleNamespace(
        experiment=experiment, seed=1, table=study.sampler._policy._table
    )
    trials = [
        {"x": LINE[4 * place], "cost": value} for place, value in enumerate(values)
    ]
    said = [*replayed(task, trials, 0.35)]
    assert [each.trial for each in said] == [2, 3, 4]
    assert [each.succeeded for each in said] == [True, False, True]
    wanted = study.sampler.predict(study, [{"x": LINE[12]}])
    assert (said[-1].success, said[-1].low, said[-1].high) == pytest.approx(
        (wanted.success[0], wanted.low[0], wanted.high[0])
    )
