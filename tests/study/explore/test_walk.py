"""A gait that walks for the page: its setting, its frames, why it fell, and files to take away."""

import html
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from storage.inputs.config import read_toml, to_toml
from study.commands.walk import summary
from study.experiment.gains import gains_of_source, named_gains
from study.experiment.walker import as_written, read_experiment
from study.explore import walk as walking
from study.explore.strides import Cycle
from study.explore.walk import chosen_setting, walk
from study.explore.walk_view import score_text
from study.options import config_path
from study.pictures.gait_cycle import PANELS
from taichi_nmm import GAIN_NAMES, InputError
from taichi_nmm.result import FELL, OF_MUSCLES, Result
from taichi_nmm.settings import ENGINES
from taichi_nmm.terrain import flat
from tests.study import synthetic_gait
from tests.tools.running import run_tool


def same_robot(one, other):
    """Body, world and ground have the same bits."""
    np.testing.assert_array_equal(one.body(0).mass_kg, other.body(0).mass_kg)
    np.testing.assert_array_equal(one.world(0).strength, other.world(0).strength)
    np.testing.assert_array_equal(one.terrain(0).height_m, other.terrain(0).height_m)
    simulations = [each.conditions.as_written()["simulation"] for each in (one, other)]
    assert simulations[0] == simulations[1]


def reread(experiment, folder):
    path = folder / "walk.toml"
    path.write_text(to_toml(as_written(experiment)))
    return read_experiment(path)


LEVEL: dict[str, Any] = {
    "ground": "flat",
    "disturbance": "nominal",
    "seed": 1,
    "world": "nominal",
    "engine": "taichi",
    "duration_s": 10.0,
}
"""Arguments of `chosen_setting`."""


@pytest.mark.parametrize("ground", walking.GROUNDS)
def test_a_chosen_setting_is_a_configuration(ground, tmp_path):
    robots = zip(walking.WORLDS, [*walking.DISTURBANCES] * 2, strict=False)
    for seed, (world, disturbance) in enumerate(robots):
        setting = chosen_setting(
            ground=ground,
            disturbance=disturbance,
            seed=seed,
            world=world,
            engine=ENGINES[seed % 2],
            duration_s=12.5,
        )
        assert setting.conditions.settings.engine == ENGINES[seed % 2]
        same_robot(setting, reread(setting, tmp_path))


@pytest.mark.parametrize(
    "name", ["rough8-smooth", "mujoco-rough8-soft", "outside-weak", "ramp-up"]
)
def test_an_experiment_is_a_configuration(name, tmp_path):
    experiment = read_experiment(config_path(name))
    again = reread(experiment, tmp_path)
    same_robot(experiment, again)
    assert as_written(again) == as_written(experiment)


def test_a_seed_that_no_configuration_takes_and_tables_within_tables(
    tmp_path,
):
    with pytest.raises(InputError, match="seed: -1"):
        chosen_setting(**LEVEL | {"seed": -1})
    tables = {"a": {"b": {"c": 1.5}, "d": [1, 2]}, "e": "x\ty", "f": True}
    (tmp_path / "t.toml").write_text(to_toml(tables))
    assert read_toml(tmp_path / "t.toml").unread == tables


@pytest.fixture(scope="module")
def fell():
    """The published gains on stairs, on which it falls."""
    setting = chosen_setting(
        ground="stairs up, 10 cm a step",
        disturbance="within 15 %",
        seed=3,
        world="nominal",
        engine="taichi",
        duration_s=20.0,
    )
    return walk(gains_of_source("published"), setting)


@pytest.mark.slow
def test_a_fall_has_frames_and_a_reason(fell):
    frames, trajectory = fell.frames, fell.trajectory
    count = len(frames["time_s"])
    assert count == pytest.approx(walking.RATE_HZ * trajectory.time_s[-1], abs=1)
    assert frames["muscles"].shape[:2] == (count, 14)
    assert frames["forces"].shape == (count, 3, 2, 2)
    hip = np.interp(frames["time_s"], trajectory.time_s, trajectory.q[:, 0])
    for leg in ("near", "far"):
        np.testing.assert_allclose(frames[leg][:, 0, 0], hip, atol=1e-4)
    assert np.ptp(frames["ground"][:, 1]) > 0.1  # steps
    assert fell.ended.startswith("fell after ")
    pose = fell.trajectory.q[-1]
    height_m = pose[1] - fell.experiment.terrain(0).height(pose[0])
    leaned = abs(np.rad2deg(pose[2])) > 57.0  # a sample before the bound of 60
    assert ("the trunk leaned" in fell.ended) == leaned
    assert ("the hip sank to" in fell.ended) == (not leaned)
    assert leaned or height_m < 0.62


