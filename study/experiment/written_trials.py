"""The trials of a study in a database, found to be as this project writes them.

Anybody may have edited a database, and Optuna believes what it says.
"""

import re
from collections.abc import Callable
from typing import Any

import optuna
from optuna.distributions import check_distribution_compatibility
from optuna.storages import BaseStorage
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from study.experiment.experiment import Experiment
from study.experiment.objective import ATTRIBUTES
from study.experiment.one_study import FELL_ATTRIBUTE, SHOWN_ATTRIBUTE
from study.sampler.history import FEATURES_ATTRIBUTE, FIXED_ATTRIBUTE, SCORE_ATTRIBUTE
from taichi_nmm import checks
from taichi_nmm.errors import InputError

RETRIED_ATTRIBUTE = "retry_history"  # Optuna's, of the system

_number, _flag = checks.number(), checks.flag
_whole_numbers = checks.each(checks.whole(0))
_numbers = checks.each(checks.optional(_number))

# Of a finished trial, those that must be there; and of any, those that may be.
FINISHED: dict[str, Callable[[str, Any], Any]] = dict.fromkeys(ATTRIBUTES, _number) | {
    "end_reason": checks.text, "walked": _flag,
}  # fmt: skip
IF_THERE: dict[str, Callable[[str, Any], Any]] = {
    SCORE_ATTRIBUTE: checks.optional(_number), FEATURES_ATTRIBUTE: _numbers,
    FELL_ATTRIBUTE: _flag, SHOWN_ATTRIBUTE: _numbers,
}  # fmt: skip
OF_OPTUNA: dict[str, Callable[[str, Any], Any]] = {
    FIXED_ATTRIBUTE: checks.by_name(checks.anything), RETRIED_ATTRIBUTE: _whole_numbers,
}  # fmt: skip

# The keys that optuna-dashboard keeps a note under, of a study or of a trial: a version, and parts.
NOTE = re.compile(r"(dashboard:(?:\d+:)?note_)(ver|str:(\d+))")


def require_written(study: optuna.Study, experiment: Experiment) -> None:
    """Refuse a study whose trials nobody could go on with.

    Raises:
        InputError: naming the study, the trial, and what of it.
    """
    if study.directions != [StudyDirection.MINIMIZE]:
        directions = [direction.name for direction in study.directions]
        raise InputError(f"study {study.study_name}: directions", directions, "one, MINIMIZE")
    for place, trial in enumerate(study.get_trials(deepcopy=False)):
        prefix = f"study {study.study_name}, trial {trial.number}"
        if trial.number != place:
            raise InputError(prefix, trial.number, f"{place}: trials without a gap")
        if trial.state is TrialState.COMPLETE:
            _require_finished(trial, experiment, prefix)
        _require_compatible(trial, experiment, prefix)
        _require(trial.user_attrs, IF_THERE, prefix)
        _require(trial.system_attrs, OF_OPTUNA, prefix)


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
            raise InputError(f"study {study}: note", sorted(numbers), "parts without a gap")


def _require_finished(trial: FrozenTrial, experiment: Experiment, prefix: str) -> None:
    checks.each(_number)(f"{prefix}: values", trial.values)
    if trial.params.keys() != experiment.space.keys():
        allowed = f"one of each of {', '.join(experiment.names)}"
        raise InputError(f"{prefix}: parameters", list(trial.params), allowed)
    for parameter in experiment.parameters:
        ends = checks.number(parameter.low, parameter.high)
        ends(f"{prefix}: {parameter.name}", trial.params[parameter.name])
    for name in FINISHED:
        if name not in trial.user_attrs:
            raise InputError(f"{prefix}: {name}", "missing", "what the walk came to")
    _require(trial.user_attrs, FINISHED, prefix)


def _require_compatible(trial: FrozenTrial, experiment: Experiment, prefix: str) -> None:
    """Refuse distributions beside which Optuna takes none of ours."""
    for name, distribution in trial.distributions.items():
        ours = experiment.space.get(name)
        if ours is None:
            continue
        try:
            check_distribution_compatibility(distribution, ours)
        except ValueError:
            raise InputError(f"{prefix}: {name}", str(distribution), str(ours)) from None


def _require(
    found: dict[str, Any], form: dict[str, Callable[[str, Any], Any]], prefix: str
) -> None:
    for name, check in form.items():
        if name in found:
            check(f"{prefix}: {name}", found[name])
