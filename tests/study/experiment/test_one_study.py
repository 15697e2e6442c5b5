"""A study that is asked and told: its seed, and what its sampler sees."""

from dataclasses import replace

import numpy as np

from study.experiment.arms import find_arm
from study.experiment.experiment import Experiment
from study.experiment.one_study import OneStudy, sampler_seed, shown
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE
from tests.study import fake_walker


def test_seeds_differ_by_experiment_arm_and_run(toy: Experiment) -> None:
    keys = [
        (seed, arm, run)
        for seed in (1, 2)
        for arm in ("dog", "random")
        for run in (0, 1)
    ]
    assert len({sampler_seed(*key) for key in keys}) == len(keys)
    assert sampler_seed(1, "dog", 0) == 17269321431632601577
    for arm in ("dog", "random", "cmaes-cold", "tpe"):
        toys = [replace(toy, seed=seed) for seed in (1, 2)]
        studies = [OneStudy(own, find_arm(arm), run) for own in toys for run in (0, 1)]
        assert len({tuple(study.ask()) for study in studies}) == 4


def test_samplers_see_that_a_trial_fell_and_what_it_showed(toy: Experiment) -> None:
    study = OneStudy(toy, find_arm("dog"), 0)
    gains = study.ask()
    assert study.trials == 0 and not study.finished()
    rows = fake_walker.simulate(gains).rows
    rows["phi_printed"] = 17.0
    assert set(study.noted()) == {"row", "score"}
    study.tell([1.0], shown(study.arm, rows) | {"mood": "good"})
    (told,) = study.finished()
    assert study.trials == told.value == 1 and list(told.params.values()) == gains
    assert told.user_attrs["fell"] == bool(rows["end_reason"][0] != COMPLETED)
    assert told.user_attrs["shown"] == [17.0]
    assert told.user_attrs["mood"] == "good"


def test_only_arms_whose_features_a_trial_has_are_shown_them() -> None:
    rows = np.zeros(1, RESULT_DTYPE)
    rows["end_reason"], rows["m5_mean_mps"] = FELL, 1.25
    assert shown(find_arm("random"), rows) == {"fell": True}
    assert shown(find_arm("worlds"), rows) == {
        "fell": True
    }  # of worlds, in which it did not walk
    speed = replace(find_arm("dog"), feature="m5_mean_mps")
    assert shown(speed, rows)["shown"] == [1.25]
