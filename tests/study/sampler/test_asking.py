"""A simulator that is asked: points off a table have what worlds cost there, not what rows tell."""

import warnings
from math import inf, nan

import numpy as np
import optuna
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from optuna.distributions import IntDistribution

from study import FeatureKernelSampler, FeatureTable
from study.sampler.asking import ASKED
from study.sampler.history import OFF_TABLE
from study.sampler.worlds import Worlds
from tests.study.conftest import refused
from tests.study.sampler.studies import model_of, rows_of, told

D, ROWS, WORLDS = 3, 200, 12
RNG = np.random.default_rng(8)
UNIT = RNG.random((ROWS, D))
CENTRES = RNG.uniform(0.3, 0.7, (WORLDS, D))
NAMES = [f"x{column}" for column in range(D)]
FALL, SUCCESS = 90.0, 10.0


def simulated(points):
    """Walks cost a little more than 1; who is at a crest of a wave falls."""
    away = ((points[:, None] - CENTRES) ** 2).sum(axis=2)
    falls = np.sin(40.0 * points.sum(axis=1))[:, None] > 0.2 + away
    return np.where(falls, FALL, 1.0 + away)


def smooth(points):
    """Without falls; points between rows would be guessed far off: all rows cost 1 more."""
    away = ((points[:, None] - CENTRES) ** 2).sum(axis=2)
    return np.where(np.isin(points[:, :1], UNIT[:, 0]), 2.0 + away, 1.0 + away)


def crossed(points):
    """Of two goals, [n, w, 2]."""
    return np.stack([simulated(points), -simulated(points[:, ::-1])], axis=-1)


def table_of(function=simulated, **options):
    columns = dict(zip(NAMES, UNIT.T, strict=True))
    return FeatureTable.from_arrays(columns, outcomes=function(UNIT), **options)


def study_of(trials, table=None, function=simulated, direction="minimize", **options):
    """Trials of a machine that is like the first of the worlds."""
    options = {"seed": 3, "success": SUCCESS, "feature_function": function} | options
    sampler = FeatureKernelSampler(table or table_of(), **options)
    study = optuna.create_study(sampler=sampler, direction=direction)
    go_on(study, trials)
    return study


def go_on(study, trials):
    sign = 1.0 if study.direction.name == "MINIMIZE" else -1.0

    def machine(trial):
        point = np.array([[trial.suggest_float(name, 0.0, 1.0) for name in NAMES]])
        return sign * float(simulated(point)[0, 0])

    study.optimize(machine, n_trials=trials)


@pytest.mark.parametrize(
    ("outcomes", "better", "sign"),
    [
        (simulated(UNIT), None, 1.0),
        (-simulated(UNIT), None, -1.0),
        (simulated(UNIT) - 5.0, None, 1.0),
        (simulated(UNIT)[:, :1], None, 1.0),
        (simulated(UNIT).clip(max=2.0), None, 1.0),
        (simulated(UNIT), "lower", -1.0),
        (simulated(UNIT), "higher", 1.0),
    ],
    ids=["fall", "maximised", "of any sign", "one world", "smooth", "lower", "higher"],
)
@pytest.mark.parametrize("success", [None, SUCCESS, 1.2])
def test_a_row_that_is_simulated_has_what_the_table_has_of_it(
    outcomes, better, sign, success
):
    columns = dict(zip(NAMES, UNIT.T, strict=True))
    rows = FeatureTable.from_arrays(columns, outcomes=outcomes, better=better).rows
    ensemble = rows.ensemble(np.array([sign]))
    ensemble = ensemble.with_successes(None if success is None else sign * success)
    assert_allclose(ensemble.columns_of(outcomes), ensemble.columns, atol=1e-9)


def test_so_has_one_of_two_goals():
    from study.sampler.goals import Goals

    worlds = Worlds.of(crossed(UNIT))
    goals = Goals.drawn(worlds.costs.reshape(-1, 2), np.random.default_rng(1))
    rows = table_of(crossed).rows
    ensemble = rows.ensemble(np.ones(2), goals)
    assert_allclose(ensemble.columns_of(crossed(UNIT)), ensemble.columns, atol=1e-9)


