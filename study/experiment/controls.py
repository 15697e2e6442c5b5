"""Controls without a model: the order that a score gives is all they know."""

from abc import ABC
from functools import lru_cache
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial

from study.draws import turn
from study.experiment.task import Task
from study.features.feature_table import FeatureTable
from study.sampler.history import ROW_ATTRIBUTE, SCORE_ATTRIBUTE
from study.sampler.random_sampler import ReproducibleRandomSampler
from study.sampler.source import set_attributes

Order = NDArray[np.int64]


class RowSampler(BaseSampler, ABC):
    """What proposes all parameters of a table at once; others, which it has not, are uniform."""

    def __init__(self, table: FeatureTable, seed: int) -> None:
        """Nothing is computed."""
        self._table = table
        self._independent = ReproducibleRandomSampler(seed=seed)

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """The table's parameters."""
        return self._table.rows.space.as_dict()

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """Uniform, for parameters that the table does not have."""
        return self._independent.sample_independent(study, trial, param_name, param_distribution)

    def take(self, study: optuna.Study, trial: FrozenTrial, row: int) -> dict[str, Any]:
        """The parameters of a row, which is noted in the trial."""
        score = float(self._table.rows.features[row, 0])
        set_attributes(study, trial, {ROW_ATTRIBUTE: row, SCORE_ATTRIBUTE: score})
        return self._table.rows.as_parameters(row)


class RankedSampler(RowSampler):
    """Rows of a table in an order that was fixed beforehand: trial t is row `order[t]`.

    Args:
        table: of candidates.
        order: rows, best first, at least as many as there are trials.
    """

    def __init__(self, table: FeatureTable, order: Order) -> None:
        """Nothing is computed."""
        super().__init__(table, seed=0)
        self._order = order

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """The trial's row."""
        return self.take(study, trial, int(self._order[turn(study, trial)]))


@lru_cache(maxsize=32)
def score_order(table: FeatureTable) -> Order:
    """Rows by the first feature, descending; ties by the second, and so on, then by row, [m].

    Unknown features come last; rows that repeat the parameters of another are left out.
    """
    rows = table.rows
    known = np.where(np.isfinite(rows.features), rows.features, -np.inf)
    order = np.lexsort((np.arange(len(rows)), *(-known).T[::-1]))
    return order[rows.offered[order]]


def score_first(task: Task) -> BaseSampler:
    """The best score first."""
    return RankedSampler(task.table, score_order(task.table))
