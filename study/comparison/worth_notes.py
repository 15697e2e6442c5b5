"""The worth of features in the studies of a comparison, each as the note of its study."""

from collections.abc import Iterable, Sequence

import optuna

from storage.databases.bulk import trial_counts
from storage.databases.studies import open_studies, read_errors, storage_errors
from study.experiment.arms import Arm
from study.experiment.experiment import Experiment, study_name
from study.experiment.worth_note import note_worth
from study.experiment.written_trials import require_written


def note_worths(
    experiment: Experiment, arms: Iterable[Arm], runs: Sequence[int], url: str, renew: bool
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
    # Of points off its store's grid an arm would have to simulate the features again.
    chosen = [arm for arm in arms if arm.features and not arm.off_grid]
    if not chosen:
        return
    from optuna_dashboard import get_note  # a second

    storage = open_studies(url)
    try:
        with storage_errors(url):
            counts = trial_counts(storage)
            for arm in chosen:
                for run in runs:
                    name = study_name(experiment.name, arm.name, run)
                    if not counts.get(name):
                        continue
                    with read_errors(url):
                        study = optuna.load_study(study_name=name, storage=storage)
                        study.get_trials(deepcopy=False)
                    require_written(study, experiment)
                    if renew or not get_note(study):
                        note_worth(experiment, arm, run, study)
    finally:
        storage.engine.dispose()
