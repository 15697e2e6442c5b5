"""Samplers that know a score at most: rows in its order, or so begun, and CMA-ES.

After the first rows another sampler may go on. CMA-ES starts in two ways: from nowhere,
and from a good row.
"""

import warnings
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler, CmaEsSampler, GPSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState

from storage.inputs.errors import InputError
from study.experiment.experiment import Experiment, candidates
from study.sampler.draws import (
    Purpose,
    ReproducibleRandomSampler,
    generator,
    seed_32bit,
    turn,
)
from study.sampler.history import ROW_ATTRIBUTE, SCORE_ATTRIBUTE
from study.sampler.policy import set_attributes
from study.sampler.sampler import FeatureKernelSampler
from study.sampler.space import Space, reflected
from study.sampler.table import FeatureTable
from study.sampler.worlds import Worlds

Floats = NDArray[np.float64]

SIGMA_COLD = 0.2  # of each range
SIGMA_WARM = 0.1
HILL_SIGMA = 0.1  # of each range, before the climber has tried anything
LEAST_HILL_SIGMA = 0.005
MOST_HILL_SIGMA = 0.5
HILL_GROWTH = 1.5  # after a better trial; four others undo it
FIRST_ROWS = 3  # of the ranking, with which a peer begins
START_ROWS = 100  # best rows by score, of which a warm start takes one


@dataclass(frozen=True)
class Task:
    """One study of an experiment, and, of samplers that are new every trial, one trial.

    Attributes:
        experiment: of the study.
        seed: of the sampler.
        turn: number of the trial, from 0.
        store: key of the arm's store; "": it has none.
        feature: of the arm, a column of this store; "": it has none.
    """

    experiment: Experiment
    seed: int
    turn: int
    store: str
    feature: str

    @property
    def table(self) -> FeatureTable:
        """The arm's candidates with its feature."""
        return candidates(self.experiment, self.store, self.feature)


class RowSampler(ReproducibleRandomSampler):
    """Proposes all parameters of a table at once; parameters that are not in it are uniform."""

    def __init__(self, table: FeatureTable, seed: int) -> None:
        super().__init__(seed=seed)
        self._table = table

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """The table's parameters."""
        return self._table.rows.space.as_dict()

    def take(self, study: optuna.Study, trial: FrozenTrial, row: int) -> dict[str, Any]:
        """The parameters of a row, which is noted in the trial."""
        score = float(self._table.rows.features[row, 0])
        set_attributes(study, trial, {ROW_ATTRIBUTE: row, SCORE_ATTRIBUTE: score})
        return self._table.rows.as_parameters(row)


class RankedSampler(RowSampler):
    """The rows of a table in `score_order`: trial t is the row of rank t.

    With `then`, only the first of them; the other sampler proposes what follows.
    """

    def __init__(
        self, table: FeatureTable, seed: int, then: BaseSampler | None = None
    ) -> None:
        super().__init__(table, seed)
        self._then = then

    def _after(self, study: optuna.Study, trial: FrozenTrial) -> BaseSampler | None:
        """The other sampler, once it is its turn."""
        return self._then if turn(study, trial) >= FIRST_ROWS else None

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """The table's parameters, or those of the other sampler."""
        if then := self._after(study, trial):
            return then.infer_relative_search_space(study, trial)
        return super().infer_relative_search_space(study, trial)

    def sample_relative(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        search_space: dict[str, BaseDistribution],
    ) -> dict[str, Any]:
        """The trial's row, or what the other sampler makes of all trials so far."""
        if then := self._after(study, trial):
            return then.sample_relative(study, trial, search_space)
        rank = turn(study, trial)
        return self.take(study, trial, int(score_order(self._table)[rank]))

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """Of the other sampler, where it leaves parameters to this."""
        if then := self._after(study, trial):
            return then.sample_independent(study, trial, param_name, param_distribution)
        return super().sample_independent(study, trial, param_name, param_distribution)


@lru_cache(maxsize=32)
def score_order(table: FeatureTable) -> NDArray[np.int64]:
    """Rows by the feature, descending; ties by row, [m].

    Unknown features come last; rows that repeat the parameters of another are left out.
    """
    rows = table.rows
    score = rows.features[:, 0]
    order = np.argsort(-np.where(np.isfinite(score), score, -np.inf), kind="stable")
    return order[rows.offered[order]]


class HillSampler(RowSampler):
    """A hill climber: normal steps from the best trial, in the unit cube, reflected at its faces.

    The one-fifth rule (Rechenberg 1973) sets their size: it grows with each trial that
    was better than all before, and shrinks with the others.
    """

    def sample_relative(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        search_space: dict[str, BaseDistribution],
    ) -> dict[str, Any]:
        """A point near the best trial, which follows from the finished trials and the turn."""
        finished = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        costs = [each.values[0] for each in finished]
        size = HILL_SIGMA
        for number in range(FIRST_ROWS, len(costs)):
            is_better = costs[number] < min(costs[:number])
            size *= HILL_GROWTH if is_better else HILL_GROWTH**-0.25
            size = min(max(size, LEAST_HILL_SIGMA), MOST_HILL_SIGMA)
        rows = self._table.rows
        centre = rows.parameters[score_order(self._table)[0]]
        if finished:  # not so where workers share a study, or where all failed
            best = rows.space.row(finished[int(np.argmin(costs))].params)
            assert best is not None  # the study suggests no other parameters
            centre = best
        rng = generator(self._seed, Purpose.HILL, turn(study, trial))
        start = rows.space.fractions(centre[None])
        target = reflected(start + size * rng.standard_normal(start.shape))
        return rows.space.values(rows.space.from_fractions(target)[0])