def test_a_walk_that_never_was_finite_still_has_frames_or_says_so():
    trajectory = synthetic_gait.walk(2.0, 100.0)
    q = trajectory.q.copy()
    q[50:] = np.nan
    frames = walking.frames_of(replace(trajectory, q=q), flat())
    assert np.isfinite(frames["near"]).all()
    assert frames["time_s"][-1] <= trajectory.time_s[50]


@pytest.mark.slow
def test_what_is_taken_walks_the_same_to_the_bit(
    fell,
    tmp_path,
    monkeypatch,
    capsys,
):
    monkeypatch.chdir(tmp_path)
    for wanted in walking.NAMES:
        Path(wanted).write_bytes(walking.file_of_walk(fell, wanted)[1])
    words = f"{walking.COMMAND} --movie-seconds 0 --json --out pictures".split()
    assert words[0] == "taichi-nmm" and run_tool(monkeypatch, *words[1:]) == 0
    found = json.loads(capsys.readouterr().out)
    for field in ("duration_s", "distance_m", "phi_printed", OF_MUSCLES):
        assert found[field] == fell.row[field], field
    values = fell.gains.gains.tolist()
    assert found["gains"] == dict(zip(GAIN_NAMES, values, strict=True))
    assert Path("walk.sto").read_bytes().startswith(b"gains\n")


@pytest.mark.slow
def test_recordings_and_pictures_are_those_of_the_command(fell, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pytest.importorskip("ezc3d", reason="no ezc3d: pip install 'taichi-nmm[c3d]'")
    Path("walk.toml").write_bytes(walking.file_of_walk(fell, "walk.toml")[1])
    words = ["--gains", "published", "--config", "walk.toml", "--movie-seconds", "0"]
    for name in walking.RECORDINGS:
        words += ["--trajectory", name]
    assert run_tool(monkeypatch, "walk", *words, "--out", ".") == 0
    for wanted in (*walking.RECORDINGS, *walking.PICTURES):
        name, content = walking.file_of_walk(fell, wanted)
        assert name == wanted and Path(wanted).read_bytes() == content, wanted


def test_axes_of_the_stride_show_all():
    """The impact of the heel goes beyond what people's tables need."""
    cycle = Cycle()
    cycle.show(walk(gains_of_source("published"), chosen_setting(**LEVEL)), None)
    for name, plot in cycle.plots.items():
        left, right = (plot.sources[look].data for look in ("signal", "right"))
        drawn = [left["low"], left["high"], right["y"]]
        ends = plot.figure.y_range
        assert ends.start <= np.min(drawn) and np.max(drawn) <= ends.end, name
        if name == "vertical_bw":
            assert ends.end == np.max(drawn) > PANELS[name].ceiling


def test_the_score_has_the_numbers_and_the_words_of_the_command():
    """By their labels; of a walk that made no step most are unknown."""
    level = chosen_setting(**LEVEL | {"duration_s": 2.0})
    weak = gains_of_source("reference").as_document() | {"K_VAS": 0.0}
    fallen = walk(named_gains("weak", weak), level)
    assert fallen.row["step_count"] == 0 and fallen.row["end_reason"] == FELL
    lasts = walk(gains_of_source("reference"), chosen_setting(**LEVEL))
    row = r"align=left>([^<]*)</th><td align=right nowrap>([^<]*)<td align=right nowrap>([^<]*)"
    shown = {
        html.unescape(label): (before, now)
        for label, before, now in re.findall(row, score_text(fallen, lasts))
    }
    results = {
        name: Result(np.array([each.row]), (each.trajectory,))
        for name, each in (("lasts", lasts), ("weak", fallen))
    }
    said = summary(
        "gait", results, flat(), lasts.experiment.body(0).mass_kg.sum()
    ).splitlines()
    for label, cells in shown.items():
        (line,) = [each for each in said if each.startswith(label)]
        assert tuple(line.removeprefix(label).split()[:2]) == cells, label
    assert len(shown) > 20 and shown["scored steps"][1] == "0"
    assert "-" in [now for _, now in shown.values()]
    assert f"<b>{-lasts.row['step_count']}</b>" in score_text(fallen, lasts)
