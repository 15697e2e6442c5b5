"""Where costs jump, a candidate's chance to succeed counts, and what it costs if it does."""

from dataclasses import replace

import numpy as np
import optuna
import pytest
import scipy
from numpy.testing import assert_allclose, assert_array_equal

from study import FeatureKernelSampler, FeatureTable
from study.sampler.acquisition import LOG_NO_GAIN
from study.sampler.covariance import FEW_WORLDS
from study.sampler.evidence import FEW_SUCCESSES
from study.sampler.unlike import READING
from study.sampler.worlds import Ensemble, Worlds
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
APART = np.linspace(1.5, 6.0, FEW_SUCCESSES).tolist()
ALIKE = np.linspace(1.5, 1.51, FEW_SUCCESSES).tolist()


def study_of(outcomes, costs, limits=(), sign=1.0, **options):
    """A study of the first rows, which cost this; with a sign of -1 it is maximised."""
    columns = dict(zip(NAMES, UNIT.T, strict=True))
    table = FeatureTable.from_arrays(columns, outcomes=outcomes)
    options = {"seed": 1, "success": SUCCESS} | options
    direction = "minimize" if sign > 0.0 else "maximize"
    sampler = FeatureKernelSampler(table, **options)
    study = optuna.create_study(sampler=sampler, direction=direction)
    for row, cost in enumerate(costs):
        place = dict(zip(NAMES, UNIT[row].tolist(), strict=True))
        heat = {"heat": limits[row]} if len(limits) else {}
        told(study, table.rows.space.as_dict(), place, cost, **heat)
    return study, table


def points_of(table, model):
    return table.rows.points(by_order=True, coordinates=True, ensemble=model.ensemble)


def costs_by(model, points):
    """Mean and standard deviation of the cost, as the model sees it."""
    mean, variance = model.posterior.predict(model.visible(points))
    return mean + model.expected(points, model.cost()), np.sqrt(variance)


@pytest.mark.parametrize(
    ("outcomes", "costs", "options", "is_asked"),
    [
        (JUMPY, [FALL, *APART], {}, True),
        (JUMPY, APART, {}, True),
        (JUMPY, [FALL, *APART[1:]], {}, False),
        (LONELY, [FALL, 3.0], {}, True),
        (LONELY[:, : FEW_WORLDS - 1], [FALL, 3.0], {}, False),
        (LONELY, [FALL, FALL], {}, False),
        (LONELY, [FALL, 3.0], {"success": None}, True),
        (JAGGED, [FALL, 3.0], {"success": None}, False),
        (LONELY, [FALL, 3.0], {"off_grid": 0}, False),
        (LONELY, [FALL, 3.0], {"off_grid": 0, "success": None}, False),
        (COSTS, [FALL, *APART], {}, False),
        (JUMPY, [FALL, *ALIKE], {}, False),
    ],
    ids=[
        "four successes",
        "no failure",
        "three",
        "one where rows tell nothing",
        "and worlds are few",
        "none yet",
        "no success is told, and costs are two groups",
        "no success is told, and costs are one group",
        "rows alone",
        "rows alone, and no success is told",
        "smooth",
        "in units of the trials",
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
        assert successes.of_table is None
        assert successes.of_successes is None


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
    mean, sd = costs_by(model, points)
    (goal,) = model.ensemble.standard(np.array([SUCCESS]))
    success = scipy.stats.norm.cdf(goal, mean, sd)
    kept = np.ones(ROWS)
    assert len(model.limit_posteriors) == (1 if limits else 0)
    for posterior in model.limit_posteriors.values():
        limit, variance = posterior.predict(model.visible(points))
        kept *= scipy.stats.norm.cdf(0.0, limit, np.sqrt(variance))
    mean, sd = costs_by(model.of_successes, points)
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


def test_no_improvement_counts_for_more_than_one_to_the_least_cost_of_all_worlds():
    """Beside SciPy's integral of what is gained at each cost."""
    model = model_of(study_of(JUMPY, [FALL, 3.0])[0])
    assert model.least == model.ensemble.ends[0] < model.cost()[1]
    mean, sd = RNG.uniform(-2.0, 2.0, 20), RNG.uniform(0.05, 2.0, 20)
    found = np.exp(model._log_improvement(mean, sd**2))
    best, least = model.cost()[1], model.least - READING
    for place, expected in enumerate(found):
        cost = scipy.stats.norm(mean[place], sd[place])
        gain = cost.expect(lambda f: best - f, lb=least, ub=best)
        gain += (best - least) * cost.cdf(least)
        assert_allclose(expected, gain, rtol=1e-6, atol=1e-12)


def test_a_cost_below_that_of_all_worlds_can_be_improved_on():
    model = model_of(study_of(JUMPY, [FALL, 0.5])[0])
    assert model.cost()[1] < model.least
    below, none = model.cost()[1] - np.array([0.1, 5.0, 6.0]), np.array([9.0, 0.0])
    found = model._log_improvement(below, np.full(3, 0.01))
    assert np.exp(found[0]) == pytest.approx(0.1, rel=0.2)
    assert_allclose(np.exp(found[1:]), READING, rtol=1e-4)
    assert found[2] > found[1] + 1e-7  # of those that are sure the better one
    assert model._log_improvement(none[:1], none[1:]) == -np.inf


@pytest.mark.parametrize(
    ("outcomes", "costs"),
    [
        (LONELY, [FALL, 3.0]),
        (JUMPY[:, : FEW_WORLDS - 1], [FALL, 3.0]),
        (COSTS, [2.0, 3.0]),
        (JUMPY, [FALL, *ALIKE]),
    ],
    ids=["rows tell nothing", "few worlds", "smooth", "in units of the trials"],
)
def test_elsewhere_the_worlds_do_not_bound_it(outcomes, costs):
    assert model_of(study_of(outcomes, costs)[0]).least is None


def test_nor_do_they_bound_a_goal_that_was_drawn_for_a_trial():
    model = model_of(study_of(JUMPY, [FALL, 3.0])[0])
    drawn = Ensemble(Worlds.of(JUMPY), JUMPY)
    assert model.least is not None and replace(model, ensemble=drawn).least is None


def test_failures_do_not_say_what_successes_cost():
    """The second process does not see them, however much they cost."""
    found = []
    for fall in (FALL, 45.0):
        study, table = study_of(LONELY, [fall, 3.0, fall, 2.0, 2.5])
        successes = model_of(study).of_successes
        points = points_of(table, successes)
        found.append(successes.posterior.predict(successes.visible(points)))
    assert_array_equal(found[0], found[1])
