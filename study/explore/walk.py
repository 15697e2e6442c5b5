"""One walk for the page, in a process beside it: its body, ground and world, and its frames."""

import json
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib
import numpy as np
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from storage.inputs.config import Table, laid_over, to_toml
from storage.inputs.errors import InputError
from study.experiment.gains import NamedGains, gains_of_source, recorded_walk
from study.experiment.walker import (
    WalkerExperiment,
    as_written,
    experiment_of,
    row_text,
)
from study.explore.words import CHOICES, Tables
from study.pictures import style, write_gait_cycle, write_strip
from study.pictures.fall import fall_text
from study.pictures.gait_cycle import STRIKE, event_times
from study.pictures.movie import encoded
from study.pictures.scene import LARGE, force_arrows, frames, motion_of
from study.pictures.stick_figure import (
    LEFT,
    RIGHT,
    finite,
    gone_muscles,
    leg,
    muscle_paths,
    trunk,
)
from study.pictures.trajectory_files import (
    FORMATS,
    RECORD_RATE_HZ,
    kept,
    require_trajectory_file,
    write_trajectory,
)
from taichi_nmm.result import Result, Trajectory
from taichi_nmm.settings import ENGINES
from taichi_nmm.terrain import GRID_SPACING_M, Terrain

GROUNDS: dict[str, Tables] = CHOICES["grounds"]
WORLDS: dict[str, dict[str, list[float]]] = CHOICES["worlds"]
DISTURBANCES: dict[str, float] = CHOICES["disturbances"]
LASTS_S: dict[str, float] = CHOICES["lasts_s"]  # by the kind of ground
DURATIONS = ("5 s", "10 s", "20 s", "40 s", "100 s")
OWN = "as in the study"
NAME = "walk"  # of the configuration
NONE: Tables = {}
CHANGED = {"body", "terrain", "world", "simulation"}  # what may be laid over a setting


def chosen_robot(disturbance: str, world: str, own: Tables) -> Tables:
    """The tables `body` and `world` of the page's choices, as `chosen_setting` takes them."""
    masses = {"disturbance": DISTURBANCES.get(disturbance)}
    return {
        "body": own["body"] if disturbance == OWN else masses,
        "world": own.get("world", {}) if world == OWN else WORLDS[world],
    }


def chosen_setting(
    *,
    ground: str,
    disturbance: str,
    seed: int,
    world: str,
    engine: str,
    duration_s: float,
    own: Tables = NONE,
    files: Tables = NONE,
    changes: Tables = NONE,
) -> WalkerExperiment:
    """The experiment of the page's choices, by the names above; its last run walks.

    `OWN` takes the ground, the masses or the world of a study, whose document is `own`.
    Of the same engine, other settings of the simulation are the study's, too. Grounds
    may also be `files`, by their names; `changes` are laid over all of it.

    Raises:
        InputError: a seed or a change out of its bounds, or a document of another
            version.
    """
    if other := sorted({*changes} - CHANGED):
        raise InputError("what if", other[0], f"tables {', '.join(sorted(CHANGED))}")
    simulation = own.get("simulation", {})
    if simulation.get("engine", ENGINES[0]) != engine:
        simulation = {"engine": engine}
    tables = {
        "seed": seed,
        "runs": own.get("run", 0) + 1,
        "simulation": {**simulation, "duration_s": duration_s},
        "terrain": own["ground"] if ground == OWN else {**GROUNDS, **files}[ground],
        **chosen_robot(disturbance, world, own),
    }
    return experiment_of(Table(laid_over(tables, dict(changes))), NAME)


RATE_HZ = 30
BEFORE_M, BEYOND_M = 4.0, 6.0  # of ground, drawn beyond the hip's first and last place
COLOURS = [
    to_hex(each) for each in matplotlib.colormaps[style.ACTIVATION_MAP](np.arange(256))
]
Frames = dict[str, NDArray[Any]]


def frames_of(trajectory: Trajectory, terrain: Terrain) -> Frames:
    """All of a walk in f frames, as far as its poses are finite; points are x and z in metres.

    Activation is in 255ths, [f, 14].

    Raises:
        InputError: no pose is finite.
    """
    shown = finite(trajectory)
    motion = motion_of(shown, terrain, float(shown.time_s[-1]), RATE_HZ)
    q = motion.q
    shoulder, head = trunk(q)
    paths = np.stack([*muscle_paths(q, LEFT), *muscle_paths(q, RIGHT)], axis=1)
    paths[:, gone_muscles(motion.prosthesis)] = np.nan
    x = np.arange(q[:, 0].min() - BEFORE_M, q[:, 0].max() + BEYOND_M, GRID_SPACING_M)
    drawn = {
        "time_s": motion.time_s,
        # Hip, and ground, smoothed, [f, 2]:
        "camera_m": np.stack([q[:, 0], motion.level_m], axis=1),
        # Of the hip over the ground, [f]:
        "height_m": q[:, 1] - terrain.height(q[:, 0]),
        # Hip, knee, ankle, heel and ball of the left leg, and of the right, [f, 5, 2]:
        "near": leg(q, LEFT).chain(),
        "far": leg(q, RIGHT).chain(),
        "trunk": np.stack([q[:, :2], shoulder], axis=1),  # hip and shoulder, [f, 2, 2]
        "head": head[:, None],
        # Their lines, left leg, then right, [f, 14, p, 2]:
        "muscles": paths,
        # Foot and tip: left, right, a push, [f, 3, 2, 2].
        "forces": force_arrows(motion),
        "ground": np.stack([x, terrain.height(x)], axis=1),  # [k, 2]
        "strikes_s": event_times(trajectory, LEFT, STRIKE),
        "prosthesis": motion.prosthesis,  # of the left leg, and of the right, [2]
        "slip": trajectory.slip,  # as there, [3]
        **(vars(motion.device) if motion.device else {}),
    }
    activation = np.clip(255.0 * motion.activation, 0, 255).astype(np.uint8)
    sent = {
        name: np.ascontiguousarray(part, dtype=np.float32)
        for name, part in drawn.items()
    }
    return sent | {"activation": activation}


