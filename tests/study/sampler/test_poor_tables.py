"""Tables that tell little: few worlds, few rows, or rows that tell nothing of other points.

A walker's costs in one world: a row walks or falls there for reasons of its own.
"""

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from study import FeatureKernelSampler, FeatureTable
from study.sampler.between import BEST_ROWS
from study.sampler.covariance import FEW_WORLDS
from study.sampler.evidence import HOPELESS, RANKED, RANKED_OF_ONE
from study.sampler.history import placed
from study.sampler.worlds import Ensemble, Worlds
from tests.study.sampler.studies import model_of, rows_of, told

D = 3
RNG = np.random.default_rng(0)
UNIT = RNG.random((400, D))
BOWL = 1.0 + ((UNIT - 0.45) ** 2).sum(axis=1)
WALKS = RNG.random(400) < 0.2
JUMPY = np.where(WALKS, BOWL, 30.0 + 30.0 * RNG.random(400))
ORDER = np.argsort(JUMPY, kind="stable")
NAMES = [f"x{column}" for column in range(D)]
FALL, SUCCESS = 50.0, 2.0


def table_of(outcomes, count=400, better=None):
    """Of the first rows."""
    columns = dict(zip(NAMES, UNIT[:count].T, strict=True))
    return FeatureTable.from_arrays(columns, outcomes=outcomes[:count], better=better)


def ensemble_of(outcomes, count=400, better=None):
    return table_of(outcomes, count, better).rows.ensemble(np.ones(1))


def study_of(table, **options):
    options = {"seed": 1, "success": SUCCESS} | options
    return optuna.create_study(sampler=FeatureKernelSampler(table, **options))


def tell(study, table, row, cost, **limits):
    place = dict(zip(NAMES, UNIT[row].tolist(), strict=True))
    told(study, table.rows.space.as_dict(), place, cost, **limits)


@pytest.mark.parametrize(
    ("outcomes", "better", "is_from_best"),
    [
        (JUMPY, None, True),
        (BOWL, None, False),
        (np.column_stack([JUMPY, JUMPY]), None, False),
        (JUMPY, "lower", False),
        (np.full(400, 3.0), None, False),
    ],
    ids=["one world", "smooth", "two worlds", "a ranking", "equal"],
)
def test_costs_of_one_world_are_from_its_best_row_where_they_jump(
    outcomes, better, is_from_best
):
    ensemble = ensemble_of(outcomes, better=better)
    assert ensemble.ends[0] == ensemble.mean.min()
    if is_from_best:
        assert ensemble.mean.min() == pytest.approx(0.0, abs=1e-12)
    else:
        assert ensemble.mean.mean() == pytest.approx(0.0, abs=1e-12)
    if better is None:
        own = outcomes.reshape(400, -1)[:, 0]
        assert_allclose(ensemble.costs(ensemble.standard(own)), own, rtol=1e-9)
        assert ensemble.reaches(float(own.min()))
        assert not ensemble.reaches(float(own.min()) - 1e-6)


def test_costs_of_goals_that_are_drawn_are_from_the_mean():
    worlds = Worlds.of(JUMPY)
    assert Ensemble(worlds, worlds.costs).mean.mean() == pytest.approx(0.0, abs=1e-12)


def test_falls_of_the_best_rows_do_not_turn_one_worlds_order_round():
    """Five of the rows that walk there; before, those that fall there came next."""
    table = table_of(JUMPY)
    study = study_of(table)
    fallen = ORDER[:50:10]
    for row in fallen:
        tell(study, table, row, FALL)
    model = model_of(study)
    points = table.rows.points(by_order=True, coordinates=True, ensemble=model.ensemble)
    utility = model.utility(points, np.ones(400, bool), np.random.default_rng(1))
    utility[fallen] = -np.inf
    assert WALKS[np.argsort(-utility)[:30]].all()
    assert model.only_falls


def test_one_worlds_ranking_goes_on_until_a_trial_succeeds_or_six_have_failed():
    table = table_of(JUMPY)
    space = table.rows.space.as_dict()
    study = study_of(table)
    for _ in range(RANKED_OF_ONE):
        study.tell(study.ask(space), FALL)
    assert_array_equal(rows_of(study), ORDER[:RANKED_OF_ONE])
    assert model_of(study).is_lost
    succeeded = study_of(table)
    for cost in (FALL, FALL, FALL, 1.5):
        succeeded.tell(succeeded.ask(space), cost)
    assert_array_equal(rows_of(succeeded), ORDER[:4])
    assert succeeded.ask(space).user_attrs["row"] != ORDER[4]


