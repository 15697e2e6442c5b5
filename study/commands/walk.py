"""Simulate one controller, and draw how it walks."""

import hashlib
import json
import sys
import tempfile
from argparse import Namespace
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

import taichi_nmm
from storage.commit import commit_text, require_folder, writable
from storage.inputs import checks
from storage.inputs.errors import InputError
from storage.store import open_store
from study.experiment.features import WORLDS, feature_table, front_of
from study.experiment.gains import (
    SPEED_TOLERANCE_MPS,
    TRIAL,
    NamedGains,
    gains_of_row,
    gains_of_source,
    gains_of_trial,
    has_worlds_of,
    recorded_walk,
    row_at_speed,
)
from study.experiment.walker import (
    OUTCOMES,
    WalkerExperiment,
    as_written,
    read_experiment,
    row_text,
)
from study.options import BOTH_ENGINES, require_used
from study.pictures import (
    find_ffmpeg,
    strip,
    style,
    write_gait_cycle,
    write_movies,
    write_strip,
)
from study.pictures.fall import fall_text
from study.pictures.trajectory_files import (
    RECORD_RATE_HZ,
    kept,
    require_trajectory_file,
    write_opensim,
    write_trajectory,
)
from study.report.people import FURTHER, QUANTITIES, not_human
from taichi_nmm.conditions import LONGEST_TRIAL_S, SHORTEST_TRIAL_S
from taichi_nmm.mujoco_engine import require_mujoco
from taichi_nmm.result import (
    ENERGY,
    FURTHER_FIELDS,
    OF_MUSCLES,
    Trajectory,
    known_numbers,
)
from taichi_nmm.settings import ENGINES
from taichi_nmm.terrain import Terrain
from taichi_nmm.walker_simulator import require_engine
from taichi_nmm.world import require_begun

# Pictures by their names, in their folder.
FILES = {
    "strip": "strip.png",
    "gait_cycle": "gait_cycle.png",
    "movie": "movie.mp4",
    "strips": "strips.png",
}
DIGEST_LENGTH = 8  # of a folder's name: two walks of a million have the same
MUSCLES_ALONE = (
    "{} lacks {}, the energy with that of the motors: the row spends least with its muscles alone; "
    "compute the store anew, or ask for that by name: --least {}"
)
LONGEST_MOVIE_S = 120.0
# Options, of which one may name the controller, and the one that it needs beside it.
CHOICES = {"gains": None, "row": "store", "speed": "store", "trial": "storage"}
REPORTED = (
    *OUTCOMES,
    ENERGY,
    "step_count",
    "phi_printed",
    "phi_corrected",
    *dict(FURTHER_FIELDS),
)
COLUMN = 14  # characters
BEFORE, AFTER = "before", "after"  # of two gaits
# Options that it uses.
OF_THE_FRONT = ("--front", "--store", "--config", "--arch", "--json")


def find_gains(args: Namespace) -> NamedGains:
    """The controller that the options name."""
    given = [name for name in CHOICES if getattr(args, name) is not None]
    if len(given) > 1:
        raise InputError(given[1], getattr(args, given[1]), f"none beside --{given[0]}")
    kind = given[0] if given else "gains"
    beside = CHOICES[kind]
    for where, kinds in (("store", ("row", "speed")), ("storage", ("trial",))):
        is_there = getattr(args, where) is not None
        if is_there != (where == beside):
            needing = kinds[0] if is_there else kind
            missing = needing if is_there else where
            allowed = f"a value: --{needing} and --{where} belong together"
            raise InputError(missing, None, allowed)
    if args.least is not None and kind != "speed":
        raise InputError("least", args.least, "none without --speed")
    if kind == "speed":
        speeds = checks.each(checks.number(0.0))("speed", args.speed)
        least = args.least or priced(args.store)
        rows = [row_at_speed(args.store, speed, least) for speed in speeds]
        first, *later = (gains_of_row(args.store, row) for row in rows)
        return replace(first, later=tuple(later))
    if kind == "row":
        return gains_of_row(args.store, args.row)
    if kind == "trial":
        return gains_of_trial(args.trial, args.storage)
    return gains_of_source(args.gains or "reference")


