"""The picture of one walk, and its film where it gets one: a unit of work for any pool."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.pictures import SMALL, write_movie, write_strip
from taichi_nmm.result import Trajectory
from taichi_nmm.terrain import Terrain

STRIP, FILM = "strip", "film"
STRIP_DPI = 100
FILM_S = 8.0


@dataclass(frozen=True, eq=False)
class Drawing:
    """What is drawn at a time: a walk, where its files go, and the encoder's program.

    Without a place for it there is no film.
    """

    trajectory: Trajectory
    terrain: Terrain
    title: str
    strip: Path
    film: Path | None
    program: str


def draw(drawing: Drawing) -> bool:
    """Draw what is not there yet.

    Returns:
        Whether there was anything to draw: a walk that diverged before its first sample has none.

    Raises:
        InputError: a file cannot be written, or the encoder failed.
    """
    if not np.isfinite(drawing.trajectory.q).all(axis=1).any():
        return False
    walk = (drawing.trajectory, drawing.terrain)
    if not drawing.strip.exists():
        write_strip(drawing.strip, *walk, drawing.title, STRIP_DPI)
    if drawing.film is not None and not drawing.film.exists():
        write_movie(drawing.film, *walk, FILM_S, drawing.title, film=SMALL, program=drawing.program)
    return True
