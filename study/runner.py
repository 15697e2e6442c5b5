"""One study, live: an arm in a run of an experiment, through any number of interruptions.

Each trial is in the database as soon as it is finished. Its trials are those that a comparison of
the same experiment has for this arm and run.
"""

import time
import warnings
from collections.abc import Callable
from contextlib import ExitStack
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.exceptions import (
    ExperimentalWarning,
    StorageInternalError,
    UpdateFinishedTrialError,
)
from optuna.storages import BaseStorage, RetryHeartbeatStaleTrialCallback
from optuna.trial import FrozenTrial, TrialState

from storage.commit import require_folder
from storage.databases.crew import Crew
from storage.databases.studies import name_metric, read_studies, require_lockable
from storage.document import difference
from study.experiment.arms import Arm
from study.experiment.experiment import Experiment, study_name
from study.experiment.identity import LIVE_ATTRIBUTE, document
from study.experiment.live_study import LiveStudy
from study.experiment.objective import attributes, costs, finite, metric_name
from study.experiment.simulation import simulate_trials
from study.experiment.worth_note import note_worth
from study.experiment.written_trials import require_notes, require_written
from taichi_nmm.errors import InputError

WAIT_S = 1.0  # between two looks at what the others of a crew do

Report = Callable[[optuna.Study, FrozenTrial], None]


def run_study(
    experiment: Experiment,
    arm: Arm,
    run: int,
    trials: int,
    storage: BaseStorage,
    report: Report | None = None,
    crew: Crew | None = None,
) -> optuna.Study:
    """Run the study until it has `trials` finished trials, and return it.

    At the end its note in the dashboard says what the arm's features were worth, if it has any.

    Finished means COMPLETE. Trials found running are taken for dead (the caller sees to it that no
    other process runs this study: `storage.databases.studies.only_run`); they are marked failed and
    run again, with the same parameters, before anything else. Of a crew that is done with trials
    whose heart has stopped, and a process that finds enough of them begun waits for the others.

    Args:
        experiment: of the study.
        arm: that proposes; found able to by `study.experiment.check`.
        run: whose body and ground it is about.
        trials: the total, not the number to add; an experiment may end a study before, with its
            first walker.
        storage: of Optuna.
        report: called after each finished trial.
        crew: the processes that work on the study; None: this one alone.

    Raises:
        InputError: the run is none of the experiment's, or a study of that name was made otherwise.
    """
    experiment.require_run(run)
    one = LiveStudy(experiment, arm, run, open_study(experiment, arm, run, storage))
    told_of = report or (lambda study, told: None)
    if crew is not None:
        _run_together(experiment, one, trials, told_of, crew)
        with crew.turn():
            note_worth(experiment, arm, run, one.study)
        return one.study
    _repeat(experiment, one.study, running(one.study))
    while one.trials < trials and not _ended(experiment, one):
        told_of(one.study, _run_trial(experiment, one))
    note_worth(experiment, arm, run, one.study)
    return one.study


def _run_together(
    experiment: Experiment, one: LiveStudy, trials: int, report: Report, crew: Crew
) -> None:
    """As one of several processes: propose in turns, simulate side by side."""
    while True:
        with ExitStack() as until_told:
            with crew.turn():
                dead = crew.dead()
                _repeat(experiment, one.study, [t for t in running(one.study) if t.number in dead])
                done, begun = len(one.finished()), len(running(one.study))
                if done >= trials or _ended(experiment, one):
                    return
                is_due = done + begun < trials
                if is_due:
                    one.trials = done + begun
                    gains = one.ask()
                    until_told.enter_context(crew.alive(one.asked.number))
            if not is_due:
                time.sleep(WAIT_S)
                continue
            number = one.asked.number
            try:
                report(one.study, _simulated(experiment, one, gains))
            except UpdateFinishedTrialError:
                pass  # it was taken for dead, and another process has it
            except BaseException:
                with crew.turn():
                    left = [trial for trial in running(one.study) if trial.number == number]
                    _repeat(experiment, one.study, left)
                raise


def _ended(experiment: Experiment, one: LiveStudy) -> bool:
    """Whether a study that ends with its first walker has one."""
    walkers = (trial.user_attrs.get("walked") for trial in one.finished())
    return experiment.until_walker and any(walkers)