@pytest.mark.parametrize("direction", ["minimize", "maximize"])
def test_trials_off_the_table_have_what_worlds_cost_there(direction):
    sign = 1.0 if direction == "minimize" else -1.0

    def function(points):
        return sign * simulated(points)

    success = sign * SUCCESS
    study = study_of(12, table_of(function), function, direction, success=success)
    off = np.array(rows_of(study)) == OFF_TABLE
    assert off.any()
    model = model_of(study)
    points = np.array([[*trial.params.values()] for trial in study.trials])
    told_there = model.ensemble.told(model.trials.features)
    expected = model.ensemble.standard(simulated(points))
    assert_allclose(told_there, expected, atol=1e-9)
    (gap,) = model.columns.gap
    assert_array_equal(model.trials.features[:, gap], 0.0)


def test_what_is_proposed_was_simulated_and_is_the_best_of_it():
    """The point of the largest utility of those that were asked, 16 for each proposal."""
    asked = []

    def noted(points):
        asked.append(points.copy())
        return simulated(points)

    study = study_of(9, function=noted)
    sizes = [len(points) for points in asked]
    assert max(sizes) == ASKED
    every = np.vstack(asked)
    assert len(np.unique(every, axis=0)) == len(every)  # each once
    for trial in study.trials:
        if trial.user_attrs["row"] == OFF_TABLE:
            point = np.array([*trial.params.values()])
            assert (every == point).all(axis=1).sum() == 1


def test_a_simulator_of_other_worlds_than_the_tables_is_warned_of():
    with pytest.warns(
        UserWarning, match=r"^feature_function: row \d+, simulated, comes"
    ):
        study_of(2, function=lambda points: simulated(points)[:, ::-1])
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        study_of(4)


def test_another_process_proposes_the_same():
    study = study_of(8)
    again = optuna.create_study(
        sampler=FeatureKernelSampler(
            table_of(), seed=3, success=SUCCESS, feature_function=simulated
        )
    )
    again.add_trials(study.trials)
    for each in (study, again):
        go_on(each, 3)
    assert [trial.params for trial in again.trials] == [
        trial.params for trial in study.trials
    ]


def test_a_trial_that_a_person_chose_is_simulated_too():
    study = study_of(3)
    space = study.sampler.infer_relative_search_space(study, None)
    chosen = dict.fromkeys(NAMES, 0.4321)
    told(study, space, chosen, 1.5)
    model = model_of(study)
    costs = simulated(np.full((1, D), 0.4321))
    expected = model.ensemble.standard(costs)
    assert_allclose(model.ensemble.told(model.trials.features[-1:]), expected)


@pytest.mark.filterwarnings("ignore:feature_function")
def test_what_is_predicted_of_a_point_is_simulated_as_well():
    """Before a trial nothing else is known of it than what it costs in the worlds."""
    study, point = study_of(0, table_of(smooth), smooth), np.full((1, D), 0.4321)
    told = study.sampler.predict(study, [dict(zip(NAMES, point[0], strict=True))])
    costs = smooth(point)
    assert costs.min() <= told.value[0] <= costs.max()


@pytest.mark.filterwarnings("ignore:feature_function")
def test_points_of_which_the_simulator_tells_nothing_are_not_proposed():
    def partly(points):
        return np.where(points[:, :1] < 0.5, nan, simulated(points))

    study = study_of(14, function=partly)
    for trial in study.trials:
        assert trial.user_attrs["row"] != OFF_TABLE or trial.params["x0"] >= 0.5
    silent = study_of(8, function=lambda points: nan * simulated(points))
    assert OFF_TABLE not in rows_of(silent)


SIDE = np.arange(12)
GRID = np.array([(x, y) for x in SIDE[::3] for y in SIDE[::3]])


def on_grid(points):
    away = (points[:, :1] - 5.0) ** 2 + (points[:, 1:] - 7.0) ** 2
    return away * np.linspace(0.5, 1.5, 6) + 1.0


