"""Pictures of a gait: a strip of stick figures, a gait cycle beside human ranges, a film.

Importing this package imports matplotlib (its object-oriented interface with the Agg
canvas only) and, for the film, Pillow, which comes with it.
"""

from study.pictures.gait_cycle import write_gait_cycle
from study.pictures.movie import find_ffmpeg, write_movie, write_movies
from study.pictures.scene import LARGE, SMALL, Film
from study.pictures.strip import write_strip

__all__ = [
    "LARGE",
    "SMALL",
    "Film",
    "find_ffmpeg",
    "write_gait_cycle",
    "write_movie",
    "write_movies",
    "write_strip",
]
