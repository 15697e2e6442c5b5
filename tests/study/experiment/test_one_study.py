"""A study that is asked and told: what its sampler sees, and that restored trials are its own."""

from dataclasses import replace

import numpy as np
import pytest

from study.experiment.arms import find_arm
from study.experiment.experiment import Experiment
from study.experiment.one_study import OneStudy, sampler_seed, shown
from study.experiment.trials import costs, simulate_trials
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE
from tests.study import fake_walker
from tests.study.conftest import refused


def walk(study: OneStudy, experiment: Experiment) -> tuple[list[float], float, dict[str, object]]:
    """One trial: its gains, its cost, and all that it noted."""
    gains = study.ask()
    rows = simulate_trials(experiment, [study.run], np.array([gains])).rows
    cost = float(costs(rows, experiment.cost)[0])
    return gains, cost, dict(study.tell(cost, rows).user_attrs)


def test_seeds_differ_by_experiment_arm_and_run(toy: Experiment) -> None:
    keys = [(seed, arm, run) for seed in (1, 2) for arm in ("dog", "random") for run in (0, 1)]
    assert len({sampler_seed(*key) for key in keys}) == len(keys)
    assert sampler_seed(1, "dog", 0) == 17269321431632601577
    for arm in ("dog", "random", "cmaes-cold", "tpe"):
        studies = [
            OneStudy(replace(toy, seed=n), find_arm(arm), run) for n in (1, 2) for run in (0, 1)
        ]
        assert len({tuple(study.ask()) for study in studies}) == 4


def test_what_is_asked_is_within_the_bounds_and_counted_when_it_is_told(toy: Experiment) -> None:
    study = OneStudy(toy, find_arm("dog"), 0)
    for number in range(4):
        assert study.trials == number == len(study.finished())
        gains, cost, noted = walk(study, toy)
        for value, (name, ends) in zip(gains, toy.space.items(), strict=True):
            assert ends.low <= value <= ends.high
            assert study.finished()[-1].params[name] == value
        assert study.finished()[-1].value == cost
        assert {"row", "score", "fell", "shown"} <= set(noted)


def test_samplers_see_that_a_trial_fell_and_what_it_showed(toy: Experiment) -> None:
    study = OneStudy(toy, find_arm("dog"), 0)
    rows = fake_walker.simulate(study.ask()).rows
    rows["phi_printed"] = 17.0
    assert set(study.noted()) == {"row", "score"}
    study.tell(1.0, rows, {"mood": "good"})
    (told,) = study.finished()
    assert told.user_attrs["fell"] == bool(rows["end_reason"][0] != COMPLETED)
    assert told.user_attrs["shown"] == [17.0]
    assert told.user_attrs["mood"] == "good"


def test_only_arms_whose_features_a_trial_has_are_shown_them() -> None:
    rows = np.zeros(1, RESULT_DTYPE)
    rows["end_reason"], rows["m5_mean_mps"] = FELL, 1.25
    assert shown(find_arm("random"), rows) == {"fell": True}
    assert shown(find_arm("best"), rows) == {"fell": True}  # of families, which it did not walk
    speed = replace(find_arm("dog"), features=("m5_mean_mps",))
    assert shown(speed, rows)["shown"] == [1.25]


@pytest.mark.parametrize(
    "arm", ["dog", "best", "cmaes-cold", "cmaes-source", "cmaes-warm", "random", "tpe"]
)
def test_a_restored_study_goes_on_as_it_would_have(toy: Experiment, arm: str) -> None:
    whole = OneStudy(toy, find_arm(arm), 1)
    trials = [walk(whole, toy) for _ in range(17)]
    restored = OneStudy(toy, find_arm(arm), 1)
    for trial in trials[:14]:
        restored.restore(*trial)
    assert restored.trials == 14
    assert [dict(t.user_attrs) for t in restored.finished()] == [noted for *_, noted in trials[:14]]
    assert [walk(restored, toy) for _ in range(3)] == trials[14:]


def test_trials_that_the_sampler_did_not_propose_are_refused(toy: Experiment) -> None:
    gains, cost, noted = walk(OneStudy(toy, find_arm("random"), 0), toy)
    with refused("cmaes-cold, run 2, trial 0: 'other gains'"):
        OneStudy(toy, find_arm("cmaes-cold"), 2).restore(gains, cost, noted)
