"""Where costs jump, a candidate's chance to succeed counts, and what it costs if it does.

The latter is told by a second process: by the trials that succeeded, and by the worlds in
which a row does.
"""

import numpy as np
import optuna
import pytest
import scipy
from numpy.testing import assert_allclose, assert_array_equal

from study import FeatureKernelSampler, FeatureTable
from study.sampler.acquisition import LOG_NO_GAIN, ODDS, as_it_happens
from study.sampler.covariance import FEW_WORLDS
from study.sampler.evidence import FAMILIAR, FEW_SUCCESSES
from study.sampler.transforms import log_excess
from study.sampler.worlds import EXPECTED_WORLDS, NARROWEST, Ensemble, Worlds
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
# Walks are cheap in one half of the space, and dear in the other; a row falls in some worlds.
WALKS = np.where(UNIT[:, :1] < 0.5, COSTS, 30.0 * COSTS)
SHARE = RNG.choice([0.3, 0.8], (ROWS, 1))
FAR = np.where(RNG.random((ROWS, WORLDS)) < SHARE, WALKS, 55.0 + COSTS)
# Some walks cost as much as a success.
EQUAL = np.where(FAR < 54.0, np.minimum(np.round(FAR, 1), 42.0), FAR)
FALL, SUCCESS = 90.0, 10.0
OF_FAR, UNTOLD = {"success": 54.0}, {"success": None}
APART = np.linspace(1.5, 6.0, FEW_SUCCESSES).tolist()
LOW = np.linspace(0.15, 0.6, FEW_SUCCESSES).tolist()


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


WHEN = {
    "four successes": (JUMPY, [FALL, *APART], {}, True),
    "no failure": (JUMPY, APART, {}, True),
    "three": (JUMPY, [FALL, *APART[1:]], {}, False),
    "one, where they lie far apart": (FAR, [FALL, 3.0], OF_FAR, True),
    "none of these": (FAR, [FALL, FALL], OF_FAR, False),
    "one, and worlds are few": (FAR[:, : FEW_WORLDS - 1], [FALL, 3.0], OF_FAR, False),
    "no success is told": (JUMPY, APART, UNTOLD, True),
    "nor are costs two groups": (JAGGED, [FALL, 3.0], UNTOLD, False),
    "rows alone": (FAR, [FALL, 3.0], OF_FAR | {"off_grid": 0}, True),
    "no success is told of these": (FAR, [3.0], UNTOLD | {"off_grid": 0}, False),
    "no world has one": (JUMPY, [FALL, *LOW], {"success": 0.9}, True),
    "nor have three trials": (JUMPY, [FALL, *LOW[1:]], {"success": 0.9}, False),
    "smooth": (COSTS, [FALL, *APART], {}, False),
}


@pytest.mark.parametrize(
    ("outcomes", "costs", "options", "is_asked"), WHEN.values(), ids=WHEN
)
def test_when_trials_that_succeeded_have_a_process_of_their_own(
    outcomes, costs, options, is_asked
):
    for sign in (1.0, -1.0):
        told_success = options.get("success", SUCCESS)
        success = None if told_success is None else sign * told_success
        values = sign * np.array(costs)
        own = options | {"success": success}
        model = model_of(study_of(sign * outcomes, values, sign=sign, **own)[0])
        found = model.of_successes
        assert (found is not None) is is_asked and not model.is_familiar
        if found is not None:
            assert_array_equal(found.costs, [cost for cost in costs if cost < FALL])
            assert found.ensemble.is_of_successes and found.of_successes is None


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
    study, _ = study_of(FAR, [FALL, 3.0, 2.0], limits=[-1.0, -1.0, 1.0], **OF_FAR)
    assert_array_equal(model_of(study).of_successes.costs, [3.0, 2.0])
    assert_array_equal(model_of(study).of_successes.feasible, [True, False])
    study, _ = study_of(FAR, [FALL, 3.0, 2.0], limits=[-1.0, 1.0, 1.0], **OF_FAR)
    assert model_of(study).of_successes is None


