"""A fall in words: walks made to fall each way."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import taichi_nmm
from study.experiment.gains import gains_of_source, named_gains
from study.pictures.fall import SIDES, fall_text
from study.pictures.stick_figure import leg, leg_angles
from taichi_nmm import terrain
from taichi_nmm.result import COMPLETED, FELL, RESULT_DTYPE
from taichi_nmm.terrain import GRID_X_M, Terrain
from taichi_nmm.world import WorldRanges

LEVEL = terrain.flat()


def row(end_reason=FELL):
    rows = np.zeros(1, RESULT_DTYPE)
    rows["end_reason"] = end_reason
    return rows[0]


@cache
def reference():
    gains = gains_of_source("reference").gains
    walk = taichi_nmm.simulate(gains, duration_s=4.0, record=[0], record_rate_hz=100.0)
    return walk.trajectories[0]


def pushed(way):
    """A walk whose trunk is pushed over in the last half second; forwards is positive."""
    walk = reference()
    q = walk.q.copy()
    q[-50:, 2] += way * np.linspace(0.0, np.deg2rad(61.0), 50)
    return replace(walk, q=q)


def test_a_fall_after_a_push_says_so():
    walk = pushed(1.0)
    push_n = np.zeros((len(walk.time_s), 1))
    push_n[300:310] = -250.0
    text = fall_text(row(), replace(walk, push_n=push_n), LEVEL)
    before_s = walk.time_s[-1] - walk.time_s[300]
    assert f"it was pushed backwards by 250 N, {before_s:.2f} s before" in text
    assert "pushed" not in fall_text(row(), walk, LEVEL)


def last_strike(walk):
    return walk.events[walk.events["kind"] == 0][-1]


@pytest.mark.parametrize(("way", "word"), [(1.0, "forwards"), (-1.0, "backwards")])
def test_a_trunk_that_is_pushed_over(way, word):
    walk = pushed(way)
    text = fall_text(row(), walk, LEVEL)
    degrees = abs(np.rad2deg(walk.q[-1, 2]))
    assert text.startswith(f": {word}; the trunk leaned {degrees:.0f} deg {word}; ")
    strike = last_strike(walk)
    side = int(strike["side"])
    before_s = walk.time_s[-1] - strike["time_s"]
    told = re.search(
        rf"the {SIDES[side]} foot touched last, {before_s:.2f} s before at (\S+) m",
        text,
    )
    joints = leg(walk.q[np.searchsorted(walk.time_s, strike["time_s"])], side)
    assert joints.heel[0] - 0.01 <= float(told[1]) <= joints.ball[0] + 0.01
    assert not re.search("caught|slipped|gave way", text)
    assert fall_text(row(COMPLETED), walk, LEVEL) == ""


def test_a_hip_that_sinks_behind_or_ahead_of_the_foot():
    for shift_m, word in ((-0.6, "backwards"), (0.6, "forwards")):
        walk = pushed(0.0)
        walk = replace(walk, events=walk.events[walk.events["time_s"] < 3.0])
        side = int(last_strike(walk)["side"])
        q = walk.q.copy()
        q[-1, :3] = leg(q[-1], side).ankle[0] + shift_m, 0.59, 0.0
        thigh = np.arcsin(np.clip(shift_m / 2.0, -1.0, 1.0))
        leg_angles(q[-1], side)[:] = thigh, 0.9 * shift_m, 0.0
        text = fall_text(row(), replace(walk, q=q), LEVEL)
        assert text.startswith(f": {word}; the hip sank to 0.6 m over the ground"), text


def fell(ground=LEVEL, friction=0.8, **gains):
    """What is said of the gait `reference` with other gains, on a ground; it falls."""
    named = named_gains("other", gains_of_source("reference").as_document() | gains)
    result = taichi_nmm.simulate(
        named.gains,
        duration_s=8.0,
        terrains=ground,
        record=[0],
        record_rate_hz=100.0,
        worlds=WorldRanges(friction=(friction, friction)).draw([1]),
    )
    assert result.end_reason[0] == "fell"
    return fall_text(result.rows[0], result.trajectories[0], ground)


@pytest.mark.parametrize("riser_m", [5.0, 5.15, 5.3, 5.45, 5.6])
def test_a_toe_that_meets_a_step(riser_m):
    """15 cm up within 10 cm: the foot that came first to it, and where."""
    step = Terrain("step", 0.15 * np.clip((GRID_X_M - riser_m) / 0.1, 0.0, 1.0))
    text = fell(step)
    told = re.search(
        r"toe caught the edge of a step up \(15 cm\) at (\d\.\d\d) m, (\d\.\d\d) s",
        text,
    )
    assert told, text
    assert riser_m - 0.06 <= float(told[1]) <= riser_m + 0.16 and float(told[2]) < 1.5
    assert text.startswith(": forwards; ")


def test_ice_and_weak_muscles():
    text = fell(friction=0.1)
    slipped = re.search(
        r"the (left|right) foot slipped (\d+) cm forwards, from \d\.\d\d s", text
    )
    assert slipped and int(slipped[2]) >= 10 and text.startswith(": backwards; "), text
    for weak in ({"K_SOL": 0.0}, {"K_VAS": 0.0}):
        text = fell(**weak)
        bent = re.search(r"the (left|right) knee gave way: (\d+) deg under load", text)
        assert bent and 60 <= int(bent[2]) < 150, text
        assert "slipped" not in text and "caught" not in text