def hill_ranking(table: FeatureTable, seed: int) -> BaseSampler:
    """The ranking's first rows, then the hill climber."""
    return RankedSampler(table, seed, then=HillSampler(table, seed))


def tpe_ranking(table: FeatureTable, seed: int) -> BaseSampler:
    """The ranking's first rows, then Optuna's TPESampler, which takes seeds of 32 bits."""
    peer = TPESampler(seed=seed % 2**32, n_startup_trials=FIRST_ROWS)
    return RankedSampler(table, seed, then=peer)


def gp_ranking(table: FeatureTable, seed: int) -> BaseSampler:
    """The ranking's first rows, then Optuna's GPSampler."""
    import torch

    torch.set_num_threads(1)  # its bits depend on them
    peer = GPSampler(seed=seed % 2**32, n_startup_trials=FIRST_ROWS)
    return RankedSampler(table, seed, then=peer)


def residual(table: FeatureTable, seed: int, **options: Any) -> BaseSampler:
    """Our sampler over the score, as one world: which world is like the robot is not asked."""
    rows = table.rows
    worlds = Worlds.of(-rows.features[:, 0], better="lower")
    nothing = rows.features[:, :0]
    with warnings.catch_warnings():
        # The given table has told of rows that are left out.
        warnings.filterwarnings("ignore", ".* are not proposed", UserWarning)
        table = FeatureTable(
            replace(rows, feature_names=(), features=nothing, worlds=worlds)
        )
    return FeatureKernelSampler(table, seed=seed, **options)


class ColdCmaEsSampler(CmaEsSampler):
    """Optuna's CMA-ES from a random mean; its draws depend on the trial's turn, not its number.

    It keeps its state in the trials. A new object with a seed of its own for each trial
    makes it draw alike after a restart. Trial 0 is random.
    """

    def __init__(self, task: Task) -> None:
        """Optuna warns of options that it calls experimental, and of x0 and sigma0.

        `source_trials`, which is to replace these two, fixes sigma at a tenth.
        """
        space = Space.of(task.experiment.space)
        fractions = generator(task.seed, Purpose.CMAES_MEAN).random((1, len(space)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)
            warnings.simplefilter("ignore", ExperimentalWarning)
            super().__init__(
                x0=space.values(space.from_fractions(fractions)[0]),
                sigma0=SIGMA_COLD,
                independent_sampler=ReproducibleRandomSampler(seed=task.seed),
                warn_independent_sampling=False,
                seed=seed_32bit(task.seed, Purpose.CMAES, task.turn),
            )

    def sample_relative(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        search_space: dict[str, BaseDistribution],
    ) -> dict[str, Any]:
        """The next of the generation, the same whether or not trials were killed before."""
        counted = copy(trial)
        counted.number = turn(study, trial)
        return super().sample_relative(study, counted, search_space)


class WarmCmaEsSampler(RowSampler):
    """pycma in the unit cube: trial 0 is one of the best rows, the generations follow.

    The state is that of pycma's object. A new sampler rebuilds it from the study's
    trials, so a resumed study goes on as it would have.
    """

    def __init__(self, task: Task) -> None:
        super().__init__(task.table, task.seed)
        best = score_order(self._table)[:START_ROWS]
        self._row = int(generator(task.seed, Purpose.STARTUP_ROW).choice(best))
        self._draws = generator(task.seed, Purpose.CMAES)
        self._search: Any = None  # pycma's object
        # the generation under way, points of the unit cube
        self._asked: list[Floats] = []
        self._told = 0  # trials of the generations before it

    def sample_relative(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        search_space: dict[str, BaseDistribution],
    ) -> dict[str, Any]:
        """The start point, or the next of the generation.

        Raises:
            InputError: earlier trials are not those that this sampler proposed.
        """
        finished = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        if not finished:
            return self.take(study, trial, self._row)
        if self._search is None:
            self._search = self._begun()
            self._asked = self._search.ask()
        tried = finished[1:]  # the start is of no generation
        while len(tried) >= self._told + len(self._asked):
            told = tried[self._told : self._told + len(self._asked)]
            for point, each in zip(self._asked, told, strict=True):
                for name, value in self._values(point).items():
                    if (found := each.params[name]) != value:
                        allowed = f"{value!r}, which pycma proposes there"
                        raise InputError(f"trial {each.number}: {name}", found, allowed)
            self._search.tell(self._asked, [each.values[0] for each in told])
            self._told += len(told)
            self._asked = self._search.ask()
        return self._values(self._asked[len(tried) - self._told])

    def _begun(self) -> Any:
        """The search whose first generation has its mean at the row, and a spread of sigma."""
        import cma

        rows = self._table.rows
        start = rows.space.fractions(rows.parameters[self._row : self._row + 1])[0]
        options = {
            "bounds": [0.0, 1.0],
            "verbose": -9,
            "seed": np.nan,  # pycma's own seed is NumPy's global one, which all runs would share
            "randn": lambda *shape: self._draws.standard_normal(shape),
            "signals_filename": "",  # it would read options from a file of the current folder
        }
        return cma.CMAEvolutionStrategy(start, SIGMA_WARM, options)

    def _values(self, point: Floats) -> dict[str, Any]:
        space = self._table.rows.space
        return space.values(space.from_fractions(point[None])[0])
