"""A machine that is like none of the worlds is called so by its first trials."""

import tracemalloc

import numpy as np
import optuna
import pytest
from optuna.distributions import FloatDistribution

from study import FeatureKernelSampler, FeatureTable
from study.sampler import evidence
from study.sampler.calibration import COST, COST_UNLIKE
from study.sampler.covariance import DOUBTED, WORLD
from study.sampler.evidence import FAMILIAR
from study.sampler.history import OFF_TABLE
from study.sampler.unlike import FALSE_ALARMS, LEAST_WORLDS, _is_farther
from tests.study.sampler.campaigns import machine_of
from tests.study.sampler.studies import model_of, told

LINE = np.linspace(0.0, 1.0, 41)
SPACE = {"x": FloatDistribution(0.0, 1.0)}
RNG = np.random.default_rng(3)
PLACES = RNG.uniform(0.3, 0.7, 24)
COSTS = 0.3 + (LINE[:, None] - PLACES) ** 2


def said(readings, costs=COSTS, direction="minimize", **options):
    """What is said after readings at every fourth row."""
    table = FeatureTable.from_arrays({"x": LINE}, outcomes=costs, **options)
    sampler = FeatureKernelSampler(table, seed=1)
    study = optuna.create_study(sampler=sampler, direction=direction)
    for place, value in enumerate(readings):
        told(study, SPACE, {"x": LINE[4 * place]}, value)
    return sampler.predict(study)


def test_a_machine_beyond_all_worlds_is_called_so_after_one_trial():
    found = said([2.0])
    least, most = COSTS[0].min(), COSTS[0].max()
    assert found.unlike.startswith(
        "Unlike all 24 worlds after 1 trial: 2 was read where"
    )
    assert f"say {least:.4g} to {most:.4g}." in found.unlike
    assert str(found).endswith(found.unlike) and "\n" not in found.unlike
    assert said([2.0, 0.4, 0.35, 0.31, 0.3]).unlike == found.unlike
    many = [2.0, *np.linspace(0.5, 0.3, FAMILIAR)]
    assert said(many).unlike == found.unlike  # costs in units of the trials by now


def test_a_machine_that_is_one_of_the_worlds_is_not():
    for world in range(5):
        assert not said(COSTS[::4, world][:6]).unlike
    assert not said([]).unlike


def test_readings_may_go_together_as_in_no_world():
    """Each reading is within the worlds, both are not: a world that is steep nowhere."""
    readings = np.array([COSTS[0].max(), COSTS[4].min(), COSTS[8].max()])
    found = said(readings).unlike
    assert "its readings go together as in none of them" in found


def test_of_values_that_are_maximised_the_readings_are_said_as_they_were():
    found = said([-2.0], costs=-COSTS, direction="maximize").unlike
    least, most = (-COSTS[0]).min(), (-COSTS[0]).max()
    assert f"-2 was read where they say {least:.4g} to {most:.4g}" in found


@pytest.mark.parametrize(
    ("costs", "options"),
    [
        (COSTS[:, : LEAST_WORLDS - 1], {}),
        (COSTS, {"better": "lower"}),
    ],
)
def test_few_worlds_and_other_units_do_not_tell(costs, options):
    assert not said([20.0, 30.0, 40.0], costs=costs, **options).unlike


def test_worlds_that_agree_call_a_machine_unlike_only_beyond_the_noise():
    """The spread of the table is what a reading may be off by."""
    same = np.tile(COSTS[:, :1], 12)
    assert not said(same[::4, 0][:3] * 1.001, costs=same).unlike
    assert said([3.0], costs=same).unlike


def test_intervals_are_wider():
    near = said([COSTS[0].max() + 0.02, *COSTS[4::4, 0][:3]])
    far = said([2.0, *COSTS[4::4, 0][:3]])
    assert far.unlike and COST_UNLIKE.scale > COST.scale
    width = far.high - far.low
    assert np.median(width) > np.median(near.high - near.low)


def test_false_alarms_are_about_as_many_as_were_chosen():
    """Of 240 made-up machines, which have one trial each at the best row of all worlds."""
    called = {True: 0, False: 0}
    for is_like in called:
        for seed in range(120):
            machine = machine_of("worlds", is_like=is_like, seed=40_000 + seed)
            sampler = FeatureKernelSampler(machine.table, seed=1)
            study = optuna.create_study(sampler=sampler)
            trial = study.ask(dict(machine.space))
            u = np.array([[*trial.params.values()]])
            study.tell(trial, float(machine.truth.costs(u)[0]))
            called[is_like] += bool(sampler.predict(study, [trial.params]).unlike)
    assert called[True] <= 120 * (FALSE_ALARMS[0] + 3.0 * np.sqrt(0.04 * 0.96 / 120))
    assert called[False] >= 120 * 0.25


def test_what_is_recommended_on_an_unlike_machine_has_a_wider_interval(monkeypatch):
    table = FeatureTable.from_arrays({"x": LINE}, outcomes=COSTS)
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1))
    for place, value in enumerate([2.0, 1.9, 2.1]):
        told(study, SPACE, {"x": LINE[4 * place]}, value)
    found = study.sampler.best(study)
    assert found.unlike and str(found).endswith(found.unlike)
    monkeypatch.setattr(evidence, "unlike", lambda *_: None)
    other = study.sampler.best(study)
    assert not other.unlike and not str(other).endswith(" ")
    assert found.high - found.low > 1.1 * (other.high - other.low)


