"""What if: controls and lines, what they change in body and world, and what is refused."""

import gzip
import html
import json
import re
from pathlib import Path

import numpy as np
import pytest

from storage.inputs.errors import InputError
from study.experiment.gains import gains_of_source
from study.explore import walk as walking
from study.explore.walk import chosen_setting
from study.explore.what_if import EVERY, Tables, WhatIf, read_file, with_value
from taichi_nmm.body import SEGMENT_NAMES
from taichi_nmm.result import MUSCLES
from taichi_nmm.world import MUSCLE_NAMES
from tests.cases import cases
from tests.study.explore.test_walk import LEVEL
from tests.tools.running import run_tool


class Page:
    """The controls, and the setting that they make."""

    def __init__(self):
        self.grounds: dict[str, Tables] = {}
        self.what_if = WhatIf(self.chosen, self.grounds.__setitem__)
        self.setting = chosen_setting(**LEVEL)

    def chosen(self):
        self.setting = chosen_setting(**LEVEL, changes=self.what_if.tables)

    def control(self, name):
        return self.what_if.layout.select_one({"name": name})

    def said(self):
        return str(self.control("what-if-message").text)


@pytest.fixture
def page():
    return Page()


def strengths(setting):
    return dict(zip(MUSCLE_NAMES, setting.world(0).strength[0].tolist(), strict=True))


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("muscle", MUSCLES)
def test_a_slider_weakens_its_own_muscle(page, muscle, side):
    page.control(f"world.muscles.{muscle}_{side}").value = 0.5
    expected = dict.fromkeys(MUSCLE_NAMES, 1.0) | {f"{muscle}_{side}": 0.5}
    assert strengths(page.setting) == expected
    lines = f"[world.muscles]\n{muscle}_{side} = 0.5"
    assert page.control("lines").value == lines
    page.control(f"world.muscles.{muscle}_{side}").value = 1.0
    assert page.control("lines").value == "" and page.what_if.tables == {}
    assert set(strengths(page.setting).values()) == {1.0}


@pytest.mark.parametrize("segment", EVERY["body.mass"])
def test_a_segment_becomes_heavier_and_its_inertia_is_its_own(page, segment):
    """An inertia that is not named goes with the mass."""
    usual = chosen_setting(**LEVEL).body(0)
    name = segment.replace("_left", "_l").replace("_right", "_r")
    of = np.array(SEGMENT_NAMES) == name
    assert of.sum() == 1
    page.control(f"body.mass.{segment}").value = 1.5
    body = page.setting.body(0)
    np.testing.assert_array_equal(body.mass_kg[0] / usual.mass_kg[0], 1 + 0.5 * of)
    factors = body.inertia_kgm2[0] / usual.inertia_kgm2[0]
    np.testing.assert_allclose(factors, 1 + 0.5 * of)
    page.control(f"body.inertia.{segment}").value = 0.5
    factors = page.setting.body(0).inertia_kgm2[0] / usual.inertia_kgm2[0]
    np.testing.assert_allclose(factors, 1 - 0.5 * of)


def test_world_foot_and_device(page):
    page.control("world.friction").value = 0.4
    page.control("world.catch_ns").value = 2.0
    page.control("world.prosthesis.stiffness_nmprad").value = 400.0
    assert page.setting.world(0).prosthesis.max() == 0.0  # on no side yet
    page.control("world.prosthesis.side").value = "right"
    page.control("world.exoskeleton.motion").value = "hip_extension"
    page.control("world.exoskeleton.side").value = "left"
    world = page.setting.world(0)
    assert world.friction[0] == 0.4 and world.catch_ns[0] == 2.0
    assert world.prosthesis[0].tolist() == [[0.0, 0.0, 0.0], [400.0, 1.0, 0.0]]
    assert world.exoskeleton[0, :, 0].tolist() == [1.0, 0.0]
    assert strengths(page.setting)["SOL_right"] == 0.0
    page.control("world.prosthesis.side").value = "none"
    assert page.setting.world(0).prosthesis.max() == 0.0


def test_a_push_and_a_slip_are_tables_once_they_are_something(page):
    page.control("world.push.time_s").value = 2.0
    page.control("world.slip.friction").value = 0.2
    assert page.what_if.tables == {}
    page.control("world.push.force_n").value = -100.0
    page.control("world.slip.duration_s").value = 0.5
    world = page.setting.world(0)
    assert world.push.tolist() == [[2.0, 0.1, -100.0]]
    assert world.slip.tolist() == [[5.0, 0.5, 0.2]]
    assert "[world.push]\n" in page.control("lines").value
    page.control("world.push.time_s").value = 15.0  # the walk has 10 s
    assert "world.push.time_s" in page.said() and "below 10" in page.said()
    assert page.setting.world(0).push[0, 0] == 2.0
    page.control("world.push.force_n").value = 0.0
    page.control("world.slip.duration_s").value = 0.0
    assert page.what_if.tables == {}


