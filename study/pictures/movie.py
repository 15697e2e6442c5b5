"""Films of walkers: H.264 in MP4, made by the ffmpeg that comes with imageio-ffmpeg."""

import os
import subprocess
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from storage.commit import commit
from storage.inputs.errors import InputError, listed, one_line, shortened
from storage.simulator import find_simulator
from study.pictures.scene import LARGE, SMALL, Film, frames
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import Terrain

if TYPE_CHECKING:
    from storage.mujoco_simulator import MujocoSimulator

NO_OPENGL = "OpenGL: without a screen, MUJOCO_GL=egl in the environment, and the package libegl1"
OPTIONS = (  # of ffmpeg: RGB frames come in, and H.264 goes out that every player shows
    "-y -loglevel error -f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {film.rate_hz} -i - "
    "-an -c:v libx264 -crf {film.quality} -preset {film.effort} -threads {film.threads} "
    "-pix_fmt yuv420p -movflags +faststart -f mp4"
)
FIXING = "a working ffmpeg: pip install imageio-ffmpeg, or leave the film out"


def find_ffmpeg() -> str:
    """Path of an ffmpeg that runs.

    Raises:
        InputError: there is none, or it does not start.
    """
    import imageio_ffmpeg

    try:
        program = str(imageio_ffmpeg.get_ffmpeg_exe())
        subprocess.run(
            [program, "-version"], check=True, capture_output=True, timeout=30
        )
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
) -> Path:
    """Film the last `seconds` of a walk in real time, with the forces of the ground.

    Args:
        path: of the MP4 (H.264, yuv420p, index first).
        trajectory: of at least one sample.
        terrain: the ground it walked on.
        seconds: how much of the walk's end is shown.
        title: one line in the corner.
        film: its size, rate and quality.

    Raises:
        InputError: no ffmpeg that works, or the file cannot be written.
    """
    return write_movies(path, [(trajectory, title)], terrain, seconds, film=film)


def write_movies(
    path: str | Path,
    walks: Sequence[tuple[Trajectory, str]],
    terrain: Terrain,
    seconds: float,
    *,
    film: Film = LARGE,
) -> Path:
    """Film several walks above each other; of a shorter one the last picture stays.

    Args:
        path: as in `write_movie`.
        walks: each with its title.
        terrain: the ground that they walked on.
        seconds: how much of each walk's end is shown.
        film: size of each, rate and quality.

    Raises:
        InputError: as `write_movie`.
    """
    width, height = film.size_px
    whole = replace(film, size_px=(width, height * len(walks)))
    films = [frames(walk, terrain, seconds, title, film) for walk, title in walks]
    return _write(path, _above_each_other(films), whole)


def _above_each_other(films: Sequence[Iterator[bytes]]) -> Iterator[bytes]:
    last = [b""] * len(films)
    for pictures in zip_longest(*films):
        last = [new or old for new, old in zip(pictures, last, strict=True)]
        yield b"".join(last)


def film_run(
    path: str | Path,
    simulator: "MujocoSimulator",
    point: Mapping[str, Any],
    world: Mapping[str, float],
    seconds: float,
    *,
    film: Film = LARGE,
) -> Path:
    """Film a run of a robot in MuJoCo, in real time, by the camera that its model names first.

    Args:
        path: of the MP4, as in `write_movie`.
        simulator: of the robot.
        point: its parameters.
        world: numbers that are not those of the base setting.
        seconds: how long it runs, if it does not fall.
        film: size, rate and quality.

    Raises:
        InputError: no ffmpeg or no OpenGL that works, or the file cannot be written.
    """
    return _write(path, _drawn(simulator, point, world, seconds, film), film)


def filmed(
    simulator: str, world: Mapping[str, float], seconds: float, point: Mapping[str, Any]
) -> bytes:
    """An MP4 of a run; in a process of its own, since MuJoCo reads how to draw when it is loaded.

    Raises:
        InputError: no OpenGL.
    """
    if not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl")
    robot: Any = find_simulator(simulator)
    return encoded(_drawn(robot, point, world, seconds, SMALL), SMALL)


def filmable(name: str, parameters: Collection[str]) -> Any:
    """The simulator of MuJoCo with this name and these parameters.

    Raises:
        InputError: none, or one of another kind or of other parameters.
    """
    from storage.mujoco_simulator import MujocoSimulator

    robot = find_simulator(name)
    if not isinstance(robot, MujocoSimulator):
        allowed = "a MujocoSimulator: others have nothing to film"
        raise InputError("simulator", name, allowed)
    if set(parameters) != set(robot.space):
        allowed = f"one with the parameters {listed(parameters)}"
        raise InputError("simulator", name, allowed)
    return robot


def _drawn(
    simulator: "MujocoSimulator",
    point: Mapping[str, Any],
    world: Mapping[str, float],
    seconds: float,
    film: Film,
) -> Iterator[bytes]:
    """The frames of a run, as `encoded` takes them."""
    import mujoco

    model, states = simulator.states(point, world, seconds)
    times_s = np.arange(0.0, len(states) * simulator.control_step_s, 1.0 / film.rate_hz)
    width, height = film.size_px
    model.vis.global_.offwidth = width
    model.vis.global_.offheight = height
    data = mujoco.MjData(model)
    try:
        renderer = mujoco.Renderer(model, height, width)
    except Exception as error:  # each of the libraries below has its own
        raise InputError("film", one_line(shortened(str(error))), NO_OPENGL) from None
    with renderer:
        for time_s in times_s:
            data.qpos[:] = states[int(time_s / simulator.control_step_s)]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera=0 if model.ncam else -1)
            yield renderer.render().tobytes()


def _write(path: str | Path, pictures: Iterator[bytes], film: Film) -> Path:
    """The film of these frames, whole or not at all."""
    path = Path(path)
    commit(path, lambda new: new.write_bytes(encoded(pictures, film)), lambda new: None)
    return path


def encoded(pictures: Iterator[bytes], film: Film) -> bytes:
    """An MP4 of RGB frames.

    Raises:
        InputError: no ffmpeg that works.
    """
    width, height = film.size_px
    options = OPTIONS.format(width=width, height=height, film=film)
    # Not through a pipe: the index is put first when the film is whole.
    with tempfile.NamedTemporaryFile(suffix=".mp4") as file:
        command = [find_ffmpeg(), *options.split(), file.name]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stderr=subprocess.PIPE
        ) as process:
            assert process.stdin is not None and process.stderr is not None
            try:
                # Its exit code tells why it ended.
                with suppress(BrokenPipeError), process.stdin:
                    for picture in pictures:
                        process.stdin.write(picture)
                complaint = process.stderr.read().decode(errors="replace").strip()
            except BaseException:
                process.kill()
                raise
        if process.returncode != 0 or not (content := file.read()):
            lines = complaint.splitlines() or [f"exit code {process.returncode}"]
            raise InputError("ffmpeg", lines[-1], FIXING)
    return content
