"""The determinants-of-gait sampler: a Gaussian process over a score chooses rows of a table.

The kernel of Antonova, Rai, Atkeson 2016: two parameter sets are alike when their scores are, the
score of each having been computed beforehand. A trial is a row of the table, named by its number.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState
from threadpoolctl import threadpool_limits

from study.acquisition import argmax_random_tie, expected_improvement
from study.draws import Purpose, generator, seed_32bit, turn
from study.gaussian_process import ScoreProcess
from study.history import ROW_ATTRIBUTE, SCORE_ATTRIBUTE, History, read_history, row_of
from study.random_sampler import ReproducibleRandomSampler, new_seed
from study.score_table import Rows, ScoreTable
from taichi_nmm.errors import InputError

STARTUP_TRIALS = 3  # rows at random before the first fit

_logger = optuna.logging.get_logger(__name__)


class TableExhaustedError(RuntimeError):
    """Every row of the table has been tried."""


class DoGSampler(BaseSampler):
    """Expected improvement over the untried rows of a table, under a kernel on their score.

    After `n_startup_trials` rows at random, a process constant x RBF(score) + white noise is fitted
    to the finished trials (`study.gaussian_process`) and the row of the largest expected
    improvement is proposed; of the many rows that share it, one at random.

    What it promises: everything is recomputed from the study's trials, and each draw is seeded by
    the seed and the trial, so a resumed study or another process proposes the same. A row is
    proposed once: rows of running, failed and pruned trials are not proposed again, though only
    finished ones are learned from. A finished trial whose parameters are no row of the table
    (one that was enqueued by hand) is ignored, with one warning.

    It writes two user attributes, `row` and `score`, to each trial that it proposes.

    Args:
        table: parameter sets and their scores.
        seed: of all draws; None takes one from the machine's entropy.
        n_startup_trials: rows taken at random before the first fit, at least 1.
        independent_sampler: for parameters of the study that the table does not have.

    Raises:
        InputError: in a trial, before its objective has its parameters: the study suggests a
            parameter of the table with a range that does not hold the row, or never suggests it,
            or fixes it.
        TableExhaustedError: in a trial, when no row is left.
        ValueError: in a trial of a study with several objectives.
    """

    def __init__(
        self,
        table: ScoreTable,
        *,
        seed: int | None = None,
        n_startup_trials: int = STARTUP_TRIALS,
        independent_sampler: BaseSampler | None = None,
    ) -> None:
        """Read nothing yet but the options."""
        if n_startup_trials < 1:
            raise InputError("n_startup_trials", n_startup_trials, "1 or more")
        self._table = table
        self._seed = new_seed() if seed is None else seed
        self._n_startup_trials = n_startup_trials
        self._independent = independent_sampler or ReproducibleRandomSampler(seed=self._seed)
        self._warned = False

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """The parameters of the table, with its bounds."""
        rows = self._table.rows
        bounds = zip(rows.names, rows.low.tolist(), rows.high.tolist(), strict=True)
        return {name: FloatDistribution(low, high) for name, low, high in bounds}

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """The parameters of one row."""
        self._raise_error_if_multi_objective(study)
        rows = self._table.rows
        for name in self.infer_relative_search_space(study, trial):
            if name not in search_space:
                raise InputError(name, "fixed", "a parameter left free: rows are proposed whole")
        row = row_of(rows, trial)  # a trial that repeats a killed one has its row already
        if row is None:
            with threadpool_limits(limits=1, user_api="blas"):  # more threads are slower
                row = self._propose(rows, study, trial)
            _set_user_attribute(study, trial, ROW_ATTRIBUTE, row)
            _set_user_attribute(study, trial, SCORE_ATTRIBUTE, float(rows.score[row]))
        parameters = rows.as_parameters(row)
        return {name: parameters[name] for name in search_space}

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """Parameters that the table does not have go to the independent sampler."""
        self._raise_error_if_multi_objective(study)
        known = self.infer_relative_search_space(study, trial).get(param_name)
        if known is not None:  # Optuna comes here when the row lies outside the study's range
            raise InputError(param_name, str(param_distribution), f"the table's range: {known}")
        return self._independent.sample_independent(study, trial, param_name, param_distribution)

    def before_trial(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Passed on to the independent sampler."""
        self._independent.before_trial(study, trial)

    def after_trial(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        state: TrialState,
        values: Sequence[float] | None,
    ) -> None:
        """Passed on to the independent sampler."""
        self._independent.after_trial(study, trial, state, values)

    def reseed_rng(self) -> None:
        """Passed on to the independent sampler; rows differ by the trials that take them."""
        self._independent.reseed_rng()

    def _propose(self, rows: Rows, study: optuna.Study, trial: FrozenTrial) -> int:
        """A row that no trial has taken."""
        history = read_history(rows, study, trial)
        self._warn_of(history)
        untried = np.flatnonzero(~history.tried)
        if not len(untried):
            raise TableExhaustedError(f"all {len(rows)} rows of the table have been tried")
        own_turn = turn(study, trial)
        if len(history.observed) < self._n_startup_trials:
            return int(generator(self._seed, Purpose.STARTUP_ROW, own_turn).choice(untried))
        improvement = self._expected_improvement(rows, history, untried, own_turn)
        tie_break = generator(self._seed, Purpose.TIE_BREAK, own_turn)
        return int(untried[argmax_random_tie(improvement, tie_break)])

    def _expected_improvement(
        self, rows: Rows, history: History, candidates: NDArray[np.int64], own_turn: int
    ) -> NDArray[np.float64]:
        """Of each candidate row, [m]; computed once for rows of equal score."""
        process = ScoreProcess.fit(
            rows.standard_score[history.observed],
            history.cost,
            seed_32bit(self._seed, Purpose.GP_RESTARTS, own_turn),
        )
        score, place = np.unique(rows.standard_score[candidates], return_inverse=True)
        mean, sd = process.predict(score)
        return expected_improvement(mean, sd, float(history.cost.min()))[place]

    def _warn_of(self, history: History) -> None:
        if history.unplaced and not self._warned:
            self._warned = True
            _logger.warning(
                f"DoGSampler ignores trials whose parameters are no row of its table, such as "
                f"trial {history.unplaced[0]}; enqueue rows of the table instead."
            )


def _set_user_attribute(study: optuna.Study, trial: FrozenTrial, key: str, value: Any) -> None:
    """Leave a note in a running trial: samplers are given no public way, Optuna's own do this."""
    study._storage.set_trial_user_attr(trial._trial_id, key, value)
