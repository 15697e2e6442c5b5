"""Pictures of a gait, drawn of a walk whose every number is known."""

import re
import stat
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from matplotlib.image import imread

from study.pictures import find_ffmpeg, write_gait_cycle, write_movie, write_strip
from study.pictures.canvas import Canvas, capsule
from study.pictures.gait_cycle import SIZE_IN, subtitle
from study.pictures.human_ranges import (
    DORSIFLEXION_DEG,
    EMG_ON_PERCENT,
    FORWARD_FORCE_BW,
    HIP_FLEXION_DEG,
    KNEE_FLEXION_DEG,
    VERTICAL_FORCE_BW,
    HumanRange,
)
from study.pictures.scene import LARGE, SMALL, frames
from study.pictures.skeleton import leg, muscle_outlines, trunk
from study.pictures.strides import PERCENT, left_strides
from study.pictures.style import PNG_DPI
from study.pictures.window import finite, last_metres, last_seconds
from taichi_nmm.errors import InputError
from taichi_nmm.result import MUSCLES
from taichi_nmm.terrain import flat, ramp, rough
from tests.study import synthetic_gait
from tests.study.synthetic_gait import BODY_WEIGHT_N, SPEED_MPS, STRIDE_S

WALK = synthetic_gait.walk()
GLIMPSE = synthetic_gait.walk(0.3)


def shows_something(path: Path) -> bool:
    return bool(imread(path)[..., :3].std() > 0.03)


# Human ranges


@pytest.mark.parametrize(
    "human",
    [HIP_FLEXION_DEG, KNEE_FLEXION_DEG, DORSIFLEXION_DEG, VERTICAL_FORCE_BW, FORWARD_FORCE_BW],
)
def test_a_human_range_covers_the_stride_and_closes(human: HumanRange) -> None:
    percent = [row[0] for row in human.rows]
    mean, sd = human.at(PERCENT)
    assert percent[0] == 0 and percent[-1] == 100 and np.all(np.diff(percent) > 0)
    assert np.all(np.isfinite(mean)) and np.all(sd >= 0)
    assert mean[0] == pytest.approx(mean[-1], abs=0.05)


def test_human_ranges_have_the_landmarks_of_walking() -> None:
    knee, ankle = KNEE_FLEXION_DEG.at(PERCENT)[0], DORSIFLEXION_DEG.at(PERCENT)[0]
    up, forward = VERTICAL_FORCE_BW.at(PERCENT)[0], FORWARD_FORCE_BW.at(PERCENT)[0]
    assert 60 < knee.max() < 70 and 68 < PERCENT[knee.argmax()] < 76
    assert -25 < ankle.min() < -15 and 58 < PERCENT[ankle.argmin()] < 68
    # Over a stride each leg carries half the weight and gives back what it braked.
    assert up.mean() == pytest.approx(0.5, abs=0.03)
    assert forward.mean() == pytest.approx(0.0, abs=0.01)


def test_every_muscle_has_its_phases() -> None:
    assert set(EMG_ON_PERCENT) == set(MUSCLES)
    assert all(0 <= on < off <= 100 for phases in EMG_ON_PERCENT.values() for on, off in phases)


# Geometry


