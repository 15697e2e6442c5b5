"""What to expect before the first trial: worlds that are left out take the machine's place."""

from dataclasses import replace
from math import inf, isnan

import numpy as np
import optuna
import pytest
from optuna.distributions import FloatDistribution

from storage.inputs.errors import InputError
from study import FeatureKernelSampler, FeatureTable, Forecast, forecast
from study.sampler.forecast import MOST_ROBOTS, TRIALS, Robot, some_worlds
from tests.study.sampler.campaigns import machine_of

LINE = np.linspace(0.0, 1.0, 41)
PLACES = np.random.default_rng(3).uniform(0.2, 0.8, 8)
COSTS = 0.3 + (LINE[:, None] - PLACES) ** 2
SUCCESS = 0.32


def table_of(outcomes=COSTS, **options):
    return FeatureTable.from_arrays({"x": LINE}, outcomes=outcomes, **options)


def by_hand(world):
    """Costs of ten trials in a world that the sampler was not told of."""
    known = table_of(np.delete(COSTS, world, axis=1))
    sampler = FeatureKernelSampler(known, seed=0, success=SUCCESS, off_grid=0)
    study = optuna.create_study(sampler=sampler)
    for _ in range(TRIALS):
        trial = study.ask({"x": FloatDistribution(0.0, 1.0)})
        study.tell(trial, COSTS[trial.user_attrs["row"], world])
    return np.array([trial.value for trial in study.trials])


def test_each_world_is_left_out_and_tells_what_its_rows_cost():
    told, seen = list[tuple[int, int]](), [by_hand(world) for world in range(8)]
    found = forecast(table_of(), success=SUCCESS, report=lambda *n: told.append(n))
    assert [robot.best for robot in found.like] == [min(costs) for costs in seen]
    good = [costs <= SUCCESS for costs in seen]
    firsts = [each.argmax() + 1.0 if each.any() else inf for each in good]
    assert [robot.first for robot in found.like] == firsts
    assert found.strange == () and told == [(done, 8) for done in range(1, 9)]
    assert found == forecast(table_of(), success=SUCCESS)


def test_of_values_that_are_maximised_it_is_the_mirror_image():
    found = forecast(table_of(), success=SUCCESS)
    other = forecast(table_of(-COSTS), success=-SUCCESS, maximise=True)
    assert [robot.first for robot in other.like] == [r.first for r in found.like]
    assert [robot.best for robot in other.like] == [-r.best for r in found.like]


def test_a_family_is_left_out_as_a_whole():
    """One family wants the left end, the other the right one."""
    left = 0.3 + (LINE[:, None] - [0.05, 0.1, 0.15]) ** 2
    right = 0.3 + (LINE[:, None] - [0.9, 0.95, 1.0]) ** 2
    found = forecast(table_of({"left": left, "right": right}), success=0.301)
    assert {robot.family for robot in found.like} == {"left", "right"}
    soon = [sum(r.first <= 3 for r in kind) for kind in (found.like, found.strange)]
    assert soon[0] > soon[1] and len(found.strange) == 6
    assert "While no world of their kind was known" in str(found)


def robots(*firsts, family="world"):
    return tuple(Robot(family, first, 0.5) for first in firsts)


@pytest.mark.parametrize(
    ("firsts", "said"),
    [
        ((1.0, 1.0), "all succeeded in the first trial"),
        (
            (1.0, 3.0, 9.0),
            "1 succeeded in the first trial, 2 within 3 trials, all within 9 trials",
        ),
        ((2.0, 2.0), "all succeeded within 2 trials"),
        ((2.0, inf), "1 succeeded within 2 trials, 1 not within 10"),
        ((inf, inf), "none succeeded within 10 trials"),
    ],
)
def test_a_sentence_says_how_many_and_when(firsts, said):
    shown = str(Forecast(TRIALS, robots(*firsts), ()))
    assert f"{len(firsts)} robots like your worlds {said}; best value" in shown
    assert shown.endswith("Another machine is harder.")


def test_families_of_which_few_succeed_soon_are_called_hard():
    up, down = robots(inf, 7.0, 2.0, family="up"), robots(1.0, 9.0, family="down")
    found = Forecast(TRIALS, up + down, ())
    assert found.hard == ["up (1 of 3)"] and "Hard, within 3 trials: up" in str(found)
    assert found.first == (1.0, 7.0, inf)
    assert replace(found, strange=up).hard == found.hard


def test_a_table_whose_worlds_all_fall_says_so():
    found = forecast(table_of(), success=0.1)
    assert all(robot.first == inf for robot in found.like)
    assert "none succeeded within 10 trials" in str(found)


def test_without_a_success_it_tells_of_values_alone():
    found = forecast(table_of())
    assert all(isnan(robot.first) for robot in found.like)
    assert "succeed" not in str(found) and not found.hard
    assert str(found).startswith("8 robots like your worlds: best value after 10: 0.3")


