"""One study, live: an arm in a run of an experiment, through any number of interruptions.

Each trial is in the database as soon as it is finished. Its trials are those that a
comparison of the same experiment has for this arm and run.
"""

import re
import time
import warnings
from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import (
    FloatDistribution,
    IntDistribution,
    check_distribution_compatibility,
)
from optuna.exceptions import (
    ExperimentalWarning,
    StorageInternalError,
    UpdateFinishedTrialError,
)
from optuna.storages import BaseStorage, RetryHeartbeatStaleTrialCallback
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from storage.commit import require_folder
from storage.databases.postgresql import Crew
from storage.databases.studies import read_studies, require_lockable, study_of_costs
from storage.inputs import checks
from storage.inputs.errors import InputError, listed
from storage.tables import difference
from study.experiment.arms import Arm
from study.experiment.experiment import WALKED, Experiment, study_name
from study.experiment.folder import LIVE_ATTRIBUTE, document
from study.experiment.one_study import (
    COST_ATTRIBUTE,
    FELL_ATTRIBUTE,
    SHOWN_ATTRIBUTE,
    LiveStudy,
    note_worth,
)
from study.experiment.walker import END_REASON
from study.sampler.history import FEATURES_ATTRIBUTE, FIXED_ATTRIBUTE, SCORE_ATTRIBUTE

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
    """As `run_trials`; at the end the study's note says what the arm's features were worth."""
    study = run_trials(experiment, arm, run, trials, storage, report, crew)
    with crew.turn() if crew else nullcontext():
        note_worth(experiment, arm, run, study)
    return study


def run_trials(
    experiment: Experiment,
    arm: Arm,
    run: int,
    trials: int,
    storage: BaseStorage,
    report: Report | None = None,
    crew: Crew | None = None,
) -> optuna.Study:
    """Run the study until it has `trials` finished trials, and return it.

    Finished means COMPLETE. Trials found running are taken for dead (the caller sees to
    it that no other process runs this study: `storage.databases.studies.only_run`);
    they are marked failed and run again, with the same parameters, before anything
    else. Of a crew that is done with trials whose process is gone, and a process that
    finds enough of them begun waits for the others.

    Trials are the total, not the number to add; an experiment may end a study before,
    with its first walker. `report` is called after each finished trial. Without a crew
    this process works on the study alone.

    Raises:
        InputError: the run is none of the experiment's, or a study of that name was
            made otherwise.
    """
    experiment.require_run(run)
    one = LiveStudy(experiment, arm, run, open_study(experiment, arm, run, storage))
    report = report or (lambda study, told: None)
    if crew is not None:
        _run_together(experiment, one, trials, report, crew)
    else:
        _repeat(experiment, one.study, running(one.study))
        while one.trials < trials and not _ended(experiment, one):
            report(one.study, _run_trial(experiment, one))
    return one.study


def _run_together(
    experiment: Experiment, one: LiveStudy, trials: int, report: Report, crew: Crew
) -> None:
    """As one of several processes: propose in turns, simulate side by side."""
    while True:
        with ExitStack() as until_told:
            with crew.turn():
                dead = crew.dead()
                _repeat(
                    experiment,
                    one.study,
                    [t for t in running(one.study) if t.number in dead],
                )
                # One look: a trial that ends between two would be in neither.
                states = [trial.state for trial in one.study.get_trials(deepcopy=False)]
                done, begun = (
                    states.count(TrialState.COMPLETE),
                    states.count(TrialState.RUNNING),
                )
                if done >= trials or _ended(experiment, one):
                    return
                is_due = done + begun < trials
                if is_due:
                    one.trials = done + begun
                    gains, number = one.ask(), one.asked.number
                    until_told.enter_context(crew.alive(number))
            if not is_due:
                time.sleep(WAIT_S)
                continue
            try:
                report(one.study, _simulated(experiment, one, gains))
            except UpdateFinishedTrialError:
                pass  # it was taken for dead, and another process has it
            except BaseException:
                with crew.turn():
                    left = [
                        trial for trial in running(one.study) if trial.number == number
                    ]
                    _repeat(experiment, one.study, left)
                raise


