"""Studies of a sampler that tests share."""

import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.exceptions import ExperimentalWarning
from optuna.storages import RetryHeartbeatStaleTrialCallback
from optuna.trial import TrialState

from study import FeatureKernelSampler
from study.sampler.acquisition import Model
from study.sampler.gp import Kernel
from study.sampler.transforms import Points
from tests.tools.running import ROOT

Floats = NDArray[np.float64]
Objective = Callable[[optuna.Trial], Any]


def study_of(
    features: Any = None,
    objective: Objective | None = None,
    trials: int = 0,
    *,
    enqueued: Iterable[dict[str, Any]] = (),
    seed: int = 1,
    direction: str = "minimize",
    **options: Any,
) -> optuna.Study:
    """A study with our sampler, after some trials."""
    sampler = FeatureKernelSampler(features, seed=seed, **options)
    study = optuna.create_study(sampler=sampler, direction=direction)
    for params in enqueued:
        study.enqueue_trial(params)
    if objective is not None:
        study.optimize(objective, n_trials=trials)
    return study


def model_after(
    trials: Points, costs: Floats, kernel: Kernel, ensemble: Any = None
) -> Model:
    """After trials [n] without limits, of two parameters."""
    return Model(
        kernel=kernel,
        parameters=2,
        trials=trials,
        costs=costs,
        limits=np.empty((len(trials), 0)),
        running=trials.take(np.arange(0)),
        known={},
        ensemble=ensemble,
    )


def rows_of(study: optuna.Study) -> list[int | None]:
    """The row that is noted in each trial."""
    return [trial.user_attrs.get("row") for trial in study.trials]


def params_of(study: optuna.Study) -> list[dict[str, Any]]:
    """Of the complete trials."""
    return [trial.params for trial in study.get_trials(states=(TrialState.COMPLETE,))]


def run_code(
    code: str, *words: str, **environment: str
) -> subprocess.CompletedProcess[str]:
    """A program in a process of its own."""
    command, env = [sys.executable, "-c", code, *words], os.environ | environment
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=env)


def without_warning(study: optuna.Study, objective: Objective, trials: int) -> None:
    """Run trials in which a warning is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        study.optimize(objective, n_trials=trials)


def resumed(
    new_sampler: Callable[[], Any],
    objective: Objective,
    trials: int,
    study: optuna.Study,
) -> optuna.Study:
    """A study of which a new sampler runs each trial, as another process would."""
    for _ in range(trials):
        study.sampler = new_sampler()
        study.optimize(objective, n_trials=1)
    return study


def kill(study: optuna.Study, number: int) -> None:
    """Fail a running trial and queue its repetition, as Optuna's heartbeat does."""
    trial = study.trials[number]
    study.tell(number, state=TrialState.FAIL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        RetryHeartbeatStaleTrialCallback()(study, trial)


def only_a(trial: optuna.Trial) -> float:
    return trial.suggest_float("a", 0, 1)


def bowl(trial: optuna.Trial) -> float:
    """On a from -1 to 1 and b from 0 to 5."""
    return trial.suggest_float("a", -1, 1) ** 2 + 0.01 * trial.suggest_float("b", 0, 5)
