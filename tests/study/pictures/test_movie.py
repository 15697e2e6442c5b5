"""Films, as files; and an ffmpeg that fails."""

import re
import stat
import subprocess
import time
from pathlib import Path

import imageio_ffmpeg
import pytest
from matplotlib.image import imread

from study.pictures import find_ffmpeg, write_movie
from study.pictures.scene import LARGE, SMALL
from taichi_nmm.errors import InputError
from taichi_nmm.terrain import flat, rough
from tests.study import synthetic_gait

WALK = synthetic_gait.walk()
GLIMPSE = synthetic_gait.walk(0.3)


@pytest.fixture(scope="module")
def movie(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_movie(tmp_path_factory.mktemp("movie") / "movie.mp4", WALK, flat(), 0.5, "a title")


def test_movie_is_h264_that_every_player_shows(movie: Path, tmp_path: Path) -> None:
    probe = subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(movie)], capture_output=True, text=True
    ).stderr
    assert re.search(r"Video: h264 .*yuv420p", probe)
    assert f"{LARGE.size_px[0]}x{LARGE.size_px[1]}" in probe and f"{LARGE.rate_hz} fps" in probe
    content = movie.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")  # plays before it is loaded whole
    frame = tmp_path / "frame.png"
    subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(movie), "-frames:v", "1", str(frame)],
        capture_output=True, check=True,
    )  # fmt: skip
    assert imread(frame).shape[:2] == LARGE.size_px[::-1]
    assert imread(frame)[..., :3].std() > 0.03


def test_a_small_film_is_small_and_quick(tmp_path: Path) -> None:
    """0.5 s of drawing on one core of 2026 for 8 s of walking; ten times that is allowed."""
    before = time.process_time()
    path = write_movie(tmp_path / "small.mp4", WALK, rough(1), 8.0, "a title", film=SMALL)
    assert time.process_time() - before < 5.0
    assert path.stat().st_size < 400_000


def fake_ffmpeg(folder: Path, script: str) -> Path:
    program = folder / "ffmpeg"
    program.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return program


@pytest.mark.parametrize("program", ["/nowhere/ffmpeg", None], ids=["missing", "broken"])
def test_no_ffmpeg(program: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