def _ended(experiment: Experiment, one: LiveStudy) -> bool:
    """Whether a study that ends with its first walker has one."""
    walkers = (trial.user_attrs.get(WALKED) for trial in one.finished())
    return experiment.until_walker and any(walkers)


def open_study(
    experiment: Experiment, arm: Arm, run: int, storage: BaseStorage
) -> optuna.Study:
    """The study of an arm in a run, new or resumed; one that was made otherwise is refused.

    Raises:
        InputError: naming the study, the first field that differs, and the value it has
            there.
    """
    name, identity = _check_study(experiment, arm, run, storage)
    study = study_of_costs(storage, name, experiment.objective.metrics)
    if LIVE_ATTRIBUTE not in study.user_attrs:
        study.set_user_attr(LIVE_ATTRIBUTE, identity)
    return study


def check_study(
    experiment: Experiment, arm: Arm, run: int, url: str, out: Path
) -> None:
    """Refuse a study that cannot go on, before anything is written; the database may be missing.

    Raises:
        InputError: as `open_study`, or a file that cannot be read or written, in `out`
            as well.
    """
    require_folder(out)
    require_lockable(url, study_name(experiment.name, arm.name, run))
    with read_studies(url) as storage:
        if storage is not None:
            _check_study(experiment, arm, run, storage)


def _check_study(
    experiment: Experiment, arm: Arm, run: int, storage: BaseStorage
) -> tuple[str, dict[str, Any]]:
    """Name and document of the study, which is new or was begun with this document."""
    name, identity = (
        study_name(experiment.name, arm.name, run),
        document(experiment, (arm,)),
    )
    names = optuna.get_all_study_names(storage)
    if name not in names:
        return name, identity
    study = optuna.load_study(study_name=name, storage=storage)
    trials = study.get_trials(deepcopy=False)  # read before anything is written
    known = study.user_attrs.get(LIVE_ATTRIBUTE)
    if known is None:
        if trials:
            raise InputError(
                "study", name, "a name that no study of another program has"
            )
    elif not isinstance(known, dict):  # the experiment's name
        allowed = (
            "another --storage: this study is of a comparison, which goes on by itself"
        )
        raise InputError("study", name, allowed)
    # Versions first: what an older one made is refused by its number.
    elif found := (
        difference(identity["versions"], known.get("versions"), "versions")
        or difference(identity, known)
    ):
        field, ours, theirs = found
        allowed = (
            f"{theirs!r}, with which it was made; or another name, or another database"
        )
        raise InputError(f"study {name}: {field}", ours, allowed)
    require_written(study, experiment)
    require_notes(name, storage)
    return name, identity


def _run_trial(experiment: Experiment, one: LiveStudy) -> FrozenTrial:
    """Ask, simulate, tell; an interrupted trial is put back in the queue."""
    try:
        return _simulated(experiment, one, one.ask())
    except StorageInternalError:
        raise  # nothing can be written now; the trial stays running, and the next run repeats it
    except BaseException:
        _repeat(experiment, one.study, running(one.study))
        raise


def _simulated(
    experiment: Experiment, one: LiveStudy, gains: list[float]
) -> FrozenTrial:
    """Try what was asked for, and tell."""
    rows = experiment.simulate([one.run], np.array([gains]))
    (costs,) = experiment.objective.values(rows)
    told = experiment.told(costs, one.run, one.trials)
    known = one.shown(rows[0], costs) | experiment.attributes_of(rows[0])
    return one.tell(told, known)


def running(study: optuna.Study) -> list[FrozenTrial]:
    """Trials that somebody has begun, and nobody has finished."""
    return study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))


def _repeat(
    experiment: Experiment, study: optuna.Study, dead: list[FrozenTrial]
) -> None:
    """Fail trials that nobody runs, and queue others with the parameters that they had been given.

    A trial that had been given only some of them is queued without any: samplers draw
    them one after the other.
    """
    for trial in dead:
        given = copy(trial)
        if set(trial.params) != set(experiment.names):
            given.params, given.distributions = {}, {}
        with warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
            retry = RetryHeartbeatStaleTrialCallback()
            # First the successor: killed between the two steps, the next run must not
            # lose it.
            waiting = study.get_trials(deepcopy=False, states=(TrialState.WAITING,))
            if not any(trial.number in retry.retry_history(other) for other in waiting):
                retry(study, given)
        study.tell(trial.number, state=TrialState.FAIL)