def test_standing_upright_is_drawn_upright() -> None:
    q = np.array([2.0, 1.0, 0, 0, 0, 0, 0, 0, 0])
    joints = leg(q, 0)
    shoulder, head = trunk(q)
    np.testing.assert_allclose(joints.knee, [2.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(joints.ankle, [2.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(joints.heel, [1.96, 0.0], atol=1e-12)
    np.testing.assert_allclose(joints.ball, [2.16, 0.0], atol=1e-12)
    np.testing.assert_allclose(shoulder, [2.0, 1.5])
    assert head[1] > shoulder[1]


@pytest.mark.parametrize(
    ("column", "angle", "point", "moves"),
    [(3, 0.3, "knee", (-1, 1)), (4, 0.3, "ankle", (-1, 1)), (5, 0.3, "ball", (-1, -1))],
)
def test_positive_angles_turn_clockwise(
    column: int, angle: float, point: str, moves: tuple[int, int]
) -> None:
    q = np.zeros(9)
    before = getattr(leg(q, 0), point)
    q[column] = angle
    assert tuple(np.sign(getattr(leg(q, 0), point) - before)) == moves


def test_muscles_lie_along_their_bones() -> None:
    outlines = dict(zip(MUSCLES, muscle_outlines(np.array([0, 1.0, *[0.0] * 7]), 1), strict=True))
    assert outlines["TA"][:, 0].max() > 0 > outlines["SOL"][:, 0].min()
    assert outlines["VAS"][:, 0].max() > 0 > outlines["HAM"][:, 0].min()
    assert outlines["HFL"][:, 1].min() > 0.8 and outlines["SOL"][:, 1].max() < 0.5
    assert all(np.isfinite(outline).all() for outline in outlines.values())


# Strides


def test_strides_are_cut_at_left_heel_strikes_in_clinical_signs() -> None:
    strides = left_strides(WALK, BODY_WEIGHT_N)
    assert len(strides) == 3 and strides.enough
    np.testing.assert_allclose(strides.duration_s, STRIDE_S)
    inner = slice(5, -5)  # the synthetic walk has a corner at the strike
    for curves, human, tolerance in (
        (strides.hip_flexion_deg, HIP_FLEXION_DEG, 0.2),
        (strides.knee_flexion_deg, KNEE_FLEXION_DEG, 0.5),
        (strides.dorsiflexion_deg, DORSIFLEXION_DEG, 0.3),
    ):
        expected = human.at(PERCENT)[0]
        np.testing.assert_allclose(curves[:, inner], [expected[inner]] * 3, atol=tolerance)
    np.testing.assert_allclose(strides.take_off_percent, 60.0)


def test_forces_are_in_body_weights_and_belong_to_the_middle_of_their_interval() -> None:
    strides = left_strides(WALK, BODY_WEIGHT_N)
    half_interval = 100.0 * 0.005 / STRIDE_S
    expected = VERTICAL_FORCE_BW.at(np.minimum(PERCENT + half_interval, 100.0))[0]
    np.testing.assert_allclose(strides.vertical_bw.mean(axis=0)[5:-5], expected[5:-5], atol=0.01)
    assert strides.forward_bw.min() < -0.1 and strides.forward_bw.max() > 0.15


def test_too_few_strides_are_said_in_words() -> None:
    strides = left_strides(GLIMPSE, BODY_WEIGHT_N)
    assert len(strides) == 0 and not strides.enough
    assert subtitle(strides).startswith("0 whole strides after settling: too few")
    assert "3 strides" in subtitle(left_strides(WALK, BODY_WEIGHT_N))


# Windows


def test_the_end_of_the_walk_is_shown() -> None:
    start_s, end_s = last_metres(WALK, 2.6)
    assert end_s == WALK.time_s[-1]
    assert end_s - start_s == pytest.approx(2.6 / SPEED_MPS, abs=0.03)
    assert last_metres(GLIMPSE, 100.0) == (GLIMPSE.time_s[0], GLIMPSE.time_s[-1])
    assert last_seconds(WALK, 2.0) == (WALK.time_s[-1] - 2.0, WALK.time_s[-1])


def test_a_walker_that_diverged_is_shown_until_it_did() -> None:
    q = WALK.q.copy()
    q[700:, 3] = np.nan
    shown = finite(replace(WALK, q=q))
    assert len(shown.time_s) == len(shown.q) == len(shown.activation) == 700
    with pytest.raises(InputError, match="no finite sample"):
        finite(replace(WALK, q=np.full_like(q, np.nan)))


# Files


@pytest.mark.parametrize("terrain", [flat(), rough(1), ramp()], ids=lambda terrain: terrain.name)
@pytest.mark.parametrize("trajectory", [WALK, GLIMPSE], ids=["walk", "glimpse"])
def test_strip(tmp_path: Path, trajectory, terrain) -> None:
    path = write_strip(tmp_path / "strip.png", trajectory, terrain, "a title")
    height, width = imread(path).shape[:2]
    assert width >= 5 * PNG_DPI and 2 * PNG_DPI < height < width
    assert shows_something(path)


@pytest.mark.parametrize("trajectory", [WALK, GLIMPSE], ids=["walk", "glimpse"])
def test_gait_cycle(tmp_path: Path, trajectory) -> None:
    path = write_gait_cycle(tmp_path / "cycle.png", trajectory, BODY_WEIGHT_N, "a title")
    assert imread(path).shape[:2] == (round(SIZE_IN[1] * PNG_DPI), round(SIZE_IN[0] * PNG_DPI))
    assert shows_something(path)


def test_pictures_are_the_same_every_time(tmp_path: Path) -> None:
    first = write_strip(tmp_path / "1.png", WALK, flat())
    second = write_strip(tmp_path / "2.png", WALK, flat())
    assert first.read_bytes() == second.read_bytes()


@pytest.fixture(scope="module")
def movie(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_movie(tmp_path_factory.mktemp("movie") / "movie.mp4", WALK, flat(), 0.5, "a title")


def test_movie_is_h264_that_every_player_shows(movie: Path) -> None:
    probe = subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(movie)], capture_output=True, text=True
    ).stderr
    assert re.search(r"Video: h264 .*yuv420p", probe)
    assert f"{LARGE.size_px[0]}x{LARGE.size_px[1]}" in probe and f"{LARGE.rate_hz} fps" in probe
    content = movie.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")  # plays before it is loaded whole


def test_movie_shows_the_walk(movie: Path, tmp_path: Path) -> None:
    frame = tmp_path / "frame.png"
    subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(movie), "-frames:v", "1", str(frame)],
        capture_output=True, check=True,
    )  # fmt: skip
    assert imread(frame).shape[:2] == LARGE.size_px[::-1]
    assert shows_something(frame)


def test_a_small_film_is_small_and_quick(tmp_path: Path) -> None:
    """0.5 s of drawing on one core of 2026 for 8 s of walking; ten times that is allowed."""
    before = time.process_time()
    path = write_movie(tmp_path / "small.mp4", WALK, rough(1), 8.0, "a title", film=SMALL)
    assert time.process_time() - before < 5.0
    assert path.stat().st_size < 400_000


def picture(film, title: str = "", walk=WALK) -> np.ndarray:
    """The last frame of a film, [height, width, 3]."""
    *_, last = frames(walk, flat(), 0.2, title, film)
    width, height = film.size_px
    return np.frombuffer(last, np.uint8).reshape(height, width, 3)


@pytest.mark.parametrize("film", [LARGE, SMALL])
def test_the_walker_stands_on_the_ground_in_the_middle_of_the_frame(film) -> None:
    frame = picture(film)
    width, height = film.size_px
    ground = np.all(frame == (0xCF, 0xC8, 0xBC), axis=-1)
    assert ground[int(0.9 * height), int(0.03 * width)] and not ground[: int(0.8 * height)].any()
    shown = np.any(frame[int(0.3 * height) : int(0.8 * height), : int(0.88 * width)] < 250, axis=-1)
    columns = np.flatnonzero(shown.any(axis=0)) / width
    assert 0.25 < columns.min() < 0.45 < columns.max() < 0.65


def test_active_muscles_are_darker() -> None:
    def darkness(activation: float) -> float:
        walk = replace(WALK, activation=np.full_like(WALK.activation, activation))
        return 255.0 - float(picture(SMALL, walk=walk).mean())

    assert darkness(0.0) < darkness(0.5) < darkness(1.0)


def test_a_title_is_written() -> None:
    corner = np.s_[:40, :200]
    assert (picture(SMALL, "dog")[corner] != picture(SMALL, "random")[corner]).any()


def test_shapes_are_drawn_to_scale() -> None:
    canvas = Canvas((200, 100), left_m=10.0, bottom_m=-1.0, width_m=4.0)
    canvas.polygon(np.array([[11.0, -0.5], [13.0, -0.5], [13.0, 0.5], [11.0, 0.5]]), "#000000")
    canvas.finish()
    black = np.asarray(canvas.picture)[..., 0] < 128
    assert black.sum() == pytest.approx(100 * 50, rel=0.03)
    assert black[26:74, 51:149].all() and not black[:24].any() and not black[:, :49].any()
    assert canvas.place(11.0, 0.5) == pytest.approx((50.0, 25.0))


def test_a_capsule_has_its_width_and_round_ends() -> None:
    outline = capsule(np.array([0.0, 0.0]), np.array([0.0, 2.0]), 0.5)
    np.testing.assert_allclose(outline.min(axis=0), [-0.25, -0.25], atol=1e-12)
    np.testing.assert_allclose(outline.max(axis=0), [0.25, 2.25], atol=1e-12)


# What can go wrong


def fake_ffmpeg(folder: Path, script: str) -> Path:
    program = folder / "ffmpeg"
    program.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return program


@pytest.mark.parametrize("program", ["/nowhere/ffmpeg", None], ids=["missing", "broken"])
def test_ffmpeg_that_does_not_start(
    program: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = program or str(fake_ffmpeg(tmp_path, "exit 1"))
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", broken)
    with pytest.raises(InputError, match=r"ffmpeg: .* cannot be used; allowed: a working ffmpeg"):
        find_ffmpeg()


def test_ffmpeg_that_dies_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = '[ "$1" = -version ] && exit 0\necho "codec on strike" >&2\nexit 1'
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(fake_ffmpeg(tmp_path, script)))
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(InputError, match="codec on strike"):
        write_movie(out / "movie.mp4", GLIMPSE, flat())
    assert not list(out.iterdir())


def test_unwritable_place(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    for write in (
        lambda path: write_strip(path, GLIMPSE, flat()),
        lambda path: write_gait_cycle(path, GLIMPSE, BODY_WEIGHT_N),
    ):
        with pytest.raises(InputError, match="a place that can be written"):
            write(tmp_path / "file" / "picture.png")
