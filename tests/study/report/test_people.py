"""A gait beside people: two standard deviations, and a word beyond them."""

import math

import numpy as np
import pytest

from study.report.people import QUANTITIES, STEP_RATE, not_human
from taichi_nmm.result import COLUMNS, RESULT_DTYPE, known_numbers


def of_people(**changes):
    """A walk with people's means, but for some numbers."""
    row = np.zeros(1, RESULT_DTYPE)[0]
    for name, value in {
        "step_count": 100,
        "step_duration_mean_s": 60.0 / 117.0,
        "step_length_mean_m": 0.7,
        **{name: mean for name, (mean, _) in COLUMNS["human"].items()},
        **changes,
    }.items():
        row[name] = value
    return known_numbers(row)


def test_who_walks_as_people_do_has_no_word():
    assert not_human(of_people()) == []


@pytest.mark.parametrize("name", COLUMNS["human"])
@pytest.mark.parametrize("side", [-1, 1])
def test_beyond_two_standard_deviations_is_a_word(name, side):
    mean, sd = COLUMNS["human"][name]
    assert not_human(of_people(**{name: mean + side * 1.99 * sd})) == []
    (word,) = not_human(of_people(**{name: mean + side * 2.01 * sd}))
    (quantity,) = (each for each in QUANTITIES if each.column == name)
    expected = quantity.low if side < 0 else quantity.high
    assert expected and word.startswith(expected) and "people" in word


def test_the_gait_that_no_person_has():
    """66 steps a minute."""
    (word,) = not_human(of_people(step_duration_mean_s=60.0 / 66.0))
    assert word == "takes few steps a minute (66; people 98 to 136)"


def test_a_walk_without_a_step_is_not_judged():
    nothing = known_numbers(np.zeros(1, RESULT_DTYPE)[0])
    assert not_human(nothing) == []
    # a step that begins a fall
    assert not_human(of_people(step_duration_mean_s=0.2, step_count=0)) == []
    for each in QUANTITIES:
        if each.people is not None:
            assert each.value(nothing) is None and each.text(None) == "-"


def test_numbers_are_shown_as_readers_have_them():
    shown = {each.column: each for each in QUANTITIES}
    assert shown["knee_peak_swing_rad"].text(math.radians(60.0)) == "60"
    assert shown["double_support_fraction"].text(0.24) == "24"
    assert shown["grf_vertical_peak_bw"].range_text == "0.94 to 1.30"
    assert shown["step_length_mean_m"].range_text == "-"
    assert shown[STEP_RATE].value(of_people(step_duration_mean_s=0.5)) == 120.0