def before_of(args: Namespace) -> NamedGains:
    """The controller that is shown as before: by name, of a file, or another trial of --storage.

    Raises:
        InputError: none of these, or one beside two engines or several speeds.
    """
    if args.engine == BOTH_ENGINES or len(args.speed or ()) > 1:
        raise InputError("before", args.before, "none beside two engines or speeds")
    if TRIAL.fullmatch(args.before) and args.storage is not None:
        return gains_of_trial(args.before, args.storage)
    return gains_of_source(args.before)


def priced(store: Path) -> str:
    """What a row of a store is to have the least of; a line is printed where that lacks motors."""
    if has_worlds_of(open_store(store), ENERGY):
        return ENERGY
    lacking = MUSCLES_ALONE.format(store, ENERGY, OF_MUSCLES)
    print(f"warning: {lacking}", file=sys.stderr)
    return OF_MUSCLES


def folder_of(gains: NamedGains, experiment: WalkerExperiment, args: Namespace) -> Path:
    """Where a walk's pictures are put if nobody says: the name depends on all that makes it."""
    walk = {
        "gains": [each.as_document() for each in (gains, *gains.later)],
        "experiment": as_written(experiment),
        "run": args.run,
        "engine": args.engine,
        "version": taichi_nmm.__version__,
    }
    if args.before is not None:
        walk["before"] = before_of(args).as_document()
    digest = hashlib.sha256(json.dumps(walk, sort_keys=True).encode()).hexdigest()
    return Path("out") / "walk" / f"{gains.name}-{digest[:DIGEST_LENGTH]}"


def read(args: Namespace) -> WalkerExperiment:
    """The experiment, with the duration and the engine of the options."""
    experiment = read_experiment(args.config, args.arch, args.seed)
    experiment.require_run(args.run)
    if args.duration is not None:
        require_begun(experiment.world(args.run), args.duration)
        conditions = replace(experiment.conditions, duration_s=args.duration)
        experiment = replace(experiment, conditions=conditions)
    if args.engine is None:
        return experiment
    first = ENGINES[0] if args.engine == BOTH_ENGINES else args.engine
    return experiment.with_settings(engine=first)


def warn_of_elsewhere(args: Namespace, experiment: WalkerExperiment) -> None:
    """Say where trials were made that walk somewhere else now: their numbers are others."""
    if not args.storage:
        return
    here = f"{experiment.name}, run {args.run}"
    for field in ("trial", "before"):
        named = TRIAL.fullmatch(getattr(args, field) or "")
        if named is None:
            continue
        made = f"{named[1]}, run {int(named[3])}"
        if made != here:
            line = f"{field}: made in {made}, and walks in {here}"
            print(f"warning: {line} (--config, --run)", file=sys.stderr)


def warn_of_speed(args: Namespace, result: taichi_nmm.Result) -> None:
    """Say if a walk misses the speed that its row has in the store, whose worlds are others."""
    speeds: list[float] = [*(args.speed or [])]
    if len(speeds) != 1:
        return
    found = known_numbers(result.rows[0])["mean_speed_mps"]
    if found is not None and abs(found - speeds[0]) > SPEED_TOLERANCE_MPS:
        line = f"the row has {speeds[0]:g} m/s in the store, and {found:.2f} here"
        print(f"warning: speed: {line}", file=sys.stderr)


def simulate(
    gains: NamedGains, experiment: WalkerExperiment, run: int
) -> taichi_nmm.Result:
    """The one walk, recorded."""
    total_s = experiment.conditions.duration_s
    with tqdm(total=total_s, unit="s", desc="walking", disable=None) as bar:
        walked = recorded_walk(
            gains,
            experiment,
            run,
            RECORD_RATE_HZ,
            lambda done_s, _: bar.update(done_s - bar.n),
        )
    return replace(walked, trajectories=tuple(map(kept, walked.trajectories)))


def write_model(path: Path, experiment: WalkerExperiment, run: int) -> None:
    """MuJoCo's model of a run's body and ground, standing where the walk starts."""
    from taichi_nmm.mujoco_engine.engine import start_state
    from taichi_nmm.mujoco_engine.mjcf import mjcf_text

    terrain, settings = experiment.terrain(run), experiment.conditions.settings
    body, world = experiment.body(run), experiment.world(run)
    text = mjcf_text(body, world, terrain, settings, start_state(terrain))
    with writable(path, "mjcf"):
        path.parent.mkdir(parents=True, exist_ok=True)
    commit_text(path, text, "mjcf")


