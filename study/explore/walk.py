"""One walk for the page, in a process beside it: its body, ground and world, and its frames."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib
import numpy as np
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from study.experiment.experiment import Experiment, as_written, experiment_of
from study.experiment.gains import NamedGains, gains_of_source, recorded_walk
from study.experiment.trials import row_text
from study.explore.words import CHOICES
from study.pictures import style
from study.pictures.movie import write_movie
from study.pictures.scene import FORCE_M_PER_N, motion_of, pressure_point
from study.pictures.stick_figure import LEFT, RIGHT, finite, leg, muscle_paths, trunk
from taichi_nmm.config import Table
from taichi_nmm.result import (
    COMPLETED,
    DIVERGED,
    END_REASONS,
    FALL_HEIGHT_M,
    FALL_LEAN_RAD,
    Trajectory,
)
from taichi_nmm.terrain import GRID_SPACING_M, Terrain

GROUNDS: dict[str, dict[str, Any]] = CHOICES["grounds"]
WORLDS: dict[str, dict[str, list[float]]] = CHOICES["worlds"]
DISTURBANCES: dict[str, float] = CHOICES["disturbances"]
LASTS_S: dict[str, float] = CHOICES["lasts_s"]  # by the kind of ground
DURATIONS = ("5 s", "10 s", "20 s", "40 s", "100 s")
NAME = "walk"  # of the configuration


def chosen_setting(
    ground: str, disturbance: str, seed: int, world: str, engine: str, duration_s: float
) -> Experiment:
    """The experiment of the page's choices, by the names above; run 0 walks.

    Raises:
        InputError: a seed out of its bounds.
    """
    tables = {
        "seed": seed,
        "simulation": {"duration_s": duration_s, "engine": engine},
        "body": {"disturbance": DISTURBANCES[disturbance]},
        "terrain": GROUNDS[ground],
        "world": WORLDS[world],
    }
    return experiment_of(Table(tables), NAME)


def to_toml(tables: dict[str, Any], name: str = "") -> str:
    """Plain values as TOML, in which they look as in JSON; tables come last."""
    inner = {key: value for key, value in tables.items() if isinstance(value, dict)}
    lines = [f"[{name}]"] if name else []
    lines += [f"{key} = {json.dumps(value)}" for key, value in tables.items() if key not in inner]
    texts = [to_toml(value, f"{name}.{key}".lstrip(".")) for key, value in inner.items()]
    return "\n".join(["\n".join(lines) + "\n", *texts])


RATE_HZ = 30
BEFORE_M, BEYOND_M = 4.0, 6.0  # of ground, drawn beyond the hip's first and last place
COLOURS = [to_hex(each) for each in matplotlib.colormaps[style.ACTIVATION_MAP](np.arange(256))]


Frames = dict[str, NDArray[Any]]


def frames_of(trajectory: Trajectory, terrain: Terrain) -> Frames:
    """All of a walk in f frames, as far as its poses are finite; points are x and z in metres.

    Returns:
        time_s: [f].
        camera_m: where the hip is, and the ground there, smoothed, [f, 2].
        near, far: hip, knee, ankle, heel and ball of the left and the right leg, [f, 5, 2].
        trunk: hip and shoulder, [f, 2, 2].
        head: its centre, [f, 1, 2].
        height_m: of the hip over the ground, [f].
        muscles: lines along which they run, left leg then right, [f, 14, p, 2].
        activation: of these, in 255ths, [f, 14].
        forces: foot and tip of the arrow of the ground's force, left and right, [f, 2, 2, 2].
        ground: profile, [k, 2].

    Raises:
        InputError: no pose is finite.
    """
    shown = finite(trajectory)
    motion = motion_of(shown, terrain, float(shown.time_s[-1]), RATE_HZ)
    q = motion.q
    shoulder, head = trunk(q)
    feet = [pressure_point(q, side) for side in (LEFT, RIGHT)]
    pushes = [FORCE_M_PER_N * motion.force_n[:, 2 * side : 2 * side + 2] for side in (LEFT, RIGHT)]
    arrows = [
        np.stack([foot, foot + push], axis=1) for foot, push in zip(feet, pushes, strict=True)
    ]
    paths = [*muscle_paths(q, LEFT), *muscle_paths(q, RIGHT)]
    x = np.arange(q[:, 0].min() - BEFORE_M, q[:, 0].max() + BEYOND_M, GRID_SPACING_M)
    drawn = {
        "time_s": motion.time_s,
        "camera_m": np.stack([q[:, 0], motion.level_m], axis=1),
        "height_m": q[:, 1] - terrain.height(q[:, 0]),
        "near": leg(q, LEFT).chain(),
        "far": leg(q, RIGHT).chain(),
        "trunk": np.stack([q[:, :2], shoulder], axis=1),
        "head": head[:, None],
        "muscles": np.stack(paths, axis=1),
        "forces": np.stack(arrows, axis=1),
        "ground": np.stack([x, terrain.height(x)], axis=1),
    }
    activation = np.clip(255.0 * motion.activation, 0, 255).astype(np.uint8)
    sent = {name: np.ascontiguousarray(part, dtype=np.float32) for name, part in drawn.items()}
    return sent | {"activation": activation}


SEEN_RATE_HZ = 100.0  # a sample costs as much as ten steps; enough for a gait cycle


@dataclass(frozen=True, eq=False)
class Walk:
    """A walk that was simulated."""

    gains: NamedGains
    experiment: Experiment  # its run 0: the robot and its ground
    row: np.void  # of the simulator's result
    trajectory: Trajectory  # of the whole walk
    frames: Frames  # for the page to draw
    ended: str  # how the walk ended, and why, in words


def walk(gains: NamedGains, experiment: Experiment) -> Walk:
    """Simulate, and prepare what is drawn.

    Raises:
        InputError: what the simulator refuses.
    """
    alone = experiment.on_one_thread()  # other tabs' walks run beside this one
    result = recorded_walk(gains, alone.with_settings(arch="cpu"), 0, SEEN_RATE_HZ)
    row, trajectory, terrain = result.rows[0], result.trajectories[0], experiment.terrain(0)
    ended = f"{row_text(row)}{_why(row, trajectory, terrain)}"
    return Walk(gains, experiment, row, trajectory, frames_of(trajectory, terrain), ended)


def _why(row: np.void, trajectory: Trajectory, terrain: Terrain) -> str:
    """Why a walk was not completed: the bound of a fall that its last pose exceeds."""
    if row["end_reason"] == COMPLETED:
        return ""
    if row["end_reason"] == DIVERGED:
        return f": the simulation {END_REASONS[DIVERGED]}"
    last: NDArray[np.float64] = finite(trajectory).q[-1]
    lean, height_m = float(last[2]), float(last[1] - terrain.height(last[0]))
    if abs(lean) / FALL_LEAN_RAD > FALL_HEIGHT_M / max(height_m, 1e-6):
        way = "forward" if lean > 0 else "backward"
        return f": the trunk leaned {way} beyond {math.degrees(FALL_LEAN_RAD):.0f} deg"
    return f": the hip sank to {FALL_HEIGHT_M:g} m over the ground"


def warm_up() -> None:
    """Compile the kernels before the first gait is asked for."""
    level = chosen_setting("flat", "nominal", 0, "nominal", "taichi", 0.1)
    walk(gains_of_source("reference"), level)


FILM = "walk.mp4"  # of its last 8 s
GAINS, CONFIG = NAMES = "gains.json", "walk.toml"  # what every command takes: --gains, --config
# What does the same without a page, in a folder with both files.
COMMAND = f"taichi-nmm walk --gains {GAINS} --config {CONFIG} --trajectory walk.sto"


def file_of_walk(walk: Walk, name: str) -> tuple[str, bytes]:
    """One of `NAMES` or `FILM` and its content, to be taken from the page."""
    if name == FILM:
        with TemporaryDirectory() as folder:
            path, terrain = Path(folder) / name, walk.experiment.terrain(0)
            write_movie(path, walk.trajectory, terrain, title=walk.gains.name)
            return name, path.read_bytes()
    if name == CONFIG:
        return name, to_toml(as_written(walk.experiment)).encode()
    return name, f"{json.dumps(walk.gains.as_document(), indent=1)}\n".encode()
