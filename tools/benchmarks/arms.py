"""Arms of the comparisons: ways of choosing trials on a benchmark's problems.

An arm is a function from a problem, a seed and a number of trials to the costs of these trials. A
problem has a `space`, as Optuna has it, and `cost_at(settings)`. `study_costs` makes an arm of a
sampler of Optuna; another optimizer needs a function of its own.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.samplers import BaseSampler, CmaEsSampler, GPSampler, RandomSampler, TPESampler

from study.experiment.arms import Kind

Floats = NDArray[np.float64]

# Samplers of Optuna by the name of their arm. CMA-ES draws choices at random, as always in Optuna.
PEERS: dict[str, tuple[str, Callable[[int], BaseSampler]]] = {
    "random": ("RandomSampler", lambda seed: RandomSampler(seed=seed)),
    "tpe": ("TPESampler", lambda seed: TPESampler(seed=seed)),
    "gp": ("GPSampler", lambda seed: GPSampler(seed=seed)),
    "cmaes": ("CmaEsSampler", lambda s: CmaEsSampler(seed=s, warn_independent_sampling=False)),
}


@dataclass(frozen=True)
class Arm:
    """A way of choosing trials that is compared with others.

    Attributes:
        label: for tables and plots.
        sees: the points it may choose from, or its information beside the costs.
        kind: "ours", "peer" or "control".
        costs: of a problem, a seed and a number of trials: costs in the order of trials, [trials].
        features: whether it is told features.
    """

    label: str
    sees: str
    kind: Kind
    costs: Callable[[Any, int, int], Floats]
    features: bool = False


def peer(name: str, sees: str) -> Arm:
    """The arm of a sampler of Optuna with its defaults."""
    label, make = PEERS[name]
    return Arm(label, sees, "peer", lambda problem, seed, trials: study_costs(
        problem, make(seed), trials))  # fmt: skip


def ours(
    label: str, sees: str, make: Callable[[Any, int], BaseSampler], features: bool = False
) -> Arm:
    """An arm of our sampler, which `make` makes for a problem and a seed."""
    return Arm(label, sees, "ours", lambda problem, seed, trials: study_costs(
        problem, make(problem, seed), trials), features)  # fmt: skip


def study_costs(
    problem: Any, sampler: BaseSampler, trials: int, first: Iterable[Mapping[str, Any]] = ()
) -> Floats:
    """Costs of the trials of a study in their order, [trials]; settings `first` are tried first."""
    study, costs = optuna.create_study(sampler=sampler), []
    for settings in first:
        study.enqueue_trial(dict(settings))
    for _ in range(trials):
        trial = study.ask(problem.space)
        costs.append(problem.cost_at(trial.params))
        study.tell(trial, costs[-1])
    return np.array(costs)