def grid_study(function, trials):
    """Of a table of 16 of the 144 points of two integers."""
    space = {"x": IntDistribution(0, 11), "y": IntDistribution(0, 11)}
    columns = {"x": GRID[:, 0], "y": GRID[:, 1]}
    table = FeatureTable.from_arrays(columns, outcomes=on_grid(GRID), space=space)
    sampler = FeatureKernelSampler(table, seed=1, feature_function=function)
    study = optuna.create_study(sampler=sampler)
    for _ in range(trials):
        trial = study.ask(space)
        point = np.array([[trial.params["x"], trial.params["y"]]])
        study.tell(trial, float(on_grid(point).mean()))
    return study


def test_points_that_are_the_same_are_simulated_once():
    asked = []

    def noted(points):
        asked.append(points.copy())
        return on_grid(points)

    grid_study(noted, 8)
    every = np.vstack(asked)
    assert len(np.unique(every, axis=0)) == len(every)
    assert max(map(len, asked)) == ASKED


@pytest.mark.filterwarnings("ignore:feature_function")
@pytest.mark.parametrize("told", ["nothing", "half"])
def test_where_no_row_is_left_a_silent_simulator_repeats_nothing(told):
    def silent(points):
        is_silent = (points[:, :1] < 6) | (told == "nothing")
        return np.where(is_silent, nan, on_grid(points))

    study = grid_study(silent, 40)
    tried = [tuple(trial.params.values()) for trial in study.trials]
    assert len(set(tried)) == 40


@pytest.mark.filterwarnings("ignore:feature_function")
def test_an_answer_that_is_refused_is_not_kept():
    """A function that is mended goes on; one that changes its worlds is refused each time."""
    fewer = [True]

    def mended(points):
        return simulated(points)[:, 1:] if fewer[0] else simulated(points)

    study = study_of(0, function=mended)
    space = study.sampler.infer_relative_search_space(study, None)
    told(study, space, dict.fromkeys(NAMES, 0.4321), 1.5)
    with refused(r"outcomes\(params\).shape: \(1, 11\)"):
        go_on(study, 1)
    fewer[0] = False
    go_on(study, 3)
    fewer[0] = True
    with refused(r"outcomes\(params\).shape: \(\d+, 11\)"):
        go_on(study, 4)


@pytest.mark.parametrize("infinite", [inf, -inf])
def test_an_infinite_outcome_counts_as_it_does_in_the_table(infinite):
    def diverging(points):
        return np.where(simulated(points) == FALL, infinite, simulated(points))

    rows = table_of(diverging).rows
    ensemble = rows.ensemble(np.ones(1)).with_successes(SUCCESS)
    assert_allclose(ensemble.columns_of(diverging(UNIT)), ensemble.columns, atol=1e-9)
    study = study_of(10, table_of(diverging), diverging)
    assert np.isfinite(model_of(study).trials.features).all()
    # One that no row has is beyond all of these.
    finite = table_of().rows.ensemble(np.ones(1))
    beyond = finite.told(finite.columns_of(np.full((1, WORLDS), infinite)))
    low, high = finite.ends
    assert (beyond > high).all() if infinite > 0.0 else (beyond < low).all()


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (
            lambda points: 1 / 0,
            r"outcomes\(params\): 'ZeroDivisionError.* no exception",
        ),
        (
            lambda points: simulated(points)[:, 1:],
            r"outcomes\(params\).shape: .*, 11\)",
        ),
        (lambda points: simulated(points)[1:], r"outcomes\(params\).shape: \(0, "),
        (lambda points: "walks", r"outcomes\(params\): 'str' .* numbers"),
    ],
    ids=["raises", "a world too few", "a point too few", "words"],
)
def test_what_does_not_simulate_is_refused_before_the_trial_runs(function, message):
    study = study_of(1, function=function)
    with refused(message):
        go_on(study, 3)
    assert study.trials[-1].params == {}


def test_a_pool_of_which_likeness_is_known_has_nothing_to_simulate():
    table = FeatureTable.from_kernel(np.eye(3))
    with refused("feature_function: 'given' .* none beside a similarity"):
        FeatureKernelSampler(table, feature_function=simulated)