SEEN_RATE_HZ = 100.0  # a sample costs as much as ten steps; enough for a gait cycle


@dataclass(frozen=True, eq=False)
class Walk:
    """A walk that was simulated.

    Attributes:
        gains: that walked.
        experiment: whose simulation and settings they walked in.
        run: of the experiment: the robot and its ground.
        row: of the simulator's result.
        trajectory: of the whole walk, 100 samples a second.
        frames: for the page to draw.
        ended: how the walk ended, and why, in words.
    """

    gains: NamedGains
    experiment: WalkerExperiment
    run: int
    row: np.void
    trajectory: Trajectory
    frames: Frames
    ended: str


def walk(gains: NamedGains, experiment: WalkerExperiment) -> Walk:
    """Simulate on the last run of an experiment, and prepare what is drawn.

    Raises:
        InputError: what the simulator refuses.
    """
    run = experiment.runs - 1
    result = _alone(gains, experiment, run, SEEN_RATE_HZ)
    row, trajectory = result.rows[0], result.trajectories[0]
    terrain = experiment.terrain(run)
    return Walk(
        gains=gains,
        experiment=experiment,
        run=run,
        row=row,
        trajectory=trajectory,
        frames=frames_of(trajectory, terrain),
        ended=f"{row_text(row)}{fall_text(row, trajectory, terrain)}",
    )


def _alone(
    gains: NamedGains, experiment: WalkerExperiment, run: int, rate_hz: float
) -> Result:
    """On one thread, beside walks of other tabs."""
    plain = experiment.on_one_thread().with_settings(arch="cpu")
    return recorded_walk(gains, plain, run, rate_hz)


def recorded(walk: Walk, number: int) -> tuple[Trajectory, int]:
    """A walk again, as the command `walk` records it, and the number that was given."""
    result = _alone(walk.gains, walk.experiment, walk.run, RECORD_RATE_HZ)
    return kept(result.trajectories[0]), number


def warm_up() -> None:
    """Compile the kernels before the first gait is asked for."""
    level = chosen_setting(
        ground="flat",
        disturbance="nominal",
        seed=0,
        world="nominal",
        engine=ENGINES[0],
        duration_s=0.1,
    )
    walk(gains_of_source("reference"), level)


FILM = "walk.mp4"
FILM_S = 8.0  # of the walk's end
GAINS, CONFIG = "gains.json", "walk.toml"
NAMES = (GAINS, CONFIG)  # what every command takes: --gains, --config
RECORDINGS = tuple(f"walk{ending}" for ending in FORMATS)
STRIP, CYCLE = "strip.png", "gait_cycle.png"
PICTURES = (STRIP, CYCLE)
FILES = (*NAMES, FILM, *RECORDINGS, *PICTURES)
# What does the same without a page, in a folder with both files.
COMMAND = f"taichi-nmm walk --gains {GAINS} --config {CONFIG} --trajectory walk.sto"


def file_of_walk(walk: Walk, name: str) -> tuple[str, bytes]:
    """A file by its name above, and its content, to be taken from the page.

    Recordings and pictures have the bytes of the command's.
    """
    terrain = walk.experiment.terrain(walk.run)
    if name == GAINS:
        return name, f"{json.dumps(walk.gains.as_document(), indent=1)}\n".encode()
    if name == CONFIG:
        tables = {"runs": walk.run + 1, **as_written(walk.experiment)}
        return name, to_toml(tables).encode()
    if name == FILM:
        pictures = frames(walk.trajectory, terrain, FILM_S, walk.gains.name)
        return name, encoded(pictures, LARGE)
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        if name in RECORDINGS:
            require_trajectory_file(path)  # before the work
        trajectory, _ = recorded(walk, 0)
        title = f"{walk.gains.name} on {terrain.name}: {row_text(walk.row)}"
        if name == STRIP:
            write_strip(path, trajectory, terrain, title)
        elif name == CYCLE:
            weight_n = walk.experiment.weight_n(walk.run)
            write_gait_cycle(path, trajectory, weight_n, title)
        else:
            world = walk.experiment.world(walk.run)
            write_trajectory(path, trajectory, walk.gains.name, world)
        return name, path.read_bytes()
