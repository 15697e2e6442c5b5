"""What is in a folder, less what no two runs agree upon: times, dates and how often it was stopped.

Two folders that a command filled, one in peace and one through kills, have equal digests. Every
file counts, so what a killed process left behind is a difference.
"""

import hashlib
import json
import re
from pathlib import Path
from typing import Any

import optuna
import pyarrow.parquet as pq
from optuna.trial import FrozenTrial, TrialState

from storage.databases.urls import file_url
from study.comparison.experiment_folder import RUN_NAME, TIMES_NAME
from study.comparison.results import PROPOSAL_TIME
from study.optimum.optimum_folder import OPTIMUM_NAME

OF_THE_SESSION = {"date", "wall_s", "machine"}  # in optimum.json
OF_THE_DATABASE = (".db-wal", ".db-shm")  # read with it
OF_REPEATS = {"failed_trial", "retry_history", "fixed_params"}  # of a trial that was cut short
VERSION = re.compile("note_ver")  # counts how often a note was written
TRIAL_NOTE = re.compile(r"dashboard:(\d+):")  # by the trial's identity, in the order of writing
IDENTITIES = re.compile(r"/artifacts/\d+/\d+/")  # of study and trial, in the order of writing


def digest(folder: Path) -> dict[str, str]:
    """SHA-256 of the content of each file, by its name within the folder."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    return {
        str(file.relative_to(folder)): hashlib.sha256(content(file)).hexdigest()
        for file in files
        if not file.name.endswith(OF_THE_DATABASE)
    }


def content(file: Path) -> bytes:
    """Of one file."""
    if file.name == RUN_NAME:
        return b""
    if file.name == TIMES_NAME or file.parent.name == "arms":
        return repr(pq.read_table(file).drop_columns(PROPOSAL_TIME).to_pylist()).encode()
    if file.name == OPTIMUM_NAME:
        document = json.loads(file.read_text())
        return json.dumps({k: v for k, v in document.items() if k not in OF_THE_SESSION}).encode()
    if file.suffix == ".db":
        return json.dumps(studies(file), sort_keys=True).encode()
    return file.read_bytes()


def studies(file: Path) -> dict[str, Any]:
    """What a study database says, by study: attributes and finished trials in their order."""
    storage = optuna.storages.RDBStorage(file_url(file))
    try:
        return {
            name: of_study(optuna.load_study(study_name=name, storage=storage))
            for name in optuna.get_all_study_names(storage)
        }
    finally:
        storage.engine.dispose()


def of_study(study: optuna.Study) -> dict[str, Any]:
    """Attributes and finished trials of one study."""
    finished = study.get_trials(states=(TrialState.COMPLETE,))
    places = {trial._trial_id: place for place, trial in enumerate(finished)}
    system = study._storage.get_study_system_attrs(study._study_id)
    return {
        "user": study.user_attrs,
        "system": less_counts(system, places),
        "trials": [of_trial(trial) for trial in finished],
    }


def of_trial(each: FrozenTrial) -> dict[str, Any]:
    """A finished trial, less its number, which counts those that were cut short."""
    system = {k: v for k, v in each.system_attrs.items() if k not in OF_REPEATS}
    return {"params": each.params, "values": each.values, "user": each.user_attrs, "system": system}


def less_counts(attributes: dict[str, Any], places: dict[int, int]) -> dict[str, Any]:
    """The attributes of a study, less how often notes were written and in which order trials.

    Args:
        attributes: of the study's system.
        places: of the finished trials, by their identity in the database.
    """

    def renamed(key: str) -> str:
        return TRIAL_NOTE.sub(lambda found: f"trial {places.get(int(found[1]))}:", key)

    kept = {renamed(key): text for key, text in attributes.items() if not VERSION.search(key)}
    cleaned: dict[str, Any] = json.loads(IDENTITIES.sub("/artifacts/", json.dumps(kept)))
    return cleaned
