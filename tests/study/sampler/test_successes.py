"""What successes cost in the worlds, where these lie far apart: a process of its own tells it."""

import numpy as np
import pytest
import scipy
from numpy.testing import assert_allclose, assert_array_equal

from study.sampler.acquisition import LOG_NO_GAIN, ODDS, as_it_happens
from study.sampler.covariance import FEW_WORLDS
from study.sampler.evidence import FAMILIAR
from study.sampler.transforms import log_excess
from study.sampler.worlds import EXPECTED_WORLDS, Ensemble, Worlds
from tests.study.sampler.studies import model_of
from tests.study.sampler.test_hurdle import (
    COSTS,
    JUMPY,
    LONELY,
    ROWS,
    UNIT,
    WORLDS,
    costs_by,
    points_of,
    study_of,
)

RNG = np.random.default_rng(7)
FALL, SUCCESS = 90.0, 54.0
# Walks are cheap in one half of the space, and dear in the other; a row falls in some worlds.
WALKS = np.where(UNIT[:, :1] < 0.5, COSTS, 30.0 * COSTS)
SHARE = RNG.choice([0.3, 0.8], (ROWS, 1))
FAR = np.where(RNG.random((ROWS, WORLDS)) < SHARE, WALKS, 55.0 + COSTS)
# Some walks cost as much as a success.
EQUAL = np.where(FAR < SUCCESS, np.minimum(np.round(FAR, 1), 42.0), FAR)


def study_after(costs, outcomes=FAR, success=SUCCESS, **options):
    return study_of(outcomes, costs, success=success, **options)


@pytest.mark.parametrize(
    ("outcomes", "options"),
    [
        (FAR, {}),
        (FAR, {"off_grid": 0}),
        (-FAR, {"direction": "maximize", "success": -SUCCESS}),
    ],
    ids=["a table", "rows alone", "maximised"],
)
def test_from_the_first_success_on_it_has_a_process(outcomes, options):
    options = dict(options)
    sign = -1.0 if options.pop("direction", "") else 1.0
    for costs, is_there in (([FALL, FALL], False), ([FALL, 3.0], True)):
        values = sign * np.array(costs)
        study, _ = study_after(values, outcomes, sign=sign, **options)
        model = model_of(study)
        assert (model.of_successes is not None) is is_there
        assert model.is_familiar is False
    assert_array_equal(model.of_successes.costs, [3.0])
    assert model.of_successes.of_successes is None
    assert model.of_successes.least is None


NOT_TOLD = {
    "smooth": (COSTS, 1.5),
    "successes lie close to each other": (JUMPY, 10.0),
    "few worlds": (FAR[:, : FEW_WORLDS - 1], SUCCESS),
    "rows that tell nothing": (LONELY, 10.0),
    "no world has a success": (FAR, 0.5),
    "the best of all is a success, and no other": (FAR, float(FAR.min())),
}


@pytest.mark.parametrize(("outcomes", "success"), NOT_TOLD.values(), ids=NOT_TOLD)
def test_elsewhere_worlds_do_not_tell_it(outcomes, success):
    study, table = study_after([FALL, 0.4], outcomes, success)
    ensemble = model_of(study).ensemble
    assert ensemble.of_successes is None
    assert ensemble.with_successes(success) is ensemble
    assert study.ask(table.rows.space.as_dict()).params


def test_goals_that_were_drawn_for_a_trial_have_no_successes():
    drawn = Ensemble(Worlds.of(FAR), FAR)
    assert drawn.with_successes(SUCCESS) is drawn
    assert drawn.with_successes(None) is drawn


@pytest.mark.parametrize(
    ("outcomes", "success"), [(FAR, SUCCESS), (EQUAL, 42.0)], ids=["far", "equal"]
)
def test_rows_have_the_mean_of_their_costs_in_the_worlds_where_they_succeed(
    outcomes, success
):
    """In units of all successes; two worlds at the mean of these are added to each row."""
    study, table = study_after([FALL, 1.3], outcomes, success)
    model = model_of(study)
    columns, seen = model.columns, points_of(table, model).matrix
    own = model.ensemble.standard(outcomes)
    every = own[outcomes <= success]
    middle, unit = every.mean(), every.std()
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
    study, table = study_after([FALL, 3.0, 2.0])
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


def test_eight_successes_have_units_of_their_own():
    """As smooth costs have; the chance of one stays in those of the table."""
    successes = np.linspace(1.5, 1.6, FAMILIAR)
    for count in (FAMILIAR - 1, FAMILIAR):
        model = model_of(study_after([FALL, *successes[:count]])[0])
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
    against = (1.0 - said) / np.maximum(said, 1e-99)
    expected = 1.0 / (1.0 + np.exp(-shift) * against**slope)
    assert_allclose(found, expected, rtol=1e-6, atol=1e-60)
    assert found[-1] == 1.0


def test_utility_is_that_chance_times_the_improvement_if_it_comes():
    """By SciPy's normal distribution, from the means and variances of both models."""
    study, table = study_after([FALL, 30.0, 65.0, 25.0])
    model = model_of(study)
    points = points_of(table, model)
    utility = model.utility(points, np.ones(ROWS, bool), np.random.default_rng(1))
    mean, sd = costs_by(model, points)
    (goal,) = model.ensemble.standard(np.array([SUCCESS]))
    said = scipy.stats.norm.cdf(goal, mean, sd)
    shift, slope = ODDS
    chance = scipy.special.expit(shift + slope * scipy.special.logit(said))
    mean, sd = costs_by(model.of_successes, points)
    (best,) = model.of_successes.ensemble.standard(np.array([25.0]))
    z = (best - mean) / sd
    gain = (best - mean) * scipy.stats.norm.cdf(z) + sd * scipy.stats.norm.pdf(z)
    seen = (chance >= 0.5) & (gain > 1e-9)
    assert seen.sum() > ROWS / 10
    assert_allclose(np.exp(utility[seen]), (chance * gain)[seen], rtol=1e-3)
    unlikely = (chance < 0.5) & (chance > 1e-6)
    assert unlikely.sum() > ROWS / 20
    assert utility[unlikely].max() < utility[seen].min()
    gains = utility[unlikely] - np.log(chance[unlikely])
    assert_allclose(gains, LOG_NO_GAIN, rtol=1e-6)


def test_what_is_likelier_to_fail_comes_last_though_nothing_promises_to_be_better():
    study, table = study_after([FALL, 1e-6])
    model = model_of(study)
    points = points_of(table, model)
    utility = model.utility(points, np.ones(ROWS, bool), np.random.default_rng(1))
    mean, variance = model._costs_at(points)
    chance = np.exp(as_it_happens(model._log_chance_of_success(mean, variance)))
    likely = chance >= 0.5
    assert 10 < likely.sum() < ROWS - 10
    assert utility[likely].min() > utility[~likely].max()
