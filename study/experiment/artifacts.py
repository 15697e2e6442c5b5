"""A picture of the best trial of a live study, where the dashboard looks for it.

The trial is simulated once more, recorded. A file that is there is whole, and is not
made again.
"""

import json
import uuid
from dataclasses import replace
from pathlib import Path

import numpy as np
import optuna
from optuna.storages import RDBStorage

from storage.commit import TEMPORARY_SUFFIX, writable
from storage.databases.bulk import attach
from storage.databases.studies import read_errors
from storage.folder import remove
from study.experiment.database import opened
from study.experiment.folder import fingerprint, live_artifacts
from study.experiment.gains import named_gains, recorded_walk
from study.experiment.trials import best_trial
from study.experiment.walker import WalkerExperiment, outcome_text
from study.pictures import write_strip

STRIP_DPI = 100
RECORDED_S = 12.0  # from the start of the trial
RECORD_RATE_HZ = 50.0
NAMESPACE = uuid.UUID("6f1d2b3c-5d0e-4b57-9a52-0f4a7f6f3b11")
STRIP = {"filename": "strip.png", "mimetype": "image/png"}


def draw_best(
    experiment: WalkerExperiment, run: int, study: optuna.Study, url: str, out: Path
) -> None:
    """Draw the best trial of a live study of the database, and attach the picture.

    The picture goes to `live_artifacts`; `out` is the folder of the study. The same
    walk has the same file in all calls. A walk that diverged before its first sample
    has no picture.

    Raises:
        InputError: no place to write.
    """
    best = best_trial(experiment.objective, study)
    folder, conditions = live_artifacts(url, out), experiment.conditions
    gains = np.array([best.params[name] for name in experiment.names])
    title = f"{experiment.name}, run {run}: {outcome_text(best.user_attrs)}"
    walk = f"{fingerprint(experiment)}/{run}/{gains.tobytes().hex()}"
    file = folder / str(uuid.uuid5(NAMESPACE, f"{walk}/strip"))
    with writable(folder):
        folder.mkdir(parents=True, exist_ok=True)
    remove(folder, f".*{TEMPORARY_SUFFIX}")
    if not file.exists():
        short = replace(conditions, duration_s=min(RECORDED_S, conditions.duration_s))
        named = named_gains("best", experiment.fixed_by_name | best.params)
        begun = recorded_walk(
            named, replace(experiment, conditions=short), run, RECORD_RATE_HZ
        )
        (trajectory,) = begun.trajectories
        if not np.isfinite(trajectory.q).all(axis=1).any():
            return
        write_strip(file, trajectory, experiment.terrain(run), title, STRIP_DPI)
    # As `optuna.artifacts.upload_artifact` would register the file with the trial.
    value = json.dumps({"artifact_id": file.name, **STRIP, "encoding": None})
    with opened(url) as storage, read_errors(url):
        attach(storage, study.study_name, best.number, f"artifacts:{file.name}", value)
        # In any case: a call that was killed may have attached the file alone.
        _note(storage, study.study_name, best.number, title, file.name)


def _note(
    storage: RDBStorage, study_name: str, number: int, title: str, file: str
) -> None:
    """Write the note of the trial's page: how the walk ended, and the picture in full width."""
    from optuna_dashboard import get_note, save_note  # a second
    from optuna_dashboard.artifact import get_artifact_path

    study = optuna.load_study(study_name=study_name, storage=storage)
    trial_id = storage.get_trial_id_from_study_id_trial_number(study._study_id, number)
    trial = optuna.trial.Trial(study, trial_id)
    if not get_note(trial):  # of the user's
        picture = f"![strip of stick figures]({get_artifact_path(trial, file)})"
        save_note(trial, f"{title}\n\n{picture}")
