"""A film of the walker: H.264 in MP4, made by the ffmpeg that comes with imageio-ffmpeg."""

import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from storage.commit import commit
from study.pictures.scene import LARGE, Film, frames
from taichi_nmm.errors import InputError
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import Terrain

FIXING = "a working ffmpeg: pip install imageio-ffmpeg, or leave the film out"


def find_ffmpeg() -> str:
    """Path of an ffmpeg that runs.

    Raises:
        InputError: there is none, or it does not start.
    """
    import imageio_ffmpeg

    try:
        program = str(imageio_ffmpeg.get_ffmpeg_exe())
        subprocess.run([program, "-version"], check=True, capture_output=True, timeout=30)
    except (OSError, RuntimeError, subprocess.SubprocessError) as error:
        reason = str(error).strip().splitlines()[0]
        raise InputError("ffmpeg", reason, FIXING) from None
    return program


def write_movie(
    path: str | Path,
    trajectory: Trajectory,
    terrain: Terrain,
    seconds: float = 8.0,
    title: str = "",
    *,
    film: Film = LARGE,
    program: str | None = None,
) -> Path:
    """Film the last `seconds` of a walk in real time, with the forces of the ground.

    Args:
        path: of the MP4 (H.264, yuv420p, index first).
        trajectory: of at least one sample.
        terrain: the ground it walked on.
        seconds: how much of the walk's end is shown.
        title: one line in the corner.
        film: its size, rate and quality.
        program: path of ffmpeg; by default that of `find_ffmpeg`.

    Raises:
        InputError: no ffmpeg that works, or the file cannot be written.
    """
    path = Path(path)
    encoder = program or find_ffmpeg()

    def write(temporary: Path) -> None:
        _encode(encoder, frames(trajectory, terrain, seconds, title, film), temporary, film)

    def check(temporary: Path) -> None:
        if temporary.stat().st_size == 0:
            raise OSError("the film was not written")

    commit(path, write, check)
    return path


def _encode(program: str, pictures: Iterator[bytes], path: Path, film: Film) -> None:
    width, height = film.size_px
    command = [
        program, "-y", "-loglevel", "error",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-r", str(film.rate_hz), "-i", "-",
        "-an", "-c:v", "libx264", "-crf", str(film.quality), "-preset", film.effort,
        "-threads", str(film.threads), "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", "-f", "mp4", str(path),
    ]  # fmt: skip
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None and process.stderr is not None
        try:
            with suppress(BrokenPipeError), process.stdin:  # its exit code tells why it has ended
                for picture in pictures:
                    process.stdin.write(picture)
            complaint = process.stderr.read().decode(errors="replace").strip()
        except BaseException:
            process.kill()
            raise
    if process.returncode != 0:
        reason = complaint.splitlines()[-1] if complaint else f"exit code {process.returncode}"
        raise InputError("ffmpeg", reason, FIXING)
