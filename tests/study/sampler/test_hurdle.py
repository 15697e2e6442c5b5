"""Where costs jump, a candidate's chance to succeed counts, and what it costs if it does."""

import numpy as np
import optuna
import pytest
import scipy
from numpy.testing import assert_allclose, assert_array_equal

from study import FeatureKernelSampler, FeatureTable
from study.sampler.acquisition import LOG_NO_GAIN, ODDS, as_it_happens
from study.sampler.evidence import FAMILIAR
from study.sampler.transforms import log_excess
from study.sampler.worlds import EXPECTED_WORLDS, Ensemble, Worlds
from tests.study.sampler.studies import model_of, told

D, ROWS, WORLDS = 3, 300, 12
RNG = np.random.default_rng(4)
UNIT = RNG.random((ROWS, D))
BOWL = 1.0 + ((UNIT - 0.45) ** 2).sum(axis=1)
COSTS = BOWL[:, None] * np.exp(0.05 * RNG.standard_normal(WORLDS))
JUMPY = np.where(RNG.random((ROWS, WORLDS)) < 0.6, COSTS, 30.0 + 30.0 * COSTS)
NAMES = [f"x{column}" for column in range(D)]
# Rows walk in all worlds or in none: they tell nothing of points between them.
LONELY = np.where(RNG.random((ROWS, 1)) < 0.2, COSTS, 30.0 + 30.0 * COSTS)
# Costs jump from row to row, and are one group.
JAGGED = np.exp(RNG.uniform(0.0, 4.0, (ROWS, 1)) * np.ones(WORLDS))
FALL, SUCCESS = 50.0, 10.0
APART = [1.5, 3.0, 4.5, 6.0]


def study_of(outcomes, costs, limits=(), **options):
    """A study of the first rows, which cost this."""
    columns = dict(zip(NAMES, UNIT.T, strict=True))
    table = FeatureTable.from_arrays(columns, outcomes=outcomes)
    options = {"seed": 1, "success": SUCCESS} | options
    study = optuna.create_study(sampler=FeatureKernelSampler(table, **options))
    for row, cost in enumerate(costs):
        place = dict(zip(NAMES, UNIT[row].tolist(), strict=True))
        heat = {"heat": limits[row]} if len(limits) else {}
        told(study, table.rows.space.as_dict(), place, cost, **heat)
    return study, table


def points_of(table, model):
    return table.rows.points(by_order=True, coordinates=True, ensemble=model.ensemble)


@pytest.mark.parametrize(
    ("outcomes", "costs", "options", "is_asked"),
    [
        (JUMPY, [FALL, *APART], {}, True),
        (JUMPY, APART, {}, True),
        (JUMPY, [FALL, 3.0], {}, True),
        (JUMPY[:, :1], [FALL, 3.0], {}, True),
        (LONELY, [FALL, 3.0], {}, True),
        (LONELY, [FALL, FALL], {}, False),
        (LONELY, [FALL, 3.0], {"success": None}, True),
        (JAGGED, [FALL, 3.0], {"success": None}, False),
        (LONELY, [FALL, 3.0], {"off_grid": 0}, True),
        (LONELY, [FALL, 3.0], {"off_grid": 0, "success": None}, False),
        (COSTS, [FALL, *APART], {}, False),
        (JUMPY, [FALL, 0.5], {"success": 0.6}, False),
    ],
    ids=[
        "four successes",
        "no failure",
        "one success",
        "one world",
        "one where rows tell nothing",
        "none yet",
        "no success is told, and costs are two groups",
        "no success is told, and costs are one group",
        "rows alone",
        "rows alone, and no success is told",
        "smooth",
        "no world has a success",
    ],
)
def test_when_trials_that_succeeded_have_a_model_of_their_own(
    outcomes, costs, options, is_asked
):
    study, _ = study_of(outcomes, costs, **options)
    successes = model_of(study).of_successes
    assert (successes is not None) is is_asked
    if successes is not None:
        assert_array_equal(successes.costs, [cost for cost in costs if cost < FALL])
        assert successes.of_successes is None


