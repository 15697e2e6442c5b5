"""Films: their frames and drawing surface, the files, and an ffmpeg that fails."""

import re
import subprocess
import time
from dataclasses import replace

import imageio_ffmpeg
import numpy as np
import pytest
from matplotlib.image import imread

from study.pictures import find_ffmpeg, write_movie, write_movies
from study.pictures.scene import (
    LARGE,
    SMALL,
    Canvas,
    Scene,
    force_arrows,
    frames,
    motion_of,
)
from taichi_nmm.terrain import flat, rough
from tests.cases import refused
from tests.study.synthetic_gait import GLIMPSE, WALK


def drawn(shape):
    """Which pixels are black, of 4 m by 2 m from 10 m on, [100, 200]."""
    canvas = Canvas((200, 100), left_m=10.0, bottom_m=-1.0, width_m=4.0)
    shape(canvas)
    canvas.finish()
    assert canvas.place(11.0, 0.5) == pytest.approx((50.0, 25.0))
    return np.asarray(canvas.picture)[..., 0] < 128


def test_shapes_are_drawn_to_scale_and_a_bone_has_round_ends():
    corners = np.array([[11.0, -0.5], [13.0, -0.5], [13.0, 0.5], [11.0, 0.5]])
    black = drawn(lambda canvas: canvas.polygon(corners, "#000000"))
    assert black.sum() == pytest.approx(100 * 50, rel=0.03)
    assert black[26:74, 51:149].all()
    assert not black[:24].any() and not black[:, :49].any()
    bone = (np.array([11.0, 0.0]), np.array([13.0, 0.0]), 0.5)
    black = drawn(lambda canvas: canvas.bones([bone], "#000000"))
    assert black.sum() == pytest.approx(100 * 25 + np.pi * 12.5**2, rel=0.03)
    assert black.any(axis=0).sum() == pytest.approx(125, abs=1)


def picture(film, title="", walk=WALK, seconds=0.2):
    """The last frame of a film, [height, width, 3]."""
    *_, last = frames(walk, flat(), seconds, title, film)
    width, height = film.size_px
    return np.frombuffer(last, np.uint8).reshape(height, width, 3)


@pytest.mark.parametrize("film", [LARGE, SMALL])
def test_the_walker_stands_on_the_ground_in_the_middle_of_the_frame(film):
    frame = picture(film)
    width, height = film.size_px
    sky, sole = int(0.8 * height), int(0.9 * height)
    ground = np.all(frame == (0xCF, 0xC8, 0xBC), axis=-1)
    assert ground[sole, int(0.03 * width)] and not ground[:sky].any()
    body = frame[int(0.3 * height) : sky, : int(0.88 * width)]
    shown = np.any(body < 250, axis=-1)
    columns = np.flatnonzero(shown.any(axis=0)) / width
    assert 0.25 < columns.min() < 0.45 < columns.max() < 0.65


def test_active_muscles_are_darker():
    def darkness(activation):
        walk = replace(WALK, activation=np.full_like(WALK.activation, activation))
        return 255.0 - float(picture(SMALL, walk=walk).mean())

    assert darkness(0.0) < darkness(0.5) < darkness(1.0)
    corner = np.s_[:40, :200]
    assert (picture(SMALL, "dog")[corner] != picture(SMALL, "random")[corner]).any()


@pytest.mark.parametrize("film", [LARGE, SMALL])
def test_a_title_is_one_line(film):
    """It ends before the edge, above all else."""
    plain, titled = (picture(film, title) for title in ("", "w" * 150))
    rows, columns = np.nonzero((plain != titled).any(axis=-1))
    width, height = film.size_px
    assert rows.min() > 0 and rows.max() < 0.09 * height
    assert columns.min() < 0.03 * width and 0.9 * width < columns.max() < 0.99 * width


def test_a_device_is_in_the_film_with_its_key():
    torque_nm = np.zeros((len(WALK.time_s), 6))
    torque_nm[:, 2] = 60.0
    green = np.array([0x00, 0x9E, 0x73])
    worn = picture(LARGE, walk=replace(WALK, device_torque_nm=torque_nm))
    drawn = (np.abs(worn.astype(int) - green) < 8).all(axis=-1)
    height, width = drawn.shape
    assert drawn[int(0.6 * height) :, int(0.3 * width) : int(0.6 * width)].sum() > 200
    assert not (np.abs(picture(LARGE).astype(int) - green) < 8).all(axis=-1).any()
    key = np.s_[int(0.2 * height) : int(0.26 * height), : int(0.2 * width)]
    assert (worn[key] != picture(LARGE)[key]).any()


