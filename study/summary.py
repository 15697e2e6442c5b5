"""The lines that a study prints: one a trial, and a summary."""

import os
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import optuna
from optuna.trial import FrozenTrial, TrialState

from storage.databases.urls import is_postgresql, public_url
from study.experiment.trials import outcome_text
from study.options import config_path
from study.sampler.history import ROW_ATTRIBUTE, SCORE_ATTRIBUTE

OUTCOMES = ("duration_s", "distance_m", "mean_speed_mps", "end_reason")


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
        **{name: best.user_attrs[name] for name in OUTCOMES},
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