def test_thousands_of_worlds_take_no_memory_by_their_square():
    many = 0.3 + (LINE[:, None] - np.linspace(0.3, 0.7, 4000)) ** 2
    tracemalloc.start()
    found = _is_farther(np.full(3, 9.0), many[:3], np.full(3, 0.04), 0.01)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found and most < 4000 * 3 * 3 * 8 * 10


def test_a_world_that_is_left_out_is_compared_with_the_others_alone():
    """By the definition: mean and covariance of the others, and each its own T."""
    told = np.random.default_rng(5).normal(size=(3, 9))
    doubt = np.array([0.04, 0.13, 0.04])

    def distance(cost, others):
        count = others.shape[1]
        spread = (1.0 + 1.0 / count) * np.cov(others)
        away = cost - others.mean(axis=1)
        inverse = np.linalg.inv(spread + np.diag(doubt))
        return away @ inverse @ away, np.trace(inverse @ np.diag(doubt))

    left_out = [distance(told[:, w], np.delete(told, w, axis=1)) for w in range(9)]
    theirs = np.array([own + noise for own, noise in left_out])
    share = 0.05  # of ten: beyond the largest one
    least = theirs.max() + np.log(1.0 / (share * 10.0)) * theirs.mean()
    far = told.mean(axis=1) + np.array([1.0, -2.0, 0.5])
    scale = np.sqrt(least / distance(far, told)[0])
    for times, is_farther in ((0.999, False), (1.001, True)):
        cost = told.mean(axis=1) + times * scale * (far - told.mean(axis=1))
        assert _is_farther(cost, told, doubt, share) == is_farther


# What is proposed on such a machine.
PLANE = {"x": FloatDistribution(0.0, 1.0), "y": FloatDistribution(0.0, 1.0)}
TRIED = RNG.random((60, 2))
FALLS = np.where(
    RNG.random((60, 8)) < 0.6, RNG.uniform(30.0, 60.0, (60, 8)), RNG.random((60, 8))
)
FALLS[:3] = RNG.uniform(30.0, 60.0, (3, 8))
FALLEN, LIKE = [500.0] * 3, [45.0] * 3  # costs, as in no world and as in some


def after(costs, limits=None, **options):
    """A study after the first rows, which cost so much."""
    columns = {"x": TRIED[:, 0], "y": TRIED[:, 1]}
    table = FeatureTable.from_arrays(
        columns, outcomes=FALLS, space=PLANE, limits=limits
    )
    options = {"success": 1.0, "seed": 1} | options
    study = optuna.create_study(sampler=FeatureKernelSampler(table, **options))
    for (x, y), cost in zip(TRIED, costs, strict=False):
        told(study, PLANE, {"x": x, "y": y}, cost)
    return study


@pytest.mark.parametrize(
    ("costs", "success", "is_lost"),
    [
        (FALLEN, 1.0, True),
        (FALLEN + FALLEN, 1.0, True),
        (LIKE, 1.0, False),
        ([*FALLEN, 0.5], 1.0, False),
        (FALLEN, None, False),
        (FALLEN, 1e-9, False),
    ],
    ids=["unlike", "six falls", "like", "succeeded", "no success", "of no world"],
)
def test_which_world_an_unlike_machine_is_like_counts_less(costs, success, is_lost):
    study = after(costs, success=success, off_grid=0)  # a few rows tell little, too
    model = model_of(study)
    assert model.is_lost is is_lost
    likeness, *_ = model.posterior.covariance.terms
    assert likeness.variance == (DOUBTED if is_lost else WORLD)


def test_every_other_of_its_trials_is_what_the_plain_process_proposes():
    """It is told the same trials; the others are rows that may succeed."""
    found = {}
    for turn, later in ((3, []), (4, [400.0]), (5, [400.0, 300.0])):
        study = after(FALLEN + later)
        plain = optuna.create_study(
            sampler=FeatureKernelSampler(None, seed=1, space=PLANE)
        )
        for trial in study.trials:
            told(plain, PLANE, trial.params, trial.value)
        proposed, other = study.ask(PLANE), plain.ask(PLANE)
        assert (proposed.params == other.params) is (turn % 2 == 1)
        found[turn] = proposed.user_attrs["row"]
    assert found[3] == found[5] == OFF_TABLE and found[4] >= 0


def test_no_trial_goes_anywhere_where_rows_alone_or_a_risk_are_allowed():
    limits = {"limits": {"fall": FALLS - 61.0}}  # which no row breaks in any world
    for options, leaves in (
        ({}, True),
        ({"off_grid": 0}, False),
        (limits | {"allowed_risk": 0.5}, False),
    ):
        study = after(FALLEN, **options)
        policy = study.sampler._policy
        model = policy.present(study).model
        assert model.is_lost and policy.leaves_worlds(model, 3) is leaves
        assert not policy.leaves_worlds(model, 4)
        assert leaves is (study.ask(PLANE).user_attrs["row"] == OFF_TABLE)
