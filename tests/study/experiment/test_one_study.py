"""A study that is asked and told: its seed, and what its sampler sees."""

from dataclasses import replace

import numpy as np

from study.experiment.arms import find_arm
from study.experiment.one_study import OneStudy
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE
from tests.study import fake_walker


def test_seeds_differ_by_experiment_arm_and_run(toy):
    keys = [
        (seed, arm, run)
        for seed in (1, 2)
        for arm in ("dog", "random")
        for run in (0, 1)
    ]
    seeds = {replace(toy, seed=seed).sampler_seed(arm, run) for seed, arm, run in keys}
    assert len(seeds) == len(keys) and 17269321431632601577 in seeds
    for arm in ("dog", "random", "cmaes-cold", "tpe"):
        toys = [replace(toy, seed=seed) for seed in (1, 2)]
        studies = [OneStudy(own, find_arm(arm), run) for own in toys for run in (0, 1)]
        assert len({tuple(study.ask()) for study in studies}) == 4


def test_samplers_see_that_a_trial_fell_and_what_it_showed(toy):
    study = OneStudy(toy, find_arm("dog"), 0)
    gains = study.ask()
    assert study.trials == 0 and not study.finished()
    rows = fake_walker.simulate(gains).rows
    rows["phi_printed"] = 17.0
    assert set(study.noted()) == {"row", "score", "why"}
    study.tell([1.0], study.shown(rows[0], np.ones(1)) | {"mood": "good"})
    (told,) = study.finished()
    assert study.trials == told.value == 1 and list(told.params.values()) == gains
    assert told.user_attrs["fell"] == bool(rows["end_reason"][0] != COMPLETED)
    assert told.user_attrs["shown"] == [17.0]
    assert told.user_attrs["mood"] == "good"


def test_only_arms_whose_features_a_trial_has_are_shown_them(toy):
    rows = np.zeros(1, RESULT_DTYPE)
    rows["end_reason"], rows["m5_mean_mps"] = FELL, 1.25

    def shown(arm):
        return OneStudy(toy, arm, 0).shown(rows[0], np.ones(1))

    for arm in ("random", "worlds"):  # it did not walk in the worlds
        assert shown(find_arm(arm)) == {"fell": True}
    speed = replace(find_arm("dog"), feature="m5_mean_mps")
    assert shown(speed)["shown"] == [1.25]