def test_a_foot_of_the_study_is_shown_and_changed(page):
    foot = {"side": "right", "stiffness_nmprad": 300.0, "damping_nmsprad": 1.0}
    world = {"friction": [0.4, 0.4], "prosthesis": foot}
    page.what_if.lie_on({"world": world})
    side, stiffness, friction = (
        page.control(f"world.{name}")
        for name in ("prosthesis.side", "prosthesis.stiffness_nmprad", "friction")
    )
    shown = side.value, stiffness.value, friction.value
    assert shown == ("right", 300.0, 0.4) and page.what_if.tables == {}
    stiffness.value, friction.value = 400.0, 0.9  # the second as without a study
    changed = foot | {"stiffness_nmprad": 400.0, "rest_rad": 0.0}
    tables = {"world": {"prosthesis": changed, "friction": [0.9, 0.9]}}
    assert page.what_if.tables == tables


def test_lines_move_the_controls_and_last(page):
    tendon = "[world.muscles]\nslack_length = { SOL = 1.05 }\nSOL_left = 0.5"
    text = f"world.friction = [0.5, 0.6]\n{tendon}"
    page.control("lines").value = text
    assert page.said() == ""
    assert page.control("world.muscles.SOL_left").value == 0.5
    assert page.control("world.friction").value == 0.5
    page.control("world.muscles.TA_left").value = 0.25
    muscles = {"slack_length": {"SOL": 1.05}, "SOL_left": 0.5, "TA_left": 0.25}
    assert page.what_if.tables["world"] == {"friction": [0.5, 0.6], "muscles": muscles}
    assert set(page.setting.world(0).slack_length[0]) == {1.0, 1.05}


@cases("refused-lines.toml", "text", "said")
def test_what_is_refused_leaves_the_last_good_lines(page, text, said):
    page.control("world.muscles.SOL_left").value = 0.5
    page.control("lines").value = text
    assert re.match(said, html.unescape(page.said()))
    assert page.control("lines").value == text  # to be mended
    assert page.control("world.muscles.SOL_left").value == 0.5
    assert strengths(page.setting)["SOL_left"] == 0.5
    page.control("world.muscles.SOL_left").value = 0.75
    assert page.said() == "" and strengths(page.setting)["SOL_left"] == 0.75


def test_values_at_paths():
    one = with_value({}, ["a", "b"], 1)
    assert one == {"a": {"b": 1}}
    assert with_value(one, ["a", "c"], 2) == {"a": {"b": 1, "c": 2}}
    assert with_value(one, ["a", "b"], None) == {} and one == {"a": {"b": 1}}


def test_a_ground_of_ones_own():
    text = "x_m,height_m\n0,0\n3,0\n6,0.3\n"
    table = read_file("../hill.csv", text.encode())
    assert table["file"] == "hill.csv"
    setting = chosen_setting(**LEVEL | {"ground": "mine"}, files={"mine": table})
    assert setting.terrain(0).height([3.0, 4.5, 9.0]).tolist() == [0.0, 0.15, 0.3]
    packed = read_file("hill.csv.gz", gzip.compress(text.encode()))
    assert packed["heights"] == table["heights"] == text
    with pytest.raises(InputError, match=r"ground: 'bad\.csv'.*x_m,height_m"):
        read_file("bad.csv", b"x_m,height_m\n0,zero\n")


@pytest.mark.slow
def test_the_files_of_a_what_if_walk_the_same_to_the_bit(
    page,
    tmp_path,
    monkeypatch,
    capsys,
):
    page.control("world.muscles.SOL_left").value = 0.85
    page.control("body.mass.hat").value = 1.1
    page.control("body.inertia.shank_left").value = 0.9
    page.control("world.catch_ns").value = 0.5
    page.control("world.exoskeleton.motion").value = "hip_flexion"
    table = read_file("hill.csv", b"x_m,height_m\n0,0\n3,0\n6,0.05\n")
    setting = chosen_setting(
        **LEVEL | {"ground": "hill.csv"},
        files={"hill.csv": table},
        changes=page.what_if.tables,
    )
    found = walking.walk(gains_of_source("reference"), setting)
    monkeypatch.chdir(tmp_path)
    for wanted in walking.NAMES:
        Path(wanted).write_bytes(walking.file_of_walk(found, wanted)[1])
    words = f"{walking.COMMAND} --movie-seconds 0 --json --out pictures".split()
    assert run_tool(monkeypatch, *words[1:]) == 0
    told = json.loads(capsys.readouterr().out)
    for field in ("duration_s", "distance_m", "phi_printed"):
        assert told[field] == found.row[field], field
    level = walking.walk(gains_of_source("reference"), chosen_setting(**LEVEL))
    assert told["distance_m"] != level.row["distance_m"]  # it is another walk
