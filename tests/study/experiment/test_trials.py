"""Trials as a batch on the body and ground of their run, and their outcome in numbers and words."""

import numpy as np
import pytest

from study.experiment import walker
from study.experiment.objective import Objective
from study.sampler.draws import Purpose, stream
from taichi_nmm import terrain as terrains
from taichi_nmm.body import Bodies
from taichi_nmm.parameters import PUBLISHED_GAINS
from taichi_nmm.result import COMPLETED, DIVERGED, FELL, RESULT_DTYPE
from tests.study import fake_walker


def test_a_walker_that_stands_or_falls_has_not_walked():
    rows = np.zeros(4, RESULT_DTYPE)
    rows["end_reason"] = COMPLETED, COMPLETED, FELL, DIVERGED
    rows["mean_speed_mps"] = 0.3, 0.29, 1.3, 1.3
    assert walker.walked(rows).tolist() == [True, False, False, False]
    assert walker.fell(rows).tolist() == [False, False, True, True]


def test_a_walker_that_diverged_has_a_finite_cost():
    rows = np.zeros(2, RESULT_DTYPE)
    rows["end_reason"] = DIVERGED
    rows["duration_s"] = 1.0
    rows["distance_m"] = rows["mean_speed_mps"] = np.nan, np.inf
    clean = walker.finite(rows)
    assert np.isnan(rows["distance_m"][0])  # the caller's rows are as they were
    for cost in ("smooth", "walking"):
        values = Objective(cost).costs(clean)
        assert np.isfinite(values).all()
        assert values[0] == values[1]


def test_attributes_are_plain_values_and_make_a_sentence(toy):
    rows = fake_walker.simulate(PUBLISHED_GAINS, duration_s=8.0).rows
    found = toy.attributes_of(rows[0])
    assert {name: type(value) for name, value in found.items()} == {
        "duration_s": float,
        "distance_m": float,
        "mean_speed_mps": float,
        "end_reason": str,
        "walked": bool,
        "phi_printed": float,
        "phi_corrected": float,
        "survived_fraction": float,
    }
    assert found["distance_m"] == pytest.approx(
        found["duration_s"] * found["mean_speed_mps"]
    )
    known = {"duration_s": 8.0, "distance_m": 10.0, "mean_speed_mps": 1.25}
    for reason, words in (("completed", "walked"), ("fell", "fell after")):
        text = walker.outcome_text(known | {"end_reason": reason})
        assert text == f"{words} 8.0 s, 10.0 m at 1.25 m/s"


def test_a_trial_is_on_the_body_and_the_ground_of_its_run(toy):
    fake_walker.calls.clear()
    runs = [7, 0, 7]
    rows = toy.simulate(runs, np.tile(PUBLISHED_GAINS, (3, 1)))
    (call,) = fake_walker.calls
    for place, run in enumerate(runs):
        body = Bodies.disturbed([stream(5, Purpose.BODY, run)], 0.15)
        np.testing.assert_array_equal(call["bodies"].mass_kg[place], body.mass_kg[0])
        np.testing.assert_array_equal(call["bodies"].com_m[place], body.com_m[0])
        ground = terrains.rough(stream(5, Purpose.TERRAIN, run))
        chosen = call["terrains"][call["terrain_index"][place]]
        np.testing.assert_array_equal(chosen.height_m, ground.height_m)
    assert len(call["terrains"]) == 2
    assert (call["duration_s"], call["record"], call["low_level_gains"]) == (
        20.0,
        (),
        None,
    )
    assert rows[0] == rows[2] != rows[1]
