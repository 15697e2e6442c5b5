"""Studies of a sampler that tests share."""

import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.exceptions import ExperimentalWarning
from optuna.storages import RetryHeartbeatStaleTrialCallback
from optuna.trial import TrialState

from study import FeatureKernelSampler
from study.sampler.acquisition import Model
from study.sampler.history import OFF_TABLE
from tests.tools.running import ROOT

Floats = NDArray[np.float64]
Objective = Callable[[optuna.Trial], Any]


def study_of(
    features=None,
    objective=None,
    trials=0,
    *,
    enqueued=(),
    seed=1,
    direction="minimize",
    **options,
):
    """A study with our sampler, after some trials."""
    sampler = FeatureKernelSampler(features, seed=seed, **options)
    study = optuna.create_study(sampler=sampler, direction=direction)
    for params in enqueued:
        study.enqueue_trial(params)
    if objective is not None:
        study.optimize(objective, n_trials=trials)
    return study


def model_after(trials, costs, kernel, ensemble=None, limits=None):
    """After trials [n], of two parameters; limits None: without any."""
    return Model(
        kernel=kernel,
        parameters=2,
        trials=trials,
        rows=np.full(len(trials), OFF_TABLE),
        costs=costs,
        limits=np.empty((len(trials), 0)) if limits is None else limits,
        running=trials.take(np.arange(0)),
        known={},
        ensemble=ensemble,
    )


def model_of(study):
    """After all trials of the study."""
    return study.sampler._policy.present(study).model


def told(study, space, params, value, **limits):
    """A trial of these parameters that has ended with this value, and limits by name."""
    study.enqueue_trial(params)
    trial = study.ask(space)
    for name, limit in limits.items():
        trial.set_constraint(name, limit)
    study.tell(trial, value)


def rows_of(study):
    """The row that is noted in each trial."""
    return [trial.user_attrs.get("row") for trial in study.trials]


def params_of(study):
    """Of the complete trials."""
    return [trial.params for trial in study.get_trials(states=(TrialState.COMPLETE,))]


def run_code(code, *words, **environment):
    """A program in a process of its own."""
    command, env = [sys.executable, "-c", code, *words], os.environ | environment
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=env)


def without_warning(study, objective, trials):
    """Run trials in which a warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        study.optimize(objective, n_trials=trials)


def resumed(
    new_sampler,
    objective,
    trials,
    study,
):
    """A study of which a new sampler runs each trial, as another process would."""
    for _ in range(trials):
        study.sampler = new_sampler()
        study.optimize(objective, n_trials=1)
    return study


def kill(study, number):
    """Fail a running trial and queue its repetition, as Optuna's heartbeat does."""
    trial = study.trials[number]
    study.tell(number, state=TrialState.FAIL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        RetryHeartbeatStaleTrialCallback()(study, trial)


def summed(**ranges):
    """An objective: the sum of these parameters, each a float with two ends."""

    def objective(trial):
        return sum(trial.suggest_float(name, *ends) for name, ends in ranges.items())

    return objective


only_a = summed(a=(0, 1))


def bowl(trial):
    """On a from -1 to 1 and b from 0 to 5."""
    return trial.suggest_float("a", -1, 1) ** 2 + 0.01 * trial.suggest_float("b", 0, 5)
