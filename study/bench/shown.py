"""The trials of a bench as studies of Optuna: the one that the dashboard shows, and those to learn.

What is shown follows from the entries alone. It is made anew whenever it does not, also
after a command that was killed between an entry and what it shows.
"""

from collections.abc import Iterable, Mapping

import optuna
from optuna.distributions import BaseDistribution
from optuna.trial import FrozenTrial, TrialState, create_trial

from storage.databases.files import read_errors
from study.bench.journal import Journal, State, Trial
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


def require_shown(journal: Journal, plan: Plan) -> None:
    """Read the study that is shown, if there is one, before an entry is made that it has to show.

    Raises:
        InputError: somebody has edited it.
    """
    with read_errors(plan.url):
        journal.writer.require_readable(plan.name)


def show(journal: Journal, plan: Plan, space: Space, state: State) -> None:
    """Bring the study that the dashboard shows up to date; its trials are those of the bench."""
    gone = create_trial(state=TrialState.FAIL, user_attrs={"note": "undone"})
    wanted = [
        frozen(state.trials[number], space, plan) if number in state.trials else gone
        for number in range(state.count)
    ]
    journal.writer.bring(plan.name, plan.direction, wanted)
