"""The worth of features in the studies of a comparison, each as the note of its study."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import product

import optuna
from optuna.storages import RDBStorage

from storage.databases.bulk import trial_counts
from storage.databases.studies import (
    load_whole,
    open_studies,
    read_errors,
    read_studies,
    storage_errors,
)
from study.experiment.arms import Arm
from study.experiment.experiment import Experiment, study_name
from study.experiment.live_study import require_notes, require_written
from study.experiment.one_study import note_worth


def note_worths(
    experiment: Experiment, arms: Sequence[Arm], runs: Sequence[int], url: str, renew: bool
) -> None:
    """Write or renew the notes; arms without features have none.

    Args:
        experiment: whose studies.
        arms: of the experiment, whose stores are there.
        runs: of each arm.
        url: of the study database, to which the trials were exported before.
        renew: whether there may be new trials; if not, a study that has a note keeps it.

    Raises:
        InputError: the database cannot be used.
    """
    if not any(arm.features for arm in arms):
        return
    from optuna_dashboard import get_note  # a second

    storage = open_studies(url)
    try:
        with storage_errors(url):
            for arm, run, name in _noted(storage, experiment, arms, runs):
                if not renew and get_note(optuna.load_study(study_name=name, storage=storage)):
                    continue  # without a look at its trials, which take far longer
                note_worth(experiment, arm, run, _checked(storage, name, experiment, url))
    finally:
        storage.engine.dispose()


def check_noted(experiment: Experiment, arms: Sequence[Arm], runs: Sequence[int], url: str) -> None:
    """Refuse studies that `note_worths` would refuse, before the work; nothing is written.

    Raises:
        InputError: as `note_worths`.
    """
    if not any(arm.features for arm in arms):
        return
    with read_studies(url) as storage:
        if storage is not None:
            for _, _, name in _noted(storage, experiment, arms, runs):
                _checked(storage, name, experiment, url)


def _noted(
    storage: RDBStorage, experiment: Experiment, arms: Iterable[Arm], runs: Sequence[int]
) -> Iterator[tuple[Arm, int, str]]:
    """Each study that has trials and gets a note, by its name."""
    counts = trial_counts(storage)
    for arm, run in product((arm for arm in arms if arm.features), runs):
        name = study_name(experiment.name, arm.name, run)
        if counts.get(name):
            yield arm, run, name


def _checked(storage: RDBStorage, name: str, experiment: Experiment, url: str) -> optuna.Study:
    """The study, its trials and its note as this project writes them."""
    with read_errors(url):
        study = load_whole(storage, name)
        require_notes(name, storage)
    require_written(study, experiment)
    return study
