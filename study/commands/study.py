"""Run one live study: an arm proposes gains, and a simulator tries them."""

import json
import os
import shlex
import sys
from argparse import Namespace
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import optuna
from optuna.trial import FrozenTrial

from storage.commit import commit_json, writable
from storage.databases.postgresql import Crew
from storage.databases.studies import only_run, open_studies, storage_errors
from storage.databases.urls import is_postgresql, public_url
from study.experiment.arms import check_arms, with_store
from study.experiment.experiment import study_name
from study.experiment.folder import live_artifacts
from study.experiment.live_study import check_study, run_study
from study.experiment.robots import read_any
from study.experiment.trials import best_trial, progress_line, study_facts, study_line
from study.experiment.walker import WalkerExperiment
from study.options import config_path


def main(args: Namespace) -> None:
    """Run the study, or go on with it."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    experiment = read_any(args.config, args.arch, args.seed, store=args.store)
    if args.store is not None:
        experiment = with_store(experiment, (args.arm,), args.store)
    experiment.require_run(args.run)
    trials = experiment.trials if args.trials is None else args.trials
    (arm,) = check_arms(experiment, (args.arm,), trials)
    experiment.robot.require_machine()
    name = study_name(experiment.name, arm.name, args.run)
    folder = args.out or Path("out") / experiment.name
    gains = folder / f"{arm.name}-run-{args.run:03d}-best.json"
    check_study(experiment, arm, args.run, args.storage, folder)
    storage = open_studies(args.storage)

    def report(study: optuna.Study, trial: FrozenTrial) -> None:
        line = progress_line(experiment, study, trial, trials)
        print(line, file=sys.stderr, flush=True)

    # A sampler with a state of its own (CMA-ES) needs its trials in one order, from one
    # process.
    shared = is_postgresql(args.storage) and not arm.replayed
    taken = Crew.joined(args.storage, name) if shared else only_run(args.storage, name)
    commands = {}
    with taken as crew, storage_errors(args.storage):
        study = run_study(experiment, arm, args.run, trials, storage, report, crew)
        best = best_trial(experiment.objective, study)
        keep_best({**experiment.fixed_by_name, **best.params}, gains)
        if isinstance(experiment, WalkerExperiment):
            from study.experiment.artifacts import draw_best  # Matplotlib: a second

            with crew.turn() if crew else nullcontext():
                draw_best(experiment, args.run, study, args.storage, folder)
            commands["film"] = film_command(gains, args.config, args.run, args.seed)
        pictures = live_artifacts(args.storage, folder)
        commands["dashboard"] = dashboard_command(args.storage, pictures)
        files = {"gains": str(gains), "storage": public_url(args.storage)}
        if args.json:
            print(json.dumps(study_facts(experiment, study) | files | commands))
            return
        print(study_line(experiment, study))
        database = {"database": files["storage"]}
        print(lines({"gains": gains, **database, **commands}))


def keep_best(params: dict[str, Any], file: Path) -> None:
    """Write the best parameters of a study."""
    with writable(file.parent):
        file.parent.mkdir(parents=True, exist_ok=True)
    commit_json(file, params)


def lines(known: dict[str, Any]) -> str:
    """For people, a line each."""
    return "\n".join(f"{name + ':':<10} {value}" for name, value in known.items())


def film_command(
    gains: Path, config: Path, run: int = 0, seed: int | None = None
) -> str:
    """A command line: films gains on body and ground of a run of a configuration."""
    shown = config.stem if config_path(config.stem) == config else str(config)
    words = ["walk", "--gains", str(gains), "--config", shown]
    if run:
        words += ["--run", str(run)]
    if seed is not None:
        words += ["--seed", str(seed)]
    return command_line(*words)


def dashboard_command(url: str, artifacts: Path) -> str:
    """A command line: opens the studies of a database, and their pictures, in a browser."""
    words = ["dashboard", "--storage", public_url(url)]
    if is_postgresql(url):
        words += ["--artifacts", str(artifacts)]
    return command_line(*words)


def command_line(*words: str) -> str:
    """A line that runs `taichi-nmm`, whether the environment is active or not."""
    here = Path(sys.executable).is_relative_to(Path.cwd())
    program = os.path.relpath(sys.executable) if here else sys.executable
    return shlex.join([program, "-m", "taichi_nmm", *words])