@pytest.mark.parametrize("limits", [(), [-1.0, -0.5, -0.4, 0.1, -0.8, -0.9, -0.7]])
@pytest.mark.parametrize(
    ("outcomes", "success", "off_grid", "even"),
    [(LONELY, SUCCESS, 9, 0.5), (FAR, 54.0, 0, 0.5), (LONELY, SUCCESS, 0, 0.0)],
)
def test_utility_is_the_chance_of_success_times_the_improvement_if_it_comes(
    outcomes, success, off_grid, even, limits
):
    """By SciPy's normal distribution, from the means and variances of both models.

    And times the chance that limits are kept; one of the trials that cost little broke one.
    Of what is likelier to fail, or to break one, the improvement does not count, but of rows
    alone whose successes hardly differ.
    """
    costs = [FALL, 3.0, 65.0, 2.0, 2.5, 2.2, 2.8]
    study, table = study_of(outcomes, costs, limits, success=success, off_grid=off_grid)
    model = model_of(study)
    points = points_of(table, model)
    utility = model.utility(points, np.ones(ROWS, bool), np.random.default_rng(1))
    mean, sd = costs_by(model, points)
    (goal,) = model.ensemble.standard(np.array([success]))
    chance = as_odds_have_it(scipy.stats.norm.cdf(goal, mean, sd))
    assert len(model.limit_posteriors) == bool(limits)
    for posterior in model.limit_posteriors.values():
        limit, variance = posterior.predict(model.visible(points))
        chance *= scipy.stats.norm.cdf(0.0, limit, np.sqrt(variance))
    mean, sd = costs_by(model.of_successes, points)
    least = 2.2 if limits else 2.0
    (best,) = model.of_successes.ensemble.standard(np.array([least]))
    z = (best - mean) / sd
    gain = (best - mean) * scipy.stats.norm.cdf(z) + sd * scipy.stats.norm.pdf(z)
    seen = (chance >= even) & (gain > 1e-9)
    assert seen.sum() > ROWS / 10
    assert_allclose(np.exp(utility[seen]), (chance * gain)[seen], rtol=1e-3)
    # What is likelier to fail comes after all others, by its chance alone.
    unlikely = (chance < even) & (chance > 1e-6)
    assert (unlikely.sum() > ROWS / 20) == (even > 0.0)
    assert utility[unlikely].max(initial=-np.inf) < utility[seen].min()
    gains = utility[unlikely] - np.log(chance[unlikely])
    assert_allclose(gains, LOG_NO_GAIN, rtol=1e-6)


def as_odds_have_it(said):
    """The chance of what is said to have this one."""
    shift, slope = ODDS
    return scipy.special.expit(shift + slope * scipy.special.logit(said))


def test_failures_do_not_say_what_successes_cost():
    """The second process does not see them, however much they cost."""
    found = []
    for fall in (FALL, 65.0):
        study, table = study_of(FAR, [fall, 3.0, fall, 2.0, 2.5], **OF_FAR)
        successes = model_of(study).of_successes
        points = points_of(table, successes)
        found.append(successes.posterior.predict(successes.visible(points)))
    assert_array_equal(found[0], found[1])


def test_goals_that_were_drawn_for_a_trial_have_no_successes():
    drawn = Ensemble(Worlds.of(FAR), FAR)
    assert drawn.with_successes(54.0) is drawn
    assert drawn.with_successes(None) is drawn


@pytest.mark.parametrize("success", [0.5, FAR.min()], ids=["none", "one"])
def test_where_worlds_tell_nothing_of_successes_their_trials_do(success):
    """No row is then expected to cost less than another, if it succeeds."""
    study, table = study_of(FAR, [FALL, 0.4, 0.3, 0.2, 0.35], success=success)
    own = model_of(study).of_successes
    told_rows = points_of(table, own).matrix[:, own.columns.mean]
    assert_allclose(told_rows, np.zeros((ROWS, 1)), atol=1e-6 / NARROWEST)
    assert np.isfinite(own.cost()).all() and (np.diff(np.sort(own.cost())) > 0.0).all()
    assert study.ask(table.rows.space.as_dict()).params


