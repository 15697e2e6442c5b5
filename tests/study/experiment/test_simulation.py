"""Trials as a batch: the body and the ground of a run, the parameters' places."""

from pathlib import Path

import numpy as np

from study.draws import Purpose, stream
from study.experiment.experiment import Experiment
from study.experiment.trials import simulate_trials
from taichi_nmm import terrain as terrains
from taichi_nmm.body import Bodies
from taichi_nmm.parameters import LOW_LEVEL_GAINS, PUBLISHED_GAINS
from tests.study import fake_walker


def test_a_trial_is_on_the_body_and_the_ground_of_its_run(toy: Experiment) -> None:
    fake_walker.calls.clear()
    runs = [7, 0, 7]
    result = simulate_trials(toy, runs, np.tile(PUBLISHED_GAINS, (3, 1)))
    (call,) = fake_walker.calls
    for place, run in enumerate(runs):
        body = Bodies.disturbed([stream(5, Purpose.BODY, run)], 0.15)
        np.testing.assert_array_equal(call["bodies"].mass_kg[place], body.mass_kg[0])
        np.testing.assert_array_equal(call["bodies"].com_m[place], body.com_m[0])
        ground = terrains.rough(stream(5, Purpose.TERRAIN, run))
        chosen = call["terrains"][call["terrain_index"][place]]
        np.testing.assert_array_equal(chosen.height_m, ground.height_m)
    assert len(call["terrains"]) == 2
    assert call["duration_s"] == 20.0
    assert call["record"] == ()
    assert call["low_level_gains"] is None
    assert result.rows[0] == result.rows[2] != result.rows[1]


def test_recording_all_or_some_for_a_shorter_time(toy: Experiment) -> None:
    fake_walker.calls.clear()
    gains = np.tile(PUBLISHED_GAINS, (3, 1))
    assert len(simulate_trials(toy, [0, 1, 2], gains, True).trajectories) == 3
    made = simulate_trials(toy, [0, 1, 2], gains, [1], duration_s=4.0)
    assert len(made.trajectories) == 1
    assert [call["duration_s"] for call in fake_walker.calls] == [20.0, 4.0]


def test_searched_low_level_gains_replace_their_defaults(
    fake_simulator: None, tmp_path: Path
) -> None:
    experiment = fake_walker.experiment(tmp_path, 'searched = ["theta_ref"]')
    assert experiment.names[-1] == "theta_ref"
    fake_walker.calls.clear()
    simulate_trials(
        experiment, [0, 1], np.column_stack([np.tile(PUBLISHED_GAINS, (2, 1)), [0.1, 0.2]])
    )
    low_level = fake_walker.calls[0]["low_level_gains"]
    np.testing.assert_array_equal(low_level[:, 7], [0.1, 0.2])
    np.testing.assert_array_equal(low_level[0, :7], [p.default for p in LOW_LEVEL_GAINS[:7]])
