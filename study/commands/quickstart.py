"""Find a walker on rough ground from nothing: a small store, three studies, pictures."""

from argparse import Namespace
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path

import optuna

from storage.commit import commit_json, require_folder
from storage.databases.studies import (
    only_run,
    open_studies,
    read_studies,
    require_lockable,
    storage_errors,
)
from storage.precompute import precompute
from storage.specification import read_specification
from study.cli import ProgressBar
from study.commands.study import command_line, dashboard_command, film_command
from study.experiment.arms import find_arm
from study.experiment.experiment import Experiment, read_experiment, study_name
from study.experiment.folder import live_artifacts
from study.experiment.gains import gains_of_source, named_gains, recorded_walk
from study.experiment.live_study import run_study
from study.experiment.trials import progress_line, study_line
from study.options import config_path
from taichi_nmm.config import read_toml
from taichi_nmm.walker_simulator import require_engine

CONFIG, STORE_CONFIG = "rough8", "quickstart-store"
ARMS = ("worlds", "dog", "random")
STORES = ("flat", "worlds")  # names under which these arms read the one store
RUN = 0
REFERENCE_S = 30.0  # of the reference gait, for its pictures
RECORD_RATE_HZ = 100.0


def make_store(path: Path) -> None:
    """Make the store of scores, or the missing part of it."""
    specification = read_specification(read_toml(config_path(STORE_CONFIG)))
    walkers = f"{specification.samples} walkers, {specification.horizon_s:g} s on flat ground"
    say(f"1. Scoring {walkers}; then {', '.join(each.name for each in specification.families)}")
    with closing(ProgressBar()) as bar:
        progress = partial(bar.move, "walker", total=specification.walkers)
        precompute(specification, path, progress=progress)


def run_arm(experiment: Experiment, name: str, url: str, out: Path) -> optuna.Study:
    """Run the study of an arm, or the missing trials of it."""
    arm, trials = find_arm(name), experiment.trials
    storage = open_studies(url)
    with only_run(url, study_name(experiment.name, name, RUN)), storage_errors(url):
        study = run_study(
            experiment, arm, RUN, trials, storage,
            report=lambda study, trial: say(
                progress_line(experiment.objective, study, trial, trials)
            ),
        )  # fmt: skip
        from study.experiment.artifacts import draw_best  # Matplotlib

        draw_best(experiment, RUN, study, url, out)
        return study


def draw_walks(out: Path, experiment: Experiment, study: optuna.Study) -> list[Path]:
    """A strip and a gait cycle of the best trial, and of the reference gait on flat ground."""
    from study import pictures  # here, where matplotlib is needed

    level = read_experiment(config_path("flat"))
    level = replace(level, conditions=replace(level.conditions, duration_s=REFERENCE_S))
    found, paths = named_gains("found", study.best_params), []
    for name, title, gains, where in (
        ("found", f"Found by {study.study_name}", found, experiment),
        ("reference", "Reference gait", gains_of_source("reference"), level),
    ):
        result = recorded_walk(gains, where, RUN, RECORD_RATE_HZ)
        trajectory, terrain = result.trajectories[0], where.terrain(RUN)
        title += f": {result.end_reason[0]} {result['duration_s'][0]:.0f} s"
        strip, cycle = out / f"{name}_strip.png", out / f"{name}_gait_cycle.png"
        paths.append(pictures.write_strip(strip, trajectory, terrain, title))
        paths.append(pictures.write_gait_cycle(cycle, trajectory, where.weight_n(RUN), title))
    return paths


def say(*lines: str) -> None:
    """Print lines at once."""
    print(*lines, sep="\n", flush=True)


def main(args: Namespace) -> None:
    """Do all of it, or the missing part."""
    out: Path = args.out
    require_folder(out)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    stores = dict.fromkeys(STORES, out / "store")
    experiment = replace(read_experiment(config_path(CONFIG)), stores=stores)
    require_engine(experiment.conditions.settings)
    url = f"sqlite:///{out / 'studies.db'}"
    for name in ARMS:  # studies that cannot be resumed are refused before the store is made
        require_lockable(url, study_name(experiment.name, name, RUN))
    with read_studies(url):
        pass
    make_store(out / "store")
    ground, duration_s = experiment.terrain(RUN).name, experiment.conditions.duration_s
    say(f"2. {experiment.trials} trials with each sampler: {duration_s:g} s on {ground}")
    studies = [run_arm(experiment, arm, url, out) for arm in ARMS]
    best = min(studies, key=lambda study: study.best_value)
    commit_json(out / "found.json", best.best_params)
    say("3. Drawing the best walker found, and the reference gait")
    paths = draw_walks(out, experiment, best)
    say(
        "",
        *(study_line(experiment.objective, study) for study in studies),
        f"Gains of the best: {out / 'found.json'}",
        f"Pictures: {', '.join(str(path) for path in paths)}",
        f"A film of it: {film_command(out / 'found.json', config_path(CONFIG), RUN)}",
        f"Its store, and its gaits walking: {command_line('explore', str(out / 'store'))}",
        f"All trials in a browser: {dashboard_command(url, live_artifacts(url, out))}",
    )