@pytest.mark.parametrize(
    ("outcomes", "success"),
    [
        (JUMPY, SUCCESS),
        (np.hstack([JUMPY[:, :3], LONELY]), SUCCESS),
        (np.round(5.0 * JUMPY) / 5.0, 1.4),
    ],
    ids=["jumpy", "other rows", "some cost as much as a success"],
)
def test_rows_have_the_mean_of_their_costs_in_the_worlds_where_they_succeed(
    outcomes, success
):
    """In units of all successes; two worlds at the mean of these are added to each row."""
    study, table = study_of(outcomes, [FALL, 1.3], success=success)
    model = model_of(study)
    columns, seen = model.columns, points_of(table, model).matrix
    own = model.ensemble.standard(outcomes)
    every = own[outcomes <= success]
    middle, unit, count = every.mean(), every.std(), outcomes.shape[1]
    told = (model.ensemble.standard(np.array([1.3])) - middle) / unit
    assert_allclose(model.of_successes.cost(), told)
    for row in range(0, ROWS, 7):
        succeeds = outcomes[row] <= success
        costs = (own[row] - middle) / unit
        mean = costs[succeeds].sum() / (succeeds.sum() + EXPECTED_WORLDS)
        away = np.where(succeeds, costs - mean, 0.0) / np.sqrt(count)
        assert_allclose(seen[row, columns.mean_of_successes], [mean])
        assert_allclose(seen[row, columns.successes], away, atol=1e-12)
    of_successes = model.of_successes.columns
    assert of_successes.worlds == columns.successes
    assert of_successes.mean == columns.mean_of_successes
    assert (of_successes.one, of_successes.gap) == (columns.one, columns.gap)


def test_what_successes_cost_is_a_process_over_columns_of_their_own():
    """Beside its formula; between rows and candidates as among rows."""
    study, table = study_of(JUMPY, [FALL, 3.0, 2.0])
    model = model_of(study).of_successes
    own, columns = model.posterior, model.columns
    x = points_of(table, model).matrix[:40]
    (_, like, _), (_, ranking, _), (_, shift, _), (_, near, scales) = (
        own.covariance.valued(own.theta)
    )
    d, m, u = x[:, columns.worlds], x[:, columns.mean], x[:, columns.coordinates]
    away = (u[:, None] - u) / scales
    expected = like * d @ d.T + ranking * m @ m.T + shift
    expected += near * np.exp(-0.5 * (away**2).sum(axis=2))
    assert_allclose(own.covariance.gram(own.theta, x)[0], expected)
    assert_allclose(own.covariance.towards(own.theta, x, np.float64)(x), expected)


def test_without_a_success_the_costs_of_all_worlds_are_parted():
    """Every trial is as with any success between the groups, but no chance is told."""
    for outcomes in (JUMPY, LONELY):
        given, table = study_of(outcomes, [FALL, *APART])
        parted, _ = study_of(outcomes, [FALL, *APART], success=None)
        ensemble = model_of(parted).ensemble
        below = outcomes[outcomes < ensemble.parting]
        assert below.max() < 3.0 < ensemble.parting < outcomes[outcomes > 3.0].min()
        space = table.rows.space.as_dict()
        assert parted.ask(space).params == given.ask(space).params
        found, wanted = (study.sampler.predict(study) for study in (parted, given))
        assert np.isnan(found.success).all() and np.isfinite(wanted.success).all()
        assert_allclose(found.value, wanted.value)


@pytest.mark.parametrize(
    "outcomes",
    [COSTS, JAGGED, np.where(UNIT[:, :1] < 0.5, COSTS, 1.1 * COSTS), 0.0 * COSTS + 1.0],
    ids=["smooth", "jagged", "groups that hardly differ", "equal"],
)
def test_costs_that_do_not_jump_between_two_groups_are_not_parted(outcomes):
    study, _ = study_of(outcomes, [2.0], success=None)
    assert model_of(study).ensemble.parting is None


