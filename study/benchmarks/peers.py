"""Samplers side by side on a synthetic problem: ours, Optuna's, and controls without a model."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler, CmaEsSampler, GPSampler, RandomSampler, TPESampler

from study.benchmarks.synthetic import NAMES, Problem
from study.sampler.candidate_table import CandidateTable
from study.sampler.feature_sampler import FeatureKernelSampler

Floats = NDArray[np.float64]

OFF_GRID = 256  # perturbations a trial, of the arm that may leave the table


@dataclass(frozen=True)
class Peer:
    """A way of choosing trials that is compared with others: ours, one of Optuna's, or a control.

    Attributes:
        label: for tables and plots.
        sees: what it may choose from, and what it is told beside the costs.
        kind: "ours", "peer" or "control".
        uses_feature: runs differ between features of one cost.
        sampler: for a problem; None for the controls that need no study.
    """

    label: str
    sees: str
    kind: str
    uses_feature: bool = False
    sampler: Callable[[Problem], BaseSampler] | None = None


def run(arm: str, problem: Problem, trials: int) -> Floats:
    """Costs of the trials of one run in their order, [trials]; the problem's seed decides all."""
    chosen = PEERS[arm]
    if chosen.sampler is None:
        rows = problem.rows()
        return problem.cost(rows[_CONTROL_ORDERS[arm](problem, rows)[:trials]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        study = optuna.create_study(sampler=chosen.sampler(problem))
    study.optimize(problem.objective, n_trials=trials)
    return np.array([trial.values[0] for trial in study.get_trials(deepcopy=False)])


def _table(problem: Problem) -> CandidateTable:
    """The problem's rows with their feature."""
    rows = problem.rows()
    columns = dict(zip(NAMES, rows.T, strict=True))
    return CandidateTable.from_arrays(
        columns, problem.features(rows), space=problem.distributions()
    )


def _ours(kernel: str | None = None) -> Callable[[Problem], BaseSampler]:
    """Our sampler over the rows of the table; None: the kernel that it has by default."""
    return lambda problem: FeatureKernelSampler(_table(problem), seed=problem.seed, kernel=kernel)


def _euclidean(problem: Problem) -> BaseSampler:
    """Our sampler over the whole space, a Gaussian process of the parameters."""
    return FeatureKernelSampler(None, seed=problem.seed, space=problem.distributions())


def _off_grid(problem: Problem) -> BaseSampler:
    """Our sampler over the rows, and over points near the best of them."""
    return FeatureKernelSampler(
        _table(problem), seed=problem.seed, feature_function=problem.features, off_grid=OFF_GRID
    )


def _random_rows(problem: Problem, rows: Floats) -> NDArray[np.int64]:
    """Row numbers in random order."""
    return np.random.default_rng(problem.seed).permutation(len(rows))


def _score_first(problem: Problem, rows: Floats) -> NDArray[np.int64]:
    """Row numbers, the least feature first."""
    return np.argsort(problem.features(rows)[:, 0], kind="stable")


_SPACE = "the space"
_ROWS = "4,096 rows"
_ROWS_AND_FEATURE = "4,096 rows and their feature"
_ROWS_AND_MORE = "4,096 rows, points near the best of them, the feature of each"

PEERS = {
    "random": Peer("RandomSampler", _SPACE, "peer", sampler=lambda p: RandomSampler(seed=p.seed)),
    "tpe": Peer("TPESampler", _SPACE, "peer", sampler=lambda p: TPESampler(seed=p.seed)),
    "gp": Peer("GPSampler", _SPACE, "peer", sampler=lambda p: GPSampler(seed=p.seed)),
    "cmaes": Peer("CmaEsSampler", _SPACE, "peer", sampler=lambda p: CmaEsSampler(seed=p.seed)),
    "random-rows": Peer("random rows", _ROWS, "control"),
    "score-first": Peer("least feature first", _ROWS_AND_FEATURE, "control", uses_feature=True),
    "euclidean": Peer("ours, Euclidean", _SPACE, "ours", sampler=_euclidean),
    "euclidean-rows": Peer("ours, Euclidean, rows", _ROWS, "ours", sampler=_ours("euclidean")),
    "ours": Peer("ours", _ROWS_AND_FEATURE, "ours", True, _ours()),
    "paper": Peer("ours, the paper's kernel", _ROWS_AND_FEATURE, "ours", True, _ours("rbf")),
    "off-grid": Peer("ours, off the table", _ROWS_AND_MORE, "ours", True, _off_grid),
}  # fmt: skip

_CONTROL_ORDERS = {"random-rows": _random_rows, "score-first": _score_first}
