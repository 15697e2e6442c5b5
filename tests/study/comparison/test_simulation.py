"""Trials as a batch: the body and the ground of a run, the parameters' places, what walked."""

import numpy as np

from study.comparison.outcome import costs, finite, walked
from study.comparison.simulation import simulate_trials
from study.draws import Purpose, stream
from taichi_nmm import terrain as terrains
from taichi_nmm.body import Bodies
from taichi_nmm.parameters import K_T, LOW_LEVEL_GAINS
from taichi_nmm.result import COMPLETED, DIVERGED, FELL, RESULT_DTYPE
from tests.study.comparison import fake
from tests.study.comparison.conftest import Comparisons


def test_a_trial_is_on_the_body_and_the_ground_of_its_run(comparisons: Comparisons) -> None:
    fake.calls.clear()
    runs = [7, 0, 7]
    result = simulate_trials(comparisons.experiment, runs, np.tile(K_T, (3, 1)))
    (call,) = fake.calls
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


def test_recording_all_or_some_for_a_shorter_time(comparisons: Comparisons) -> None:
    fake.calls.clear()
    gains = np.tile(K_T, (3, 1))
    assert len(simulate_trials(comparisons.experiment, [0, 1, 2], gains, True).trajectories) == 3
    made = simulate_trials(comparisons.experiment, [0, 1, 2], gains, [1], duration_s=4.0)
    assert len(made.trajectories) == 1
    assert [call["duration_s"] for call in fake.calls] == [20.0, 4.0]


def test_searched_low_level_gains_replace_their_defaults(comparisons: Comparisons) -> None:
    folder = comparisons.folder / "torso"
    folder.mkdir()
    experiment = fake.experiment(folder, 'searched = ["theta_ref"]')
    assert experiment.names[-1] == "theta_ref"
    fake.calls.clear()
    simulate_trials(experiment, [0, 1], np.column_stack([np.tile(K_T, (2, 1)), [0.1, 0.2]]))
    low_level = fake.calls[0]["low_level_gains"]
    np.testing.assert_array_equal(low_level[:, 7], [0.1, 0.2])
    np.testing.assert_array_equal(low_level[0, :7], [p.default for p in LOW_LEVEL_GAINS[:7]])


def test_who_stands_or_falls_has_not_walked() -> None:
    rows = np.zeros(4, RESULT_DTYPE)
    rows["end_reason"] = COMPLETED, COMPLETED, FELL, DIVERGED
    rows["mean_speed_mps"] = 0.3, 0.29, 1.3, 1.3
    assert walked(rows).tolist() == [True, False, False, False]


def test_a_walker_that_diverged_has_a_finite_cost() -> None:
    rows = np.zeros(2, RESULT_DTYPE)
    rows["end_reason"] = DIVERGED
    rows["duration_s"] = 1.0
    rows["distance_m"] = rows["mean_speed_mps"] = np.nan, np.inf
    clean = finite(rows)
    assert np.isnan(rows["distance_m"][0])  # the caller's rows are as they were
    for cost in ("smooth", "walking"):
        values = costs(clean, cost)
        assert np.isfinite(values).all()
        assert values[0] == values[1]
