"""Run one live study of the walker: an arm proposes gains, and the simulator tries them.

    taichi-nmm study --config rough8 --arm dog --trials 30 \\
        --storage sqlite:///out/studies.db

Its trials equal those of the same arm and run in a comparison of the same configuration. The
dashboard shows a picture of the best one. The same command goes on where it was stopped. Exit
codes: 0, 2 bad input, 130 interrupted.
"""

import json
import os
import shlex
import sys
from argparse import Namespace
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import optuna
from optuna.trial import FrozenTrial, TrialState

from storage.commit import commit_json, writable
from storage.databases.postgresql import Crew
from storage.databases.studies import only_run, open_studies, storage_errors
from storage.databases.urls import is_postgresql, public_url
from study.comparison.folder import live_artifacts
from study.experiment.arms import check_arms, with_store
from study.experiment.experiment import read_experiment, study_name
from study.experiment.live_study import check_study, run_study
from study.experiment.trials import MEASURES, outcome_text
from study.options import config_path
from study.sampler.history import ROW_ATTRIBUTE, SCORE_ATTRIBUTE
from taichi_nmm.walker_simulator import require_engine


def main(args: Namespace) -> None:
    """Run the study, or go on with it."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    experiment = read_experiment(args.config, args.arch, args.seed)
    if args.store is not None:
        experiment = with_store(experiment, (args.arm,), args.store)
    experiment.require_run(args.run)
    trials = experiment.trials if args.trials is None else args.trials
    (arm,) = check_arms(experiment, (args.arm,), trials)
    require_engine(experiment.conditions.settings)
    name = study_name(experiment.name, arm.name, args.run)
    folder = args.out or Path("out") / experiment.name
    gains = folder / f"{arm.name}-run-{args.run:03d}-best.json"
    check_study(experiment, arm, args.run, args.storage, folder)
    storage = open_studies(args.storage)

    def report(study: optuna.Study, trial: FrozenTrial) -> None:
        print(progress_line(study, trial, trials), file=sys.stderr, flush=True)

    # A sampler with a state of its own (CMA-ES) needs its trials in one order, from one process.
    shared = is_postgresql(args.storage) and not arm.replayed
    taken = Crew.joined(args.storage, name) if shared else only_run(args.storage, name)
    with taken as crew, storage_errors(args.storage):
        study = run_study(experiment, arm, args.run, trials, storage, report, crew)
        with writable(folder):
            folder.mkdir(parents=True, exist_ok=True)
        commit_json(gains, study.best_params)
        from study.comparison.artifacts import draw_best  # Matplotlib: a second

        with crew.turn() if crew else nullcontext():
            draw_best(experiment, args.run, study, args.storage, folder)
        commands = {
            "film": film_command(gains, args.config, args.run, args.seed),
            "dashboard": dashboard_command(args.storage, live_artifacts(args.storage, folder)),
        }
        if args.json:
            print(json.dumps(summary(study, args.storage, gains, commands)))
        else:
            print(summary_text(study, args.storage, gains, commands))


def progress_line(study: optuna.Study, trial: FrozenTrial, trials: int) -> str:
    """One finished trial, and the best so far."""
    best = study.best_trial
    return (
        f"{study.study_name}  {len(_finished(study)):>{len(str(trials))}}/{trials}  "
        f"cost {trial.values[0]:8.4f}  {outcome_text(trial.user_attrs):<44}  "
        f"best {best.values[0]:.4f} (trial {best.number})"
    )


def study_line(study: optuna.Study) -> str:
    """A study in one line: how many trials walked, and the best."""
    best, walkers = study.best_trial, _walkers(study)
    row = ""
    if ROW_ATTRIBUTE in best.user_attrs:
        score = best.user_attrs.get(SCORE_ATTRIBUTE)  # of arms that compare rows by one number
        scored = "" if score is None else f", score {score:.1f}"
        row = f" (row {best.user_attrs[ROW_ATTRIBUTE]}{scored})"
    first = f", the first in trial {walkers[0]}" if walkers else ""
    return (
        f"{study.study_name}: {len(walkers)} of {len(_finished(study))} trials walked{first}; "
        f"best trial {best.number}{row}: cost {best.values[0]:.4f}, {outcome_text(best.user_attrs)}"
    )


def summary(
    study: optuna.Study, url: str, gains: Path, commands: Mapping[str, str]
) -> dict[str, Any]:
    """A study and its best trial, for programs: one object of plain values.

    Args:
        study: with a finished trial.
        url: of its database.
        gains: file of the best gains.
        commands: command lines that show the study, by name.
    """
    best, walkers = study.best_trial, _walkers(study)
    return {
        "study": study.study_name,
        "trials": len(_finished(study)),
        "walkers": len(walkers),
        "first_walker": walkers[0] if walkers else None,
        "best_trial": best.number,
        "best_cost": best.values[0],
        "row": best.user_attrs.get(ROW_ATTRIBUTE),
        "score": best.user_attrs.get(SCORE_ATTRIBUTE),
        **{name: best.user_attrs[name] for name in (*MEASURES, "end_reason")},
        "gains": str(gains),
        "storage": public_url(url),
        **commands,
    }


def summary_text(study: optuna.Study, url: str, gains: Path, commands: Mapping[str, str]) -> str:
    """The same, for people."""
    named = {"gains": gains, "database": public_url(url), **commands}
    lines = [f"{name + ':':<10} {value}" for name, value in named.items()]
    return "\n".join([study_line(study), *lines])


def film_command(gains: Path, config: Path, run: int = 0, seed: int | None = None) -> str:
    """A command line: films gains on body and ground of a run of a configuration."""
    shown = config.stem if config_path(config.stem) == config else str(config)
    words = ["walk", "--gains", str(gains), "--config", shown]
    words += ["--run", str(run)] if run else []
    return command_line(*words, *([] if seed is None else ["--seed", str(seed)]))


def dashboard_command(url: str, artifacts: Path) -> str:
    """A command line: opens the studies of a database, and their pictures, in a browser."""
    words = ["dashboard", "--storage", public_url(url)]
    return command_line(*words, *(["--artifacts", str(artifacts)] if is_postgresql(url) else []))


def command_line(*words: str) -> str:
    """A line that runs `taichi-nmm`, whether the environment is active or not."""
    here = Path(sys.executable).is_relative_to(Path.cwd())
    program = os.path.relpath(sys.executable) if here else sys.executable
    return shlex.join([program, "-m", "taichi_nmm", *words])


def _finished(study: optuna.Study) -> list[FrozenTrial]:
    return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))


def _walkers(study: optuna.Study) -> list[int]:
    """Numbers of the trials that walked."""
    return [trial.number for trial in _finished(study) if trial.user_attrs["walked"]]