def test_of_few_rows_nobody_knows_whether_costs_jump():
    few = FeatureTable.from_arrays(
        {"x0": UNIT[:24, 0]}, outcomes=1.0 + (UNIT[:24, :1] - 0.4) ** 2 + np.zeros(4)
    )
    study = optuna.create_study(sampler=FeatureKernelSampler(few, seed=1))
    told(study, few.rows.space.as_dict(), {"x0": float(UNIT[0, 0])}, 1.1)
    assert not model_of(study).ensemble.is_smooth
    assert not model_of(study).ensemble.jumps


def test_of_rows_alone_no_cost_is_parted():
    study, _ = study_of(JUMPY, [FALL, *APART], success=None, off_grid=0)
    assert model_of(study).success is None
    assert model_of(study).ensemble.parting is not None


def test_a_trial_that_breaks_a_limit_is_no_success_but_tells_what_one_costs():
    study, _ = study_of(LONELY, [FALL, 3.0, 2.0], limits=[-1.0, -1.0, 1.0])
    assert_array_equal(model_of(study).of_successes.costs, [3.0, 2.0])
    assert_array_equal(model_of(study).of_successes.feasible, [True, False])
    study, _ = study_of(LONELY, [FALL, 3.0, 2.0], limits=[-1.0, 1.0, 1.0])
    assert model_of(study).of_successes is None


@pytest.mark.parametrize("limits", [(), [-1.0, -0.5, 1.0, 2.0, -0.2]])
def test_utility_is_the_chance_of_success_times_the_improvement_if_it_comes(limits):
    """By SciPy's normal distribution, from the means and variances of both models.

    And times the chance that limits are kept; one of the trials that cost little broke one.
    Of what is likelier to fail than not the improvement does not count.
    """
    study, table = study_of(LONELY, [FALL, 3.0, 40.0, 2.0, 2.5], limits=limits)
    model = model_of(study)
    points = points_of(table, model)
    utility = model.utility(points, np.ones(ROWS, bool), np.random.default_rng(1))

    def costs_by(one):
        mean, variance = one.posterior.predict(one.visible(points))
        return mean + one.expected(points, one.cost()), np.sqrt(variance)

    mean, sd = costs_by(model)
    (goal,) = model.ensemble.standard(np.array([SUCCESS]))
    said = scipy.stats.norm.cdf(goal, mean, sd)
    shift, slope = ODDS
    success = scipy.special.expit(shift + slope * scipy.special.logit(said))
    kept = np.ones(ROWS)
    assert len(model.limit_posteriors) == (1 if limits else 0)
    for posterior in model.limit_posteriors.values():
        limit, variance = posterior.predict(model.visible(points))
        kept *= scipy.stats.norm.cdf(0.0, limit, np.sqrt(variance))
    mean, sd = costs_by(model.of_successes)
    costs = [3.0, 2.5] if limits else [3.0, 2.0, 2.5]
    best = model.of_successes.standard(
        np.array([min(costs)]), np.array([3.0, 2.0, 2.5])
    )
    z = (best - mean) / sd
    improvement = (best - mean) * scipy.stats.norm.cdf(z) + sd * scipy.stats.norm.pdf(z)
    likely = success >= 0.5
    seen = likely & (success * kept > 1e-6) & (improvement > 1e-9)
    assert seen.sum() > ROWS / 10
    found = np.exp(utility[seen])
    assert_allclose(found, (success * kept * improvement)[seen], rtol=1e-3)
    # What is likelier to fail comes after all others, by its chance alone.
    unlikely = ~likely & (success * kept > 1e-6)
    assert unlikely.sum() > ROWS / 10
    assert utility[unlikely].max() < utility[seen].min()
    chances = np.log(success * kept)[unlikely]
    assert_allclose(utility[unlikely] - chances, LOG_NO_GAIN, rtol=1e-6)


