"""A gait that walks for the page: what is drawn, why it fell, and the same bits without a page."""

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from storage.store import open_store
from study.explore.downloads import NAMES, command_line, file_of_selection, file_of_walk
from study.explore.walk import RATE_HZ, Walk, chosen_setting, frames_of, walk
from study.gains import gains_of_source
from taichi_nmm.parameters import GAIN_NAMES
from tests.study import fake_walker, synthetic_gait
from tests.tools.running import run_tool

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def fallen() -> Walk:
    """The published gains on stairs, on which it falls."""
    setting = chosen_setting("stairs up, 10 cm a step", "within 15 %", 3, "nominal", "taichi", 20.0)
    return walk(gains_of_source("published"), setting)


def test_frames_are_the_poses_of_the_walk(fallen: Walk) -> None:
    frames, trajectory = fallen.frames, fallen.trajectory
    count = len(frames.time_s)
    assert count == pytest.approx(RATE_HZ * trajectory.time_s[-1], abs=1)
    assert frames.muscles.shape[:2] == (count, 14) and frames.forces.shape == (count, 2, 2, 2)
    hip = np.interp(frames.time_s, trajectory.time_s, trajectory.q[:, 0])
    np.testing.assert_allclose(frames.near[:, 0, 0], hip, atol=1e-4)
    np.testing.assert_allclose(frames.far[:, 0, 0], hip, atol=1e-4)
    assert np.ptp(frames.ground[:, 1]) > 0.1  # steps
    assert all(len(column) == 1 for column in frames.columns().values())


def test_a_fall_says_why(fallen: Walk) -> None:
    assert fallen.ended.startswith("fell after ")
    pose = fallen.trajectory.q[-1]
    height_m = pose[1] - fallen.setting.terrain.height(pose[0])
    leaned = abs(np.rad2deg(pose[2])) > 57.0  # a sample before the bound of 60
    assert ("the trunk leaned" in fallen.ended) == leaned
    assert ("the hip sank to" in fallen.ended) == (not leaned)
    assert leaned or height_m < 0.62


def test_a_walk_that_never_was_finite_still_has_frames_or_says_so() -> None:
    trajectory = synthetic_gait.walk(2.0, 100.0)
    q = trajectory.q.copy()
    q[50:] = np.nan
    terrain = chosen_setting("flat", "nominal", 0, "nominal", "taichi", 5.0).experiment.terrain(0)
    frames = frames_of(replace(trajectory, q=q), terrain)
    assert np.isfinite(frames.near).all() and frames.time_s[-1] <= trajectory.time_s[50]


def test_what_is_taken_walks_the_same_to_the_bit(
    fallen: Walk,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for wanted in ("gains.json", "walk.toml"):
        name, content = file_of_walk(fallen, wanted)
        Path(name).write_bytes(content)
    words = command_line(fallen).split()
    assert words[:2] == ["taichi-nmm", "walk"]
    more = ("--movie-seconds", "0", "--json", "--out", "pictures")
    assert run_tool(monkeypatch, "walk", *words[2:], *more) == 0
    found = json.loads(capsys.readouterr().out)
    for field in ("duration_s", "distance_m", "phi_printed", "cost_of_transport_jpkgpm"):
        assert found[field] == fallen.row[field], field
    assert found["gains"] == dict(zip(GAIN_NAMES, fallen.gains.gains.tolist(), strict=True))
    title, _, rest = file_of_walk(fallen, "walk.sto")[1].partition(b"\n")
    assert title == b"published" and Path("walk.sto").read_bytes() == b"gains\n" + rest


def test_every_file_can_be_made(fallen: Walk) -> None:
    begins = {"png": b"\x89PNG", "mp4": b"", "json": b"{", "toml": b"runs", "csv": b"time_s,",
              "mot": b"published\n", "sto": b"published\n"}  # fmt: skip
    for wanted in NAMES:
        name, content = file_of_walk(fallen, wanted)
        assert name == wanted and len(content) > 100
        assert content.startswith(begins[name.rpartition(".")[2]])


def test_a_selection_is_read_back(fake_simulator: None, tmp_path: Path) -> None:
    fake_walker.write_plain_store(tmp_path / "store")
    table = open_store(tmp_path / "store").table()
    low = float(np.median(table["mean_speed_mps"].to_numpy()))
    wanted = table.filter(table["mean_speed_mps"].to_numpy() >= low)
    name, content = file_of_selection(
        tmp_path / "store", {"mean_speed_mps": (low, np.inf)}, ".parquet"
    )
    assert name == "selection.parquet" and pq.read_table(io.BytesIO(content)).equals(wanted)
    name, content = file_of_selection(tmp_path / "store", {"mean_speed_mps": (low, np.inf)}, ".csv")
    again = pyarrow.csv.read_csv(io.BytesIO(content))
    assert again["row"].to_pylist() == wanted["row"].to_pylist()
    assert again["phi_printed"].to_pylist() == wanted["phi_printed"].to_pylist()