@pytest.mark.parametrize(
    ("outcomes", "success"), [(FAR, 54.0), (EQUAL, 42.0)], ids=["far", "equal"]
)
def test_rows_have_the_mean_of_their_costs_in_the_worlds_where_they_succeed(
    outcomes, success
):
    """In units of all successes; two worlds at the mean of these are added to each row."""
    study, table = study_of(outcomes, [FALL, 1.3], success=success)
    model = model_of(study)
    columns = model.columns
    seen = points_of(table, model).matrix
    own = model.ensemble.standard(outcomes)
    every = own[outcomes <= success]
    middle = every.mean()
    unit = every.std()
    told = (model.ensemble.standard(np.array([1.3])) - middle) / unit
    assert_allclose(model.of_successes.cost(), told)
    for row in range(0, ROWS, 7):
        succeeds = outcomes[row] <= success
        costs = (own[row] - middle) / unit
        mean = costs[succeeds].sum() / (succeeds.sum() + EXPECTED_WORLDS)
        away = np.where(succeeds, costs - mean, 0.0) / np.sqrt(WORLDS)
        assert_allclose(seen[row, columns.mean_of_successes], [mean], atol=1e-12)
        assert_allclose(seen[row, columns.successes], away, atol=1e-12)
    of_successes = model.of_successes.columns
    assert of_successes.worlds == columns.successes
    assert of_successes.mean == columns.mean_of_successes
    assert (of_successes.one, of_successes.gap) == (columns.one, columns.gap)


def test_it_is_a_process_over_columns_of_its_own():
    """Beside its formula; between rows and candidates as among rows."""
    study, table = study_of(FAR, [FALL, 3.0, 2.0], **OF_FAR)
    model = model_of(study).of_successes
    own, columns = model.posterior, model.columns
    x = points_of(table, model).matrix[:40]
    (_, like, _), (_, ranking, _), (_, shift, _), (_, near, scales) = (
        own.covariance.valued(own.theta)
    )
    d = x[:, columns.worlds]
    m = x[:, columns.mean]
    u = x[:, columns.coordinates]
    away = (u[:, None] - u) / scales
    expected = like * d @ d.T + ranking * m @ m.T + shift
    expected += near * np.exp(-0.5 * (away**2).sum(axis=2))
    assert_allclose(own.covariance.gram(own.theta, x)[0], expected)
    assert_allclose(own.covariance.towards(own.theta, x, np.float64)(x), expected)


def test_how_far_a_guess_between_rows_is_off_is_not_known_of_it():
    model = model_of(study_of(LONELY, [FALL, *APART])[0])
    assert model.guess_error is not None
    assert model.of_successes.guess_error is None


def test_eight_successes_have_units_of_their_own():
    """As smooth costs have; the chance of one stays in those of the table."""
    successes = np.linspace(1.5, 1.6, FAMILIAR)
    for count in (FAMILIAR - 1, FAMILIAR):
        model = model_of(study_of(FAR, [FALL, *successes[:count]], **OF_FAR)[0])
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
    assert_allclose(found, as_odds_have_it(said), rtol=1e-6, atol=1e-60)
    assert found[-1] == 1.0


def test_what_is_likelier_to_fail_comes_last_though_nothing_promises_to_be_better():
    study, table = study_of(FAR, [FALL, 1e-6], **OF_FAR)
    model = model_of(study)
    points = points_of(table, model)
    utility = model.utility(points, np.ones(ROWS, bool), np.random.default_rng(1))
    mean, variance = model._costs_at(points)
    chance = np.exp(as_it_happens(model._log_chance_of_success(mean, variance)))
    likely = chance >= 0.5
    assert 10 < likely.sum() < ROWS - 10
    assert utility[likely].min() > utility[~likely].max()