def test_a_push_is_an_arrow_to_the_trunk_while_it_acts():
    push_n = np.zeros((len(WALK.time_s), 1))
    push_n[50:60] = -200.0
    pushed = replace(WALK, push_n=push_n)
    motion = motion_of(pushed, flat(), WALK.time_s[-1], 50)
    behind, mass = force_arrows(motion)[:, 2].swapaxes(0, 1)
    acts = np.flatnonzero(np.isfinite(behind[:, 0]))
    np.testing.assert_allclose(motion.time_s[acts], [0.51, 0.53, 0.55, 0.57, 0.59])
    back_m = 0.6 * 200.0 / 785.0  # a body weight of 80 kg is 0.6 m long
    np.testing.assert_allclose((behind - mass)[acts], [[back_m, 0.0]] * 5, atol=1e-9)
    np.testing.assert_allclose(np.hypot(*(mass - motion.q[:, :2]).T), 0.35)
    shown = [
        Scene(each, flat(), "", LARGE.size_px)
        for each in (motion, motion_of(WALK, flat(), WALK.time_s[-1], 50))
    ]
    with_arrow, without = (
        [np.frombuffer(scene.picture(n), np.uint8) for n in (acts[2], acts[2] + 9)]
        for scene in shown
    )
    differ = [
        (one != other).sum() for one, other in zip(with_arrow, without, strict=True)
    ]
    assert differ[0] > differ[1] + 500  # the key is in both, the arrow in the first


def test_the_ground_is_orange_while_it_slips():
    slips = replace(WALK, slip=np.array([7.9, 0.05, 0.1]))
    both = (frames(walk, flat(), 0.1, "", SMALL) for walk in (slips, WALK))
    redder = []
    for pair in zip(*both, strict=True):
        red, as_usual = (
            np.frombuffer(frame, np.uint8).reshape(320, 640, 3)[160:, :, 0]
            for frame in pair
        )
        redder.append(bool((red > as_usual).any(axis=0).mean() > 0.9))
    assert redder == [True, False, False]  # at 7.9, 7.95 and 8 s


def test_walks_are_filmed_above_each_other(tmp_path):
    """Of the shorter one the last picture stays."""
    file, frame = tmp_path / "both.mp4", tmp_path / "frame.png"
    walks = [(GLIMPSE, "short"), (WALK, "long")]
    write_movies(file, walks, flat(), 1.0, film=SMALL)
    said = ffmpeg("-i", str(file), "-update", "1", str(frame))  # the last one
    width, height = SMALL.size_px
    assert f"{width}x{2 * height}" in said
    upper, lower = np.split(imread(frame)[..., :3] * 255.0, 2)
    for found, walk in ((upper, GLIMPSE), (lower, WALK)):
        title = "short" if walk is GLIMPSE else "long"
        expected = picture(SMALL, title, walk, seconds=1.0)
        other = picture(SMALL, title, WALK if walk is GLIMPSE else GLIMPSE, 1.0)
        assert np.abs(found - expected).mean() < 0.5 * np.abs(found - other).mean()


def ffmpeg(*words):
    """What it says."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), *words]
    return subprocess.run(command, capture_output=True, text=True).stderr


def test_movie_is_h264_that_every_player_shows(tmp_path):
    movie = write_movie(tmp_path / "movie.mp4", WALK, flat(), 0.5, "a title")
    frame = tmp_path / "frame.png"
    said = ffmpeg("-i", str(movie), "-frames:v", "1", str(frame))
    assert re.search(r"Video: h264 .*yuv420p", said)
    width, height = LARGE.size_px
    assert f"{width}x{height}" in said and f"{LARGE.rate_hz} fps" in said
    content = movie.read_bytes()
    # It plays before it is loaded whole.
    assert content.index(b"moov") < content.index(b"mdat")
    picture = imread(frame)
    assert picture.shape[:2] == (height, width) and picture[..., :3].std() > 0.03


def test_a_small_film_is_small_and_quick(tmp_path):
    """0.5 s of drawing on one core of 2026 for 8 s of walking; ten times that is allowed."""
    before = time.process_time()
    file = tmp_path / "small.mp4"
    write_movie(file, WALK, rough(1), 8.0, "a title", film=SMALL)
    assert time.process_time() - before < 5.0
    assert file.stat().st_size < 400_000


def fake_ffmpeg(folder, script):
    program = folder / "ffmpeg"
    program.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    program.chmod(0o700)
    return program


@pytest.mark.parametrize(
    "program", ["/nowhere/ffmpeg", None], ids=["missing", "broken"]
)
def test_no_ffmpeg(program, tmp_path, monkeypatch):
    broken = program or str(fake_ffmpeg(tmp_path, "exit 1"))
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", broken)
    said = r"ffmpeg: .* cannot be used; allowed: a working ffmpeg"
    with refused(said):
        find_ffmpeg()


def test_ffmpeg_that_dies_leaves_nothing(tmp_path, monkeypatch):
    script = '[ "$1" = -version ] && exit 0\necho "codec on strike" >&2\nexit 1'
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(fake_ffmpeg(tmp_path, script)))
    out = tmp_path / "out" / "movie.mp4"
    out.parent.mkdir()
    with refused("codec on strike"):
        write_movie(out, GLIMPSE, flat())
    assert not list(out.parent.iterdir())