@pytest.mark.parametrize(
    ("outcomes", "success"),
    [(np.column_stack([JUMPY, JUMPY]), SUCCESS), (JUMPY, 0.5)],
    ids=["two worlds", "a success of no world"],
)
def test_else_the_ranking_ends_after_three_trials(outcomes, success):
    table = table_of(outcomes)
    study = study_of(table, success=success)
    for count, row in enumerate(ORDER[:RANKED], start=1):
        tell(study, table, row, FALL)
        model = model_of(study)
        assert model.follows_ranking is (count < RANKED)


@pytest.mark.parametrize("heat", [1.0, -1.0])
def test_nor_does_it_go_on_once_a_limit_is_broken(heat):
    """Which the model minds."""
    table = table_of(JUMPY)
    study = study_of(table)
    for row in ORDER[:RANKED]:
        tell(study, table, row, FALL, heat=heat)
    assert model_of(study).follows_ranking is (heat < 0.0)


@pytest.mark.parametrize(
    ("outcomes", "count", "tells_little"),
    [
        (JUMPY, 400, True),
        (np.column_stack([BOWL] * FEW_WORLDS), 400, False),
        (np.column_stack([BOWL] * (FEW_WORLDS - 1)), 400, True),
        (np.column_stack([BOWL] * FEW_WORLDS), BEST_ROWS, False),
        (np.column_stack([BOWL] * FEW_WORLDS), BEST_ROWS - 1, True),
        (np.column_stack([JUMPY] * FEW_WORLDS), 400, True),
    ],
    ids=[
        "one world",
        "smooth",
        "nine worlds",
        "enough rows",
        "few rows",
        "rows that tell nothing",
    ],
)
def test_which_tables_tell_little(outcomes, count, tells_little):
    assert ensemble_of(outcomes, count).tells_little is tells_little


@pytest.mark.parametrize("off_grid", [64, 0])
@pytest.mark.parametrize(
    ("outcomes", "count"),
    [
        (JUMPY, 400),
        (np.column_stack([JUMPY] * FEW_WORLDS), 400),
        (np.column_stack([JUMPY, JUMPY]), 400),
        (JUMPY, 50),
    ],
    ids=["one world", "rows that tell nothing", "two worlds", "few rows"],
)
def test_a_table_that_tells_little_is_doubted_after_some_failures(
    outcomes, count, off_grid
):
    """They cost what failures cost in the worlds."""
    table = table_of(outcomes, count)
    study = study_of(table, off_grid=off_grid)
    for row in range(HOPELESS):
        tell(study, table, row, FALL)
        model = model_of(study)
        assert model.unlike() is None
        assert model.is_lost is (row == HOPELESS - 1 and off_grid > 0)


def test_a_success_among_falls_is_no_luck_and_its_surroundings_are_not_left():
    """Two falls lay 0.1 from it; falls alone are smooth, so that it looked like noise."""
    rng = np.random.default_rng(5)
    unit, at = rng.random((400, 5)), np.full(5, 0.55)
    names = [f"x{column}" for column in range(5)]

    def fell(points, centre):
        return 50.0 + 40.0 * np.sqrt(((points - centre) ** 2).sum(axis=-1))

    centre = 0.45 + 0.1 * rng.standard_normal(5)
    away = np.sqrt(((unit - centre) ** 2).sum(axis=1))
    world = np.where(away < 0.4, 1.0 + 4.0 * away, fell(unit, centre))
    columns = dict(zip(names, unit.T, strict=True))
    table = FeatureTable.from_arrays(columns, outcomes=world)
    study = study_of(table, success=10.0)
    step = np.array([0.05, -0.05, 0.05, 0.05, -0.05])
    falls = [at + step, at - step, *(at + 0.2 * rng.standard_normal((7, 5)))]
    for place in [at, *np.clip(falls, 0.05, 0.95)]:
        cost = 3.0 if place is at else float(fell(place, at))
        params = dict(zip(names, place.tolist(), strict=True))
        told(study, table.rows.space.as_dict(), params, cost)
    near = at + 0.03 * rng.standard_normal((20, 5))
    asked = [dict(zip(names, place.tolist(), strict=True)) for place in near]
    policy, model = study.sampler._policy, model_of(study)
    points = policy._seen(placed(policy.rows, asked), model.ensemble)
    chance = np.exp(model._log_chance_of_success(*model._costs_at(points)))
    assert chance.mean() > 0.5
