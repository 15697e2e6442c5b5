"""One study from its first trial to its last, through any number of interruptions."""

import warnings
from collections.abc import Callable

import optuna
from optuna.exceptions import ExperimentalWarning, StorageInternalError
from optuna.storages import BaseStorage, RetryHeartbeatStaleTrialCallback
from optuna.trial import FrozenTrial, TrialState

from study.arms import new_sampler
from study.config import StudyConfig
from study.feature_table import FeatureTable
from study.identity import check_identity
from study.objective import WalkObjective
from taichi_nmm.errors import InputError

Report = Callable[[optuna.Study, FrozenTrial], None]


def run_study(
    config: StudyConfig,
    arm: str,
    trials: int,
    storage: BaseStorage,
    table: FeatureTable | None = None,
    report: Report | None = None,
) -> optuna.Study:
    """Run the study name/arm until it has `trials` finished trials, and return it.

    Finished means COMPLETE. Trials found running are taken for dead (the caller sees to it that no
    other process runs this study: `storage.databases.studies.only_run`); they are marked failed and
    run again, with the same parameters, before anything else.

    Args:
        config: what the study is about.
        arm: one of `study.arms.ARMS`.
        trials: the total, not the number to add.
        storage: of Optuna.
        table: rows for the samplers that choose among rows.
        report: called after each finished trial.

    Raises:
        InputError: a study of that name was made with another configuration, or the table has
            fewer rows than there are trials.
    """
    check_trials(trials, table)
    study = open_study(config, arm, storage, table)
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        repeat(study, trial)
    objective = WalkObjective(config)
    while (done := len(finished(study))) < trials:
        study.sampler = new_sampler(arm, config, table, turn=done)
        run_trial(study, objective, report)
    return study


def check_trials(trials: int, table: FeatureTable | None) -> None:
    """Refuse a number of trials that cannot be run; no row is ever taken twice."""
    if trials < 1:
        raise InputError("trials", trials, "1 or more")
    if table is not None and trials > (rows := int(table.rows.offered.sum())):
        raise InputError("trials", trials, f"at most {rows}, the rows of the store")


def open_study(
    config: StudyConfig, arm: str, storage: BaseStorage, table: FeatureTable | None
) -> optuna.Study:
    """The study name/arm, new or resumed; one of another configuration is refused."""
    study = optuna.create_study(
        storage=storage,
        study_name=study_name(config, arm),
        direction="minimize",
        load_if_exists=True,
    )
    check_identity(study, config, arm, table)
    return study


def study_name(config: StudyConfig, arm: str) -> str:
    """What the study is called in the database and the dashboard."""
    return f"{config.name}/{arm}"


def finished(study: optuna.Study) -> list[FrozenTrial]:
    """The finished trials, in the order of their numbers."""
    return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))


def run_trial(study: optuna.Study, objective: WalkObjective, report: Report | None) -> None:
    """Ask, evaluate, tell; an interrupted trial is put back in the queue."""
    trial = study.ask()
    try:
        value = objective(trial)
    except StorageInternalError:
        raise  # nothing can be written now; the trial stays running, and the next run repeats it
    except BaseException:
        repeat(study, study.get_trials(deepcopy=False)[trial.number])
        raise
    told = study.tell(trial, value)
    if report is not None:
        report(study, told)


def repeat(study: optuna.Study, trial: FrozenTrial) -> None:
    """Fail a running trial, and queue another with the parameters that it had been given."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        retry = RetryHeartbeatStaleTrialCallback()
        # First the successor: killed between the two steps, the next run must not lose the trial.
        waiting = study.get_trials(deepcopy=False, states=(TrialState.WAITING,))
        if not any(trial.number in retry.retry_history(other) for other in waiting):
            retry(study, trial)
    study.tell(trial.number, state=TrialState.FAIL)