def test_one_row_is_tried_again_and_again():
    table = FeatureTable.from_arrays({"x": [0.5]}, outcomes=[[0.3, 0.4]])
    found = forecast(table, success=0.35)
    assert [robot.first for robot in found.like] == [1.0, inf]
    assert [robot.best for robot in found.like] == [0.3, 0.4]


def test_robots_of_which_nothing_is_within_the_risk_are_named():
    broken = {"fall": np.where(LINE[:, None] + PLACES > 0.0, 1.0, -1.0)}
    found = forecast(table_of(limits=broken), success=SUCCESS, allowed_risk=0.05)
    assert all(robot.refused and isnan(robot.best) for robot in found.like)
    assert "for 8 no candidate was within the allowed risk" in str(found)


@pytest.mark.parametrize(
    ("known", "said"),
    [
        ({"outcomes": COSTS[:, :1]}, "table.outcomes: '1 world' .* two worlds or more"),
        (
            {"outcomes": COSTS, "better": "lower"},
            "better='lower'\" .* units of their own",
        ),
        ({"outcomes": np.dstack([COSTS, COSTS])}, "'2 goals' .* one goal"),
        ({"features": COSTS}, "table.outcomes: 'none' .* costs in two worlds"),
    ],
)
def test_what_tells_nothing_of_trials_is_one_line(known, said):
    candidates = FeatureTable.from_arrays({"x": LINE}, **known)
    with pytest.raises(InputError, match=said) as refused:
        forecast(candidates)
    assert "\n" not in str(refused.value)


def test_of_thousands_of_worlds_every_family_gives_some():
    names = [*(f"a {n}" for n in range(3)), *(f"b {n}" for n in range(5000))]
    chosen = some_worlds(names, MOST_ROBOTS)
    assert chosen[:3] == [0, 1, 2] and len(chosen) == MOST_ROBOTS
    assert np.ptp(np.diff(chosen[3:])) <= 1
    many = [f"family {n} 0" for n in range(100)]
    assert len(some_worlds(many, MOST_ROBOTS)) == MOST_ROBOTS
    rng = np.random.default_rng(1)
    costs = 0.3 + (LINE[:, None] - rng.uniform(0.2, 0.8, 3000)) ** 2
    found = forecast(table_of(costs), success=SUCCESS, robots=2)
    assert len(found.like) == 2


def test_risks_that_are_allowed_end_a_robot_that_has_no_candidate_left():
    limits = {"fall": np.ones_like(COSTS)}
    table = table_of(limits=limits)
    found = forecast(table, success=SUCCESS, allowed_risk=0.01)
    assert all(robot.first == inf and isnan(robot.best) for robot in found.like)
    careful = forecast(table_of(limits={"fall": COSTS - 0.4}), allowed_risk=0.5)
    assert not any(isnan(robot.best) for robot in careful.like)


def test_a_world_may_be_left_out_of_its_family():
    worlds = table_of({"a": COSTS[:, :3], "b": COSTS[:, 3:]}).rows.worlds
    assert worlds is not None
    left = worlds.without(["a 1"])
    assert left.names[:2] == ("a 0", "a 2") and left.costs.shape == (41, 7)
    np.testing.assert_allclose(left.weights, [0.25, 0.25, *5 * [0.1]])
    np.testing.assert_allclose(worlds.without(["a 0", "a 1", "a 2"]).weights, 0.2)
    assert replace(left).of_numbers(np.array([4])).costs.shape == (1, 7)


def first_said(machine, unknown):
    """The chance to succeed that is said of the first trial, and whether the world succeeds."""
    rows = machine.table.rows
    known = replace(rows, worlds=rows.worlds.without(unknown))
    sampler = FeatureKernelSampler(
        FeatureTable(known), seed=1, success=machine.success, off_grid=0
    )
    found = sampler.predict(optuna.create_study())
    place = int(np.argmin(known.worlds.costs @ known.worlds.weights))
    world = rows.worlds.names.index(unknown[0])
    cost = rows.worlds.costs[place, world]
    return float(found.success[place]), cost <= machine.success


@pytest.mark.parametrize("whole", [False, True], ids=["worlds", "families"])
def test_the_first_chance_is_right_on_what_is_left_out(whole):
    told = []
    for seed in range(700, 720):
        machine = machine_of("worlds", is_like=True, seed=seed)
        names = machine.table.rows.worlds.names
        for world, name in enumerate(names):
            kin = names[world - world % 4 : world - world % 4 + 4]
            others = [other for other in kin if other != name] if whole else []
            told.append(first_said(machine, [name, *others]))
    said, happened = np.mean(told, axis=0)
    assert abs(said - happened) <= 0.07


def test_the_first_chance_counts_worlds_where_walkers_fall():
    """In half of the worlds each row walks, in the others it falls far from it."""
    falls = np.arange(12) % 2 == 0
    costs = np.where(falls, 3.0, 0.1) + 0.01 * (LINE[:, None] - 0.5) ** 2
    sampler = FeatureKernelSampler(table_of(costs), seed=1, success=0.2)
    found = sampler.predict(optuna.create_study())
    np.testing.assert_allclose(found.success, 0.5, atol=0.02)
