"""Samplers side by side on a problem from outside, with their defaults: ours, Optuna's, a ranking.

All of them are answered by the same objective. Ours propose rows of the pool; Optuna's propose any
point of the space, and are told the cost of the nearest row.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler, CmaEsSampler, GPSampler, RandomSampler, TPESampler

from study.benchmarks.outside.outside_problem import OutsideProblem
from study.features.feature_table import FeatureTable
from study.sampler.feature_sampler import FeatureKernelSampler

Floats = NDArray[np.float64]

RANKING = "ranking"  # the feature that is the problem's mean rank, low is good
ENQUEUED = 3  # rows that are tried before a peer's own first trial


@dataclass(frozen=True)
class Arm:
    """A way of choosing trials.

    Attributes:
        label: for tables and plots.
        sees: what it is told beside the costs.
        kind: "ours", "peer" or "control".
        sampler: for a problem and a seed; None: rows in the order of the ranking.
        enqueued: of the best-ranked rows, tried first.
    """

    label: str
    sees: str
    kind: str
    sampler: Callable[[OutsideProblem, int], BaseSampler] | None
    enqueued: int = 0


def run(name: str, problem: OutsideProblem, seed: int, trials: int) -> Floats:
    """Costs of the trials of one run in their order, [trials]; the seed is the sampler's."""
    arm = ARMS[name]
    if arm.sampler is None:
        return problem.cost[rows_by_ranking(problem, seed)[:trials]]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        study = optuna.create_study(sampler=arm.sampler(problem, seed))
    for row in rows_by_ranking(problem, seed)[: arm.enqueued]:
        study.enqueue_trial(problem.settings(int(row)))
    study.optimize(problem.objective, n_trials=trials)
    return np.array([trial.values[0] for trial in study.get_trials(deepcopy=False)])


def rows_by_ranking(problem: OutsideProblem, seed: int) -> NDArray[np.int64]:
    """Row numbers, the best-ranked first, [n]; the seed decides among equals and nothing else."""
    among_equals = np.random.default_rng(np.random.SeedSequence(seed)).permutation(len(problem))
    return np.lexsort((among_equals, problem.ranking))


def table(problem: OutsideProblem, ranking: bool) -> FeatureTable:
    """The pool with its features as they come; with the ranking as one more, if asked for."""
    features, names = problem.features, [*problem.feature_names]
    if ranking:
        features, names = np.column_stack([features, problem.ranking]), [*names, RANKING]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of features that are not finite
        return FeatureTable.from_arrays(problem.columns, features, names, space=problem.space)


def _ours(problem: OutsideProblem, seed: int) -> BaseSampler:
    return FeatureKernelSampler(table(problem, ranking=False), seed=seed)


def _ours_with_prior(problem: OutsideProblem, seed: int) -> BaseSampler:
    return FeatureKernelSampler(table(problem, ranking=True), seed=seed, prior=f"-{RANKING}")


def _cmaes(_: OutsideProblem, seed: int) -> BaseSampler:
    """Choices are not for CMA-ES: as always in Optuna, they are drawn at random; no word of it."""
    return CmaEsSampler(seed=seed, warn_independent_sampling=False)


_NOTHING = "nothing"
_FEATURES = "features"
_RANKING = "features, and which end of each is good"

ARMS = {
    "ours": Arm("ours", _FEATURES, "ours", _ours),
    "ours-prior": Arm("ours, ranking as prior", _RANKING, "ours", _ours_with_prior),
    "ranking": Arm("the ranking alone", _RANKING, "control", None),
    "tpe-ranking": Arm(
        f"TPESampler, {ENQUEUED} best-ranked rows first",
        _RANKING,
        "peer",
        lambda _, seed: TPESampler(seed=seed),
        ENQUEUED,
    ),
    "tpe": Arm("TPESampler", _NOTHING, "peer", lambda _, seed: TPESampler(seed=seed)),
    "gp": Arm("GPSampler", _NOTHING, "peer", lambda _, seed: GPSampler(seed=seed)),
    "cmaes": Arm("CmaEsSampler", _NOTHING, "peer", _cmaes),
    "random": Arm("RandomSampler", _NOTHING, "peer", lambda _, seed: RandomSampler(seed=seed)),
}
