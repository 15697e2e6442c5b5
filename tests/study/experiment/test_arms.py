"""Every arm proposes within the bounds, always the same, and goes on after a restart."""

import json
from types import SimpleNamespace

import numpy as np
import optuna
import pytest

from study import FeatureTable
from study.experiment import samplers
from study.experiment.arms import ARMS, NOTHING, find_arm, saw
from study.experiment.one_study import new_sampler
from study.experiment.samplers import Task, score_order
from taichi_nmm.parameters import GAIN_NAMES, lower_bounds, upper_bounds
from tests.cases import refused
from tests.study import fake_walker

pytestmark = pytest.mark.slow


def test_all_arms_stay_in_bounds_and_go_on_after_a_restart(comparisons):
    """Beyond a generation of 12."""
    for out, steps in (("parts", (2, 14, 15)), ("whole", (15,))):
        for trials in steps:
            comparisons.run(out, arms=fake_walker.ABLE, runs=2, trials=trials)
    assert comparisons.content("parts") == comparisons.content("whole")
    frame = comparisons.table("whole").to_pandas()
    assert len(frame) == 2 * 15 * len(fake_walker.ABLE)
    gains = frame[list(GAIN_NAMES)].to_numpy()
    assert ((gains >= lower_bounds()) & (gains <= upper_bounds())).all()
    for arm in fake_walker.ABLE:
        one, other = (
            gains[(frame.arm == arm) & (frame.run == run)] for run in range(2)
        )
        assert len(np.unique(one, axis=0)) == len(np.unique(other, axis=0)) == 15
        assert arm == "ranking" or not np.array_equal(one, other)


def table_of(experiment, arm):
    found = find_arm(arm)
    return Task(experiment, 0, 0, found.store, found.feature).table


def test_the_ranking_goes_down_the_scores_then_rows(comparisons):
    comparisons.run("out", arms=("ranking",), runs=2, trials=30)
    frame = comparisons.table("out").to_pandas()
    rows = frame.row[frame.run == 0].to_numpy()
    np.testing.assert_array_equal(rows, frame.row[frame.run == 1])
    ranked = score_order(table_of(comparisons.experiment, "ranking"))
    np.testing.assert_array_equal(rows, ranked[:30])
    for arm in ("ranking", "cmaes-warm"):  # the second's scores have ties
        table = table_of(comparisons.experiment, arm).rows
        offered = np.flatnonzero(table.offered)
        expected = sorted(offered, key=lambda row: (-table.features[row, 0], row))
        np.testing.assert_array_equal(
            score_order(table_of(comparisons.experiment, arm)), expected
        )


def test_the_hill_climber_steps_from_the_best_trial_and_first_from_the_best_row(
    comparisons,
):
    """As long as no trial is finished: where workers share a study, or trials fail."""
    experiment = comparisons.experiment
    sampler = new_sampler(experiment, find_arm("hill-ranking"), 0)
    study = optuna.create_study(sampler=sampler)
    asked = [study.ask(experiment.space) for _ in range(4)]
    for trial, cost in zip(asked, (3.0, 1.0, 2.0), strict=False):
        study.tell(trial, cost)
    later = study.ask(experiment.space)
    for trial, centre in ((asked[3], asked[0]), (later, asked[1])):
        ends = [list(each.params.values()) for each in (trial, centre)]
        step = np.subtract(*ends) / (upper_bounds() - lower_bounds())
        assert 0.0 < np.std(step) < 2.0 * samplers.HILL_SIGMA


def test_rows_of_the_residual_process_are_those_of_its_store():
    """Also where no world ran some rows, and where parameters are choices."""
    columns = {"x": range(9), "grip": [*"ababababa"]}
    with pytest.warns(UserWarning, match="7 rows .* are not proposed"):
        table = FeatureTable.from_arrays(columns, [np.nan] * 7 + [1.0, 2.0])
    task = SimpleNamespace(table=table, seed=1)
    study = optuna.create_study(sampler=find_arm("residual").new_sampler(task))
    trial = study.ask(table.rows.space.as_dict())
    assert trial.params == table.rows.as_parameters(trial.user_attrs["row"])


def test_the_start_of_warm_cmaes(comparisons, monkeypatch):
    monkeypatch.setattr(samplers, "START_ROWS", 5)
    comparisons.run("out", arms=("cmaes-warm",), runs=6, trials=2)
    frame = comparisons.table("out").to_pandas()
    starts = frame.row[frame.trial == 0].tolist()
    assert set(starts) <= set(
        score_order(table_of(comparisons.experiment, "cmaes-warm"))[:5]
    )
    assert len(set(starts)) > 1
    assert (frame.row[frame.trial == 1] == -1).all()


def test_warm_cmaes_moves_towards_better_costs(comparisons):
    comparisons.run("out", arms=("cmaes-warm",), runs=3, trials=100)
    frame = comparisons.table("out").to_pandas()
    early = frame.cost[frame.trial.between(1, 12)].mean()
    assert frame.cost[frame.trial >= 85].mean() < early


def test_every_arm_is_found_by_its_name_and_says_what_it_is(toy):
    for name, arm in ARMS.items():
        assert find_arm(name) is arm and arm.name == name
        assert arm.label and arm.summary
        assert json.loads(json.dumps(arm.definition)) == arm.definition
        assert bool(arm.store) == bool(arm.feature)
        for stores in (toy.stores, {}):
            assert (saw(arm, stores) == NOTHING) == (not arm.store)
    assert len({arm.label for arm in ARMS.values()}) == len(ARMS)
    with refused("arm: 'cat' .* one of random, cmaes-cold, .*worlds"):
        find_arm("cat")


def test_arms_say_what_their_stores_saw(toy):
    level, rough = "undisturbed body: level ground", "rough +-0.08 m every 1 m"
    assert saw(ARMS["dog"], toy.stores) == level
    disturbed = f"bodies disturbed by 15 %: {rough}"  # of all families, named once
    assert saw(ARMS["worlds-stairs"], toy.stores) == f"{level}; {disturbed}"
    assert (
        saw(ARMS["worlds"], {}) == "base setting of the store worlds, and its families"
    )
