"""The studies of a bench on a server, written by Optuna."""

from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

import optuna
from optuna.storages import RDBStorage
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from storage.databases.studies import load_whole, write_down


class OptunaStudies:
    """The same as `storage.databases.plain.PlainStudies` for any database of Optuna's.

    An entry is one transaction, and what it shows are many.
    """

    def __init__(self, storage: RDBStorage) -> None:
        self._storage = storage

    def write_down(self) -> None:
        """See `studies.write_down`."""
        write_down(self._storage)

    def set_attribute(self, study: str, key: str, value: Any) -> None:
        """Set a user attribute, a JSON value, of a study, which is made where it is missing."""
        found = optuna.create_study(
            storage=self._storage, study_name=study, load_if_exists=True
        )
        found.set_user_attr(key, value)

    def require_readable(self, study: str) -> None:
        """Read a study, if it is there: for an edited value, Optuna raises its error here."""
        if study in optuna.get_all_study_names(self._storage):
            load_whole(self._storage, study)

    def bring(
        self, study: str, direction: StudyDirection, wanted: Sequence[FrozenTrial]
    ) -> None:
        """Let a study have these trials, by their places; it is made anew if it must be."""
        found = optuna.create_study(
            storage=self._storage,
            study_name=study,
            direction=direction,
            load_if_exists=True,
        )
        for trial, own in zip_longest(found.get_trials(deepcopy=False), wanted):
            if trial is None:
                found.add_trial(own)
            elif own is None or not _shows(found, trial, own):
                optuna.delete_study(study_name=study, storage=self._storage)
                self.bring(study, direction, wanted)
                return


def _shows(study: optuna.Study, trial: FrozenTrial, wanted: FrozenTrial) -> bool:
    """Whether a trial shows what is wanted, perhaps after it was finished, if it was running."""
    parts = ("state", "values", "params", "user_attrs")
    if all(getattr(trial, part) == getattr(wanted, part) for part in parts):
        return True
    unfinished = (
        trial.state is TrialState.RUNNING and wanted.state is not TrialState.FAIL
    )
    if not unfinished or trial.params != wanted.params:
        return False
    storage, number = study._storage, trial._trial_id
    for key, value in wanted.user_attrs.items():
        storage.set_trial_user_attr(number, key, value)
    for key, value in wanted.system_attrs.items():
        storage.set_trial_system_attr(number, key, value)
    return wanted.state is TrialState.RUNNING or storage.set_trial_state_values(
        number, wanted.state, wanted.values
    )
