"""Films: their frames and drawing surface, the files, and an ffmpeg that fails."""

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

from study.pictures import find_ffmpeg, write_movie
from study.pictures.scene import LARGE, SMALL, Canvas, Film, frames
from taichi_nmm import InputError, Trajectory
from taichi_nmm.terrain import flat, rough
from tests.study.synthetic_gait import GLIMPSE, WALK


def test_shapes_are_drawn_to_scale_and_a_bone_has_round_ends() -> None:
    canvas = Canvas((200, 100), left_m=10.0, bottom_m=-1.0, width_m=4.0)
    canvas.polygon(
        np.array([[11.0, -0.5], [13.0, -0.5], [13.0, 0.5], [11.0, 0.5]]), "#000000"
    )
    canvas.finish()
    black = np.asarray(canvas.picture)[..., 0] < 128
    assert black.sum() == pytest.approx(100 * 50, rel=0.03)
    assert (
        black[26:74, 51:149].all() and not black[:24].any() and not black[:, :49].any()
    )
    assert canvas.place(11.0, 0.5) == pytest.approx((50.0, 25.0))
    canvas = Canvas((200, 100), left_m=10.0, bottom_m=-1.0, width_m=4.0)
    canvas.bones([(np.array([11.0, 0.0]), np.array([13.0, 0.0]), 0.5)], "#000000")
    canvas.finish()
    black = np.asarray(canvas.picture)[..., 0] < 128
    assert black.sum() == pytest.approx(100 * 25 + np.pi * 12.5**2, rel=0.03)
    assert black.any(axis=0).sum() == pytest.approx(125, abs=1)


def picture(film: Film, title: str = "", walk: Trajectory = WALK) -> np.ndarray:
    """The last frame of a film, [height, width, 3]."""
    *_, last = frames(walk, flat(), 0.2, title, film)
    width, height = film.size_px
    return np.frombuffer(last, np.uint8).reshape(height, width, 3)


@pytest.mark.parametrize("film", [LARGE, SMALL])
def test_the_walker_stands_on_the_ground_in_the_middle_of_the_frame(film: Film) -> None:
    frame = picture(film)
    width, height = film.size_px
    ground = np.all(frame == (0xCF, 0xC8, 0xBC), axis=-1)
    assert (
        ground[int(0.9 * height), int(0.03 * width)]
        and not ground[: int(0.8 * height)].any()
    )
    shown = np.any(
        frame[int(0.3 * height) : int(0.8 * height), : int(0.88 * width)] < 250, axis=-1
    )
    columns = np.flatnonzero(shown.any(axis=0)) / width
    assert 0.25 < columns.min() < 0.45 < columns.max() < 0.65


def test_active_muscles_are_darker() -> None:
    def darkness(activation: float) -> float:
        walk = replace(WALK, activation=np.full_like(WALK.activation, activation))
        return 255.0 - float(picture(SMALL, walk=walk).mean())

    assert darkness(0.0) < darkness(0.5) < darkness(1.0)
    corner = np.s_[:40, :200]
    assert (picture(SMALL, "dog")[corner] != picture(SMALL, "random")[corner]).any()


@pytest.fixture(scope="module")
def movie(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_movie(
        tmp_path_factory.mktemp("movie") / "movie.mp4", WALK, flat(), 0.5, "a title"
    )


def test_movie_is_h264_that_every_player_shows(movie: Path, tmp_path: Path) -> None:
    probe = subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(movie)],
        capture_output=True,
        text=True,
    ).stderr
    assert re.search(r"Video: h264 .*yuv420p", probe)
    assert (
        f"{LARGE.size_px[0]}x{LARGE.size_px[1]}" in probe
        and f"{LARGE.rate_hz} fps" in probe
    )
    content = movie.read_bytes()
    assert content.index(b"moov") < content.index(
        b"mdat"
    )  # plays before it is loaded whole
    frame = tmp_path / "frame.png"
    subprocess.run(
        [
            imageio_ffmpeg.get_ffmpeg_exe(),
            "-i",
            str(movie),
            "-frames:v",
            "1",
            str(frame),
        ],
        capture_output=True,
        check=True,
    )
    assert imread(frame).shape[:2] == LARGE.size_px[::-1]
    assert imread(frame)[..., :3].std() > 0.03


def test_a_small_film_is_small_and_quick(tmp_path: Path) -> None:
    """0.5 s of drawing on one core of 2026 for 8 s of walking; ten times that is allowed."""
    before = time.process_time()
    path = write_movie(
        tmp_path / "small.mp4", WALK, rough(1), 8.0, "a title", film=SMALL
    )
    assert time.process_time() - before < 5.0
    assert path.stat().st_size < 400_000


def fake_ffmpeg(folder: Path, script: str) -> Path:
    program = folder / "ffmpeg"
    program.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return program


@pytest.mark.parametrize(
    "program", ["/nowhere/ffmpeg", None], ids=["missing", "broken"]
)
def test_no_ffmpeg(
    program: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = program or str(fake_ffmpeg(tmp_path, "exit 1"))
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", broken)
    with pytest.raises(
        InputError, match=r"ffmpeg: .* cannot be used; allowed: a working ffmpeg"
    ):
        find_ffmpeg()


def test_ffmpeg_that_dies_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = '[ "$1" = -version ] && exit 0\necho "codec on strike" >&2\nexit 1'
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(fake_ffmpeg(tmp_path, script)))
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(InputError, match="codec on strike"):
        write_movie(out / "movie.mp4", GLIMPSE, flat())
    assert not list(out.iterdir())