def write_pictures(
    walks: Mapping[str, taichi_nmm.Result],
    drawn: str,
    experiment: WalkerExperiment,
    args: Namespace,
    folder: Path,
    name: str,
    before: str,
) -> dict[str, str]:
    """Draw, and return the paths of the pictures by their names.

    Args:
        walks: by engine, or `BEFORE` and `AFTER`; two are compared.
        drawn: that of them which has the other pictures.
        experiment: in which they walked.
        args: of the command.
        folder: of the pictures.
        name: of the controller and the ground.
        before: of the controller that is shown as before; "": there is none.
    """
    result = walks[drawn]
    trajectory = result.trajectories[0]
    terrain = experiment.terrain(args.run)
    weight_n = experiment.weight_n(args.run)
    title = f"{name}: {row_text(result.rows[0])}"
    files = {shows: folder / name for shows, name in FILES.items()}
    for file in files.values():
        # Of an earlier walk: if we are stopped, none stays beside ours.
        file.unlink(missing_ok=True)
    paths = [
        write_strip(files["strip"], trajectory, terrain, title),
        write_gait_cycle(files["gait_cycle"], trajectory, weight_n, title),
    ]
    shown = [
        strip.Shown(
            label=by,
            title=f"{by}: {row_text(walk.rows[0])}",
            trajectory=walk.trajectories[0],
        )
        for by, walk in walks.items()
    ]
    if args.movie_seconds > 0:
        filmed = [(trajectory, title)]
        if before:
            names = (before, name)
            filmed = [
                (each.trajectory, f"{of}, {each.title}")
                for of, each in zip(names, shown, strict=True)
            ]
        paths.append(write_movies(files["movie"], filmed, terrain, args.movie_seconds))
    if len(walks) > 1:
        compared = f"{name}, run {args.run}: two engines"
        if before:
            compared = f"{before}, then {name}, run {args.run}"
        figure = strip.strips_figure(shown, terrain, compared)
        paths.append(style.save_png(figure, files["strips"]))
    return {path.stem: str(path) for path in paths}


def ended(walk: taichi_nmm.Result, terrain: Terrain) -> str:
    """How a walk ended; of a fall, which way and what came before it."""
    row = walk.rows[0]
    return f"{row_text(row)}{fall_text(row, walk.trajectories[0], terrain)}"


def summary(
    name: str,
    walks: Mapping[str, taichi_nmm.Result],
    terrain: Terrain,
    mass_kg: float,
) -> str:
    """For people: how the walk of each engine ended, a line each number, and what is not human."""
    lines = [f"{name}, {by}: {ended(walk, terrain)}" for by, walk in walks.items()]
    quantities = (*QUANTITIES, *FURTHER)
    wide = max(len(each.label) for each in quantities)
    lines.append(
        " " * wide + "".join(name.rjust(COLUMN) for name in (*walks, "people"))
    )
    known = [
        known_numbers(walk.rows[0]) | {"mass_kg": mass_kg} for walk in walks.values()
    ]
    for each in quantities:
        shown = [each.text(each.value(values)) for values in known]
        cells = (*shown, each.range_text)
        lines.append(
            each.label.ljust(wide) + "".join(cell.rjust(COLUMN) for cell in cells)
        )
    for by, values in zip(walks, known, strict=True):
        lines += [f"not human, {by}: {word}" for word in not_human(values)]
    return "\n".join(lines)


def report(
    gains: NamedGains,
    walk: taichi_nmm.Result,
    terrain: Terrain,
    mass_kg: float,
    paths: dict[str, str],
) -> dict[str, Any]:
    """The same for programs: one object of plain values; null: unknown."""
    numbers = known_numbers(walk.rows[0])
    return {
        **{field: numbers[field] for field in REPORTED},
        "mass_kg": mass_kg,
        "not_human": not_human(numbers),
        "end_reason": str(walk.end_reason[0]),
        "ended": ended(walk, terrain),
        "gains": gains.as_document(),
        "pictures": paths,
    }


