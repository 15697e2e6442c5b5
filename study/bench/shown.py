"""The trials of a bench as studies of Optuna: the one that the dashboard shows, and those to learn.

What is shown follows from the entries alone. It is made anew whenever it does not, also
after a command that was killed between an entry and what it shows.
"""

from collections.abc import Iterable, Mapping
from itertools import zip_longest

import optuna
from optuna.distributions import BaseDistribution
from optuna.storages import RDBStorage
from optuna.trial import FrozenTrial, TrialState, create_trial

from storage.databases.studies import load_whole, read_errors
from study.bench.journal import State, Trial
from study.bench.plan import Plan

Space = Mapping[str, BaseDistribution]

ATTRIBUTES = ("context", "operator", "note", "failed", "why")
TOLD = {True: TrialState.COMPLETE, False: TrialState.RUNNING}


def frozen(
    trial: Trial, space: Space, plan: Plan, limits: Mapping[str, float] | None = None
) -> FrozenTrial:
    """A trial as Optuna has it, with the limits of its columns or, if given, with others."""
    told = trial.value is not None
    limits = plan.limits(trial) if limits is None else limits
    shown = {key: getattr(trial, key) for key in ATTRIBUTES}
    return create_trial(
        state=TOLD[told],
        value=trial.value,
        params=trial.params,
        distributions=dict(space),
        user_attrs=trial.notes | shown | trial.columns,
        constraints=dict(limits) if told else None,
    )


def study_of(trials: Iterable[Trial], space: Space, plan: Plan) -> optuna.Study:
    """A study in memory, to learn from; it numbers the trials from 0, without gaps."""
    study = optuna.create_study(direction=plan.direction)
    for trial in trials:
        study.add_trial(frozen(trial, space, plan))
    return study


def require_shown(storage: RDBStorage, plan: Plan) -> None:
    """Read the study that is shown, if there is one, before an entry is made that it has to show.

    Raises:
        InputError: somebody has edited it.
    """
    with read_errors(plan.url):
        if plan.name in optuna.get_all_study_names(storage):
            load_whole(storage, plan.name)


def show(storage: RDBStorage, plan: Plan, space: Space, state: State) -> None:
    """Bring the study that the dashboard shows up to date; its trials are those of the bench."""
    study = optuna.create_study(
        storage=storage,
        study_name=plan.name,
        direction=plan.direction,
        load_if_exists=True,
    )
    gone = create_trial(state=TrialState.FAIL, user_attrs={"note": "undone"})
    wanted = [
        frozen(state.trials[number], space, plan) if number in state.trials else gone
        for number in range(state.count)
    ]
    for trial, own in zip_longest(study.get_trials(deepcopy=False), wanted):
        if trial is None:
            study.add_trial(own)
        elif own is None or not _shows(study, trial, own):
            optuna.delete_study(study_name=plan.name, storage=storage)
            show(storage, plan, space, state)
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