def open_study(experiment: Experiment, arm: Arm, run: int, storage: BaseStorage) -> optuna.Study:
    """The study of an arm in a run, new or resumed; one that was made otherwise is refused.

    Raises:
        InputError: naming the study, the first field that differs, and the value it has there.
    """
    name, identity = _check_study(experiment, arm, run, storage)
    study = optuna.create_study(
        storage=storage, study_name=name, direction="minimize", load_if_exists=True
    )
    if LIVE_ATTRIBUTE not in study.user_attrs:
        study.set_user_attr(LIVE_ATTRIBUTE, identity)
    name_metric(study, metric_name(experiment.cost))
    return study


def check_study(experiment: Experiment, arm: Arm, run: int, url: str, out: Path) -> None:
    """Refuse a study that cannot go on, before anything is written.

    Args:
        experiment: of the study.
        arm: that proposes.
        run: whose body and ground it is about.
        url: of the database, which need not be there.
        out: folder for what the study finds.

    Raises:
        InputError: as `open_study`, or what cannot be read or written.
    """
    experiment.require_run(run)
    require_folder(out)
    require_lockable(url, study_name(experiment.name, arm.name, run))
    with read_studies(url) as storage:
        if storage is not None:
            _check_study(experiment, arm, run, storage)


def _check_study(
    experiment: Experiment, arm: Arm, run: int, storage: BaseStorage
) -> tuple[str, dict[str, Any]]:
    """Name and document of the study, which is new or was begun with this document."""
    name, identity = study_name(experiment.name, arm.name, run), document(experiment, (arm,))
    _refuse_older(f"{experiment.name}/{arm.name}", name, storage)
    if name not in optuna.get_all_study_names(storage):
        return name, identity
    study = optuna.load_study(study_name=name, storage=storage)
    trials = study.get_trials(deepcopy=False)  # read before anything is written
    known = study.user_attrs.get(LIVE_ATTRIBUTE)
    if known is None:
        if trials:
            raise InputError("study", name, "a name that no study of another program has")
    elif not isinstance(known, dict):  # the experiment's name
        allowed = "another --storage: this study is of a comparison, which goes on by itself"
        raise InputError("study", name, allowed)
    elif found := difference(identity, known):
        field, ours, theirs = found
        allowed = f"{theirs!r}, with which it was made; or another name, or another database"
        raise InputError(f"study {name}: {field}", ours, allowed)
    require_written(study, experiment)
    require_notes(name, storage)
    return name, identity


def _refuse_older(old: str, new: str, storage: BaseStorage) -> None:
    """Refuse to go on beside a study of before studies had runs; its seeds were others."""
    if old in optuna.get_all_study_names(storage):
        allowed = f"another --storage: this study is of an earlier version, and is now {new}"
        raise InputError("study", old, allowed)


def _run_trial(experiment: Experiment, one: LiveStudy) -> FrozenTrial:
    """Ask, simulate, tell; an interrupted trial is put back in the queue."""
    try:
        return _simulated(experiment, one, one.ask())
    except StorageInternalError:
        raise  # nothing can be written now; the trial stays running, and the next run repeats it
    except BaseException:
        _repeat(experiment, one.study, running(one.study))
        raise


def _simulated(experiment: Experiment, one: LiveStudy, gains: list[float]) -> FrozenTrial:
    """Try what was asked for, and tell."""
    rows = finite(simulate_trials(experiment, [one.run], np.array([gains])).rows)
    return one.tell(float(costs(rows, experiment.cost)[0]), rows, attributes(rows))


def running(study: optuna.Study) -> list[FrozenTrial]:
    """Trials that somebody has begun, and nobody has finished."""
    return study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))


def _repeat(experiment: Experiment, study: optuna.Study, dead: list[FrozenTrial]) -> None:
    """Fail trials that nobody runs, and queue others with the parameters that they had been given.

    One that had been given some of them is asked for anew: samplers draw them one after the other.
    """
    for trial in dead:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ExperimentalWarning)
            retry = RetryHeartbeatStaleTrialCallback()
            # First the successor: killed between the two steps, the next run must not lose it.
            waiting = study.get_trials(deepcopy=False, states=(TrialState.WAITING,))
            if not any(trial.number in retry.retry_history(other) for other in waiting):
                retry(study, trial if set(trial.params) == set(experiment.names) else _bare(trial))
        study.tell(trial.number, state=TrialState.FAIL)


def _bare(trial: FrozenTrial) -> FrozenTrial:
    bare = copy(trial)
    bare.params, bare.distributions = {}, {}
    return bare