def test_costs_that_hardly_differ_in_the_table_are_told_apart_by_those_of_successes():
    """Beside falls that cost a thousand times as much two walks look alike.

    The row that costs least where it succeeds is found, though it fails as often.
    """
    costs = np.where(JUMPY < 20.0, JUMPY, 1000.0)
    study, table = study_of(costs, [1.3])
    model = model_of(study)
    points = points_of(table, model)
    utility = model.utility(points, np.ones(ROWS, bool), np.random.default_rng(1))
    mean = np.where(costs < 20.0, costs, np.nan)
    best = np.argsort(np.nanmean(mean, axis=1))[: ROWS // 10]
    assert np.argmax(utility) in best


def test_a_success_may_be_the_best_that_any_world_has():
    least = float(JUMPY.min())
    study, table = study_of(JUMPY, [FALL, least], success=least)
    assert model_of(study).of_successes is not None
    assert study.ask(table.rows.space.as_dict()).params


@pytest.mark.parametrize("spread", [0.0, 1e-9, 1e-3])
def test_what_is_likelier_to_fail_comes_last_though_no_success_is_an_improvement(
    spread,
):
    """Where successes hardly differ in the table, none of its rows may promise any."""
    walks = 1.0 + spread * RNG.random((ROWS, WORLDS))
    study, table = study_of(np.where(JUMPY < 20.0, walks, JUMPY), [FALL, 0.5])
    model = model_of(study)
    points = points_of(table, model)
    utility = model.utility(points, np.ones(ROWS, bool), np.random.default_rng(1))
    mean, variance = model._costs_at(points)
    chance = np.exp(as_it_happens(model._log_chance_of_success(mean, variance)))
    likely = chance >= 0.5
    assert 10 < likely.sum() < ROWS - 10
    assert utility[likely].min() > utility[~likely].max()


def test_eight_successes_have_units_of_their_own():
    """As smooth costs have; the chance of one stays in those of the table."""
    successes = np.linspace(1.5, 3.0, FAMILIAR)
    for count in (FAMILIAR - 1, FAMILIAR):
        model = model_of(study_of(JUMPY, [FALL, *successes[:count]])[0])
        own = model.of_successes
        assert not model.is_familiar
        assert own.is_familiar is (count == FAMILIAR)
        costs = log_excess(own.costs, own.costs)
        if not own.is_familiar:
            costs = own.ensemble.standard(own.costs)
        assert_allclose(own.cost(), costs)


def test_a_chance_counts_as_such_chances_come_true():
    said = np.array([0.0, 1e-9, 0.1, 0.5, 0.9, 1.0 - 1e-9, 1.0])
    with np.errstate(divide="ignore"):
        found = np.exp(as_it_happens(np.log(said)))
    shift, slope = ODDS
    expected = 1.0 / (
        1.0 + np.exp(-shift) * ((1.0 - said) / np.maximum(said, 1e-99)) ** slope
    )
    assert_allclose(found, expected, rtol=1e-6, atol=1e-60)
    assert found[-1] == 1.0


def test_goals_that_were_drawn_for_a_trial_have_no_successes():
    drawn = Ensemble(Worlds.of(JUMPY), JUMPY)
    assert drawn.with_successes(SUCCESS) is drawn


def test_failures_do_not_say_what_successes_cost():
    """The second process does not see them, however much they cost."""
    found = []
    for fall in (FALL, 45.0):
        study, table = study_of(LONELY, [fall, 3.0, fall, 2.0, 2.5])
        successes = model_of(study).of_successes
        points = points_of(table, successes)
        found.append(successes.posterior.predict(successes.visible(points)))
    assert_array_equal(found[0], found[1])