def show_front(args: Namespace, experiment: WalkerExperiment) -> None:
    """List the rows of a store that no other beats in the two goals of an experiment.

    Raises:
        InputError: no store, or no two goals.
    """
    goals = [goal.name for goal in experiment.objective.goals]
    if args.store is None:
        raise InputError("store", None, "a value: --front lists rows of a store")
    if not goals:
        raise InputError("front", experiment.name, "a configuration with two goals")
    store = open_store(args.store)
    table = feature_table(store, WORLDS, experiment.space, experiment.objective)
    names = ["row", *goals]
    rows = [dict(zip(names, row, strict=True)) for row in front_of(table)]
    if args.json:
        print(json.dumps(rows))
        return
    print("".join(name.rjust(COLUMN) for name in names))
    for row in rows:
        means = "".join(f"{row[goal]:{COLUMN}.4g}" for goal in goals)
        print(f"{row['row']:{COLUMN}}{means}")


def main(args: Namespace) -> None:
    """Walk and draw."""
    if args.front:
        require_used(args, OF_THE_FRONT, "--front")
        show_front(args, read(args))
        return
    gains = find_gains(args)
    before = None if args.before is None else before_of(args)
    if args.duration is not None:
        checks.number(SHORTEST_TRIAL_S, LONGEST_TRIAL_S)("duration", args.duration)
    checks.number(0.0, LONGEST_MOVIE_S)("movie-seconds", args.movie_seconds)
    experiment = read(args)
    warn_of_elsewhere(args, experiment)
    folder = prepared_folder(gains, experiment, args)
    engines = [experiment.conditions.settings.engine]
    if args.engine == BOTH_ENGINES:
        engines = [*ENGINES]
    walks = {
        engine: simulate(gains, experiment.with_settings(engine=engine), args.run)
        for engine in engines
    }
    drawn = engines[0]
    if before is not None:
        after = walks.pop(drawn)
        drawn = AFTER
        walks = {BEFORE: simulate(before, experiment, args.run), AFTER: after}
    result = walks[drawn]
    warn_of_speed(args, result)
    terrain = experiment.terrain(args.run)
    mass_kg = float(experiment.body(args.run).mass_kg.sum())
    name = f"{gains.name} on {terrain.name}"
    then = "" if before is None else before.name
    paths = write_pictures(walks, drawn, experiment, args, folder, name, before=then)
    paths |= write_files(result.trajectories[0], gains.name, experiment, args)
    if args.json:
        print(json.dumps(report(gains, result, terrain, mass_kg, paths)))
        return
    heading = f"{then}, then {name}" if then else name
    print(summary(heading, walks, terrain, mass_kg))
    for shows, path in paths.items():
        print(f"{shows.replace('_', ' '):<19} {path}")


def prepared_folder(
    gains: NamedGains, experiment: WalkerExperiment, args: Namespace
) -> Path:
    """The folder of the pictures, once nothing is in the way of the walk and its files."""
    is_compared = args.engine == BOTH_ENGINES
    made = {"strip", "gait_cycle"}
    if args.movie_seconds > 0:
        find_ffmpeg()
        made.add("movie")
    if is_compared or args.before is not None:
        made.add("strips")
    require_engine(experiment.conditions.settings)
    if is_compared or args.mjcf is not None:
        require_mujoco()
    folder: Path = args.out or folder_of(gains, experiment, args)
    others = [name for shows, name in FILES.items() if shows not in made]
    found = [str(folder / name) for name in others if (folder / name).exists()]
    if found and args.out is not None:
        allowed = (
            "a folder without it: this walk makes none, and that one may be of another"
        )
        raise InputError("out", found[0], allowed)
    for file in args.trajectory:
        require_trajectory_file(file)
    if args.opensim is not None:
        require_folder(args.opensim, "opensim")
    if args.mjcf is not None:
        write_model(args.mjcf, experiment, args.run)
    with writable(folder):  # before the work
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    return folder


def write_files(
    trajectory: Trajectory, name: str, experiment: WalkerExperiment, args: Namespace
) -> dict[str, str]:
    """Write a walk for other programs; the paths of all such files, by their kinds."""
    paths = {}
    world = experiment.world(args.run)
    if args.mjcf is not None:
        paths["mjcf"] = str(args.mjcf)
    for file in args.trajectory:
        write_trajectory(file, trajectory, name, world)
        paths[file.suffix.removeprefix(".")] = str(file)
    if args.opensim is not None:
        body = experiment.body(args.run)
        write_opensim(args.opensim, trajectory, body, name, world)
        paths["opensim"] = str(args.opensim)
    return paths
