"""Pictures and films drawn by all cores."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.pictures import SMALL, write_movie, write_strip
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import Terrain

STRIP, FILM = "strip", "film"
STRIP_DPI = 100
FILM_S = 8.0
TASKS_PER_PROCESS = 4  # to start one takes about as long as to draw these

Draw = Callable[[Iterable["Task"]], Iterator[bool]]


@dataclass(frozen=True, eq=False)
class Task:
    """What one process draws at a time: a walk, where its files go, and the encoder's program."""

    trajectory: Trajectory
    terrain: Terrain
    title: str
    strip: Path
    film: Path
    program: str


@contextmanager
def drawers(workers: int | None, tasks: int) -> Iterator[Draw]:
    """A function that draws tasks, and says of each, when it is done, whether there was a picture.

    Args:
        workers: processes; None is one a core, 1 draws in this process.
        tasks: how many will come; for a few no process is started.

    Raises:
        InputError: a file cannot be written, or the encoder failed.
    """
    count = min(workers or os.cpu_count() or 1, tasks // TASKS_PER_PROCESS)
    if count <= 1:
        yield lambda batch: map(_draw, batch)
        return
    # Not forked: the simulator's threads would not survive it.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_follow_parent)
    try:
        yield lambda batch: pool.map(_draw, batch)
    finally:
        pool.shutdown(cancel_futures=True)


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, and end when it does, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _draw(task: Task) -> bool:
    """Whether there was anything to draw: a walk that diverged before its first sample has none."""
    if not np.isfinite(task.trajectory.q).all(axis=1).any():
        return False
    walk = (task.trajectory, task.terrain)
    if not task.strip.exists():
        write_strip(task.strip, *walk, task.title, STRIP_DPI)
    if not task.film.exists():
        write_movie(task.film, *walk, FILM_S, task.title, film=SMALL, program=task.program)
    return True