Form = dict[str, checks.Check]  # of attributes, by name

_number = checks.number()
_numbers = checks.each(checks.optional(_number))

# Attributes of a finished trial that are no numbers; of any trial, those that may be there.
NO_NUMBERS: Form = {END_REASON: checks.text, WALKED: checks.flag}
IF_THERE: Form = {
    SCORE_ATTRIBUTE: checks.optional(_number),
    FEATURES_ATTRIBUTE: _numbers,
    FELL_ATTRIBUTE: checks.flag,
    SHOWN_ATTRIBUTE: _numbers,
    COST_ATTRIBUTE: _number,
}
OF_OPTUNA: Form = {  # of the system
    FIXED_ATTRIBUTE: checks.by_name(checks.anything),
    "retry_history": checks.each(checks.whole(0)),
}

# The keys that optuna-dashboard keeps a note under, of a study or of a trial: a
# version, and parts.
NOTE = re.compile(r"(dashboard:(?:\d+:)?note_)(ver|str:(\d+))")


def require_written(study: optuna.Study, experiment: Experiment) -> None:
    """Refuse a study whose trials nobody could go on with.

    Raises:
        InputError: naming the study, the trial, and the part of it.
    """
    costs = len(experiment.objective.each)
    if study.directions != [StudyDirection.MINIMIZE] * costs:
        directions = [direction.name for direction in study.directions]
        allowed = " and ".join(["MINIMIZE"] * costs)
        raise InputError(f"study {study.study_name}: directions", directions, allowed)
    for place, trial in enumerate(study.get_trials(deepcopy=False)):
        prefix = f"study {study.study_name}, trial {trial.number}"
        if trial.number != place:
            raise InputError(prefix, trial.number, f"{place}: trials without a gap")
        if trial.state is TrialState.COMPLETE:
            _require_finished(trial, experiment, prefix)
        for name, distribution in trial.distributions.items():
            ours = experiment.space.get(name, distribution)
            try:
                check_distribution_compatibility(distribution, ours)
            except ValueError:  # Optuna would take no value of ours beside it
                raise InputError(
                    f"{prefix}: {name}", str(distribution), str(ours)
                ) from None
        for form, found in (
            (IF_THERE, trial.user_attrs),
            (OF_OPTUNA, trial.system_attrs),
        ):
            for name, check in form.items():
                if name in found:
                    check(f"{prefix}: {name}", found[name])


def _require_finished(trial: FrozenTrial, experiment: Experiment, prefix: str) -> None:
    checks.each(_number, len(experiment.objective.each))(
        f"{prefix}: values", trial.values
    )
    if trial.params.keys() != experiment.space.keys():
        allowed = f"one of each of {listed(experiment.names)}"
        raise InputError(f"{prefix}: parameters", list(trial.params), allowed)
    for name, of in experiment.space.items():
        if isinstance(of, FloatDistribution | IntDistribution):
            ends = checks.number(of.low, of.high)
            ends(f"{prefix}: {name}", trial.params[name])
    for name in experiment.attributes:
        if name not in trial.user_attrs:
            raise InputError(f"{prefix}: {name}", "missing", "the outcome of the walk")
        check = NO_NUMBERS.get(name, _number)
        check(f"{prefix}: {name}", trial.user_attrs[name])


def require_notes(study: str, storage: BaseStorage) -> None:
    """Refuse notes that the dashboard could not read: they are renewed when the work has ended.

    Raises:
        InputError: naming the study.
    """
    attributes = storage.get_study_system_attrs(storage.get_study_id_from_name(study))
    parts: dict[str, set[int]] = {}
    for key, value in attributes.items():
        if (found := NOTE.fullmatch(key)) is None:
            continue
        if found[3] is None:
            checks.whole(0)(f"study {study}: note", value)
        else:
            checks.text(f"study {study}: note", value)
            parts.setdefault(found[1], set()).add(int(found[3]))
    for numbers in parts.values():
        if numbers != set(range(len(numbers))):
            raise InputError(
                f"study {study}: note", sorted(numbers), "parts without a gap"
            )
