"""Which row of a table to try, or which point near the best rows, by the model of the costs."""

from abc import ABC
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial

from study.draws import Purpose
from study.sampler.acquisition import argmax_random_tie, fading_log_weight
from study.sampler.candidate_table import CandidateTable
from study.sampler.candidates import nearby
from study.sampler.feature_function import Features, call_features
from study.sampler.history import OFF_TABLE, History, noted_features
from study.sampler.mismatch import Mismatch
from study.sampler.model import Model
from study.sampler.options import Options
from study.sampler.points import Points
from study.sampler.prior import FeaturePrior
from study.sampler.rows import Rows
from study.sampler.source import Candidate, Source, gumbel_choice
from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

CENTRES = 8  # best rows that points off the table are near to
INCUMBENTS = 3  # and best trials


class TableChoice(Source, ABC):
    """The choice among rows; how it reaches Optuna is `TableSource`'s.

    Attributes:
        table: whose rows are chosen from.
        function: features of points off the table; None: there are none.
    """

    def __init__(
        self,
        table: CandidateTable,
        function: Features | None,
        options: Options,
        seed: int,
        independent: BaseSampler,
    ) -> None:
        super().__init__(options, seed, independent)
        if options.off_grid and function is None:
            raise InputError("off_grid", options.off_grid, "0 without a feature_function")
        if options.space is not None:
            raise InputError("space", "given", "none: a table knows its own")
        self.table = table
        self.function = function
        if options.prior is not None:
            self._new_prior()

    @property
    def rows(self) -> Rows:
        """The content of the table."""
        return self.table.rows

    def __getstate__(self) -> dict[str, Any]:
        """Without learned constants and what follows from the table."""
        state = super().__getstate__()
        return {key: v for key, v in state.items() if key not in ("_prior", "_log_rank")}

    def startup(self, offered: Mask, own_turn: int) -> Candidate:
        """A row at random, the likelier the better the prior thinks of it."""
        rng = self.rng(Purpose.STARTUP_ROW, own_turn)
        some = offered[self.rows.numbers]
        free, weight = self.rows.numbers[some], self._row_weight(0)
        if weight is None:
            return self._row(int(rng.choice(free)))
        return self._row(int(free[gumbel_choice(weight[some], rng)]))

    def best(self, history: History, offered: Mask, own_turn: int) -> Candidate:
        """The candidate of the largest utility, of equal ones any.

        Args:
            history: at least one finished trial.
            offered: rows that may be proposed, [n].
            own_turn: the trial's.

        Raises:
            InputError: of the feature function.
        """
        rows, kernel = self.rows, self.kernel(own_turn)
        simulated = self._seen(history.parameters, history.rows, history.trials, kernel)
        running = self._seen(history.running, history.running_rows, (), kernel)
        mismatch, seen = self.correction(history, simulated, rows.scale, len(rows.space))
        candidates = self._points(kernel)
        if mismatch is not None:
            candidates, running = mismatch.corrected(candidates), mismatch.corrected(running)
        model = self.model(kernel, len(rows.space), history, seen, running)
        trials, free = len(history.cost), offered[rows.numbers]
        utility = np.full(len(free), -np.inf)
        if free.any():
            rng = self.rng(Purpose.CANDIDATES, own_turn)
            utility = model.utility(candidates, free, self._row_weight(trials), rng)
        if self.options.off_grid:
            near = self._near(history, utility, own_turn)
            value, off = self._best_of(near, kernel, model, mismatch, trials, own_turn)
            if not free.any() or value > utility.max():
                return off
        best = argmax_random_tie(utility, self.rng(Purpose.TIE_BREAK, own_turn))
        return self._row(int(rows.numbers[best]))

    def _near(self, history: History, utility: Floats, own_turn: int) -> Floats:
        """Points near the best rows and the best trials, [off_grid, d]."""
        best = np.argsort(-utility, kind="stable")[:CENTRES]
        best = best[np.isfinite(utility[best])]
        incumbents = history.parameters[np.argsort(history.cost, kind="stable")[:INCUMBENTS]]
        centres = np.vstack([self.rows.parameters[self.rows.numbers[best]], incumbents])
        rng = self.rng(Purpose.OFF_GRID, own_turn)
        return nearby(self.rows.space.pinned(history.fixed), centres, self.options.off_grid, rng)

    def _best_of(
        self,
        near: Floats,
        kernel: str,
        model: Model,
        mismatch: Mismatch | None,
        trials: int,
        own_turn: int,
    ) -> tuple[float, Candidate]:
        """The best of some points off the table, and its utility."""
        assert self.function is not None  # checked with off_grid
        features = call_features(self.function, near, self.rows.features.shape[1])
        points = Points(self.rows.scale.standard(features), self._unit(near, kernel))
        points = points if mismatch is None else mismatch.corrected(points)
        known = np.asarray(np.isfinite(features).all(axis=1))
        rng = self.rng(Purpose.OFF_GRID_UTILITY, own_turn)
        utility = model.utility(points, known, self._log_weight(features, trials), rng)
        best = argmax_random_tie(utility, rng)
        return float(utility[best]), Candidate(OFF_TABLE, near[best], features[best])

    def _row(self, row: int) -> Candidate:
        """A row as a candidate."""
        return Candidate(row, self.rows.parameters[row], self.rows.features[row])

    def _points(self, kernel: str) -> Points:
        """Rows that may be proposed, with coordinates only where the kernel looks at them."""
        if self.needs_coordinates(kernel):
            return self.rows.features_and_coordinates
        return self.rows.features_alone

    def _unit(self, parameters: Floats, kernel: str) -> Floats:
        """Parameters [m, d] as coordinates [m, e]; e = 0 where no kernel looks at them."""
        if not self.needs_coordinates(kernel):
            return np.empty((len(parameters), 0))
        return self.rows.space.unit(parameters)

    def _seen(
        self,
        parameters: Floats,
        numbers: NDArray[np.int64],
        trials: tuple[FrozenTrial, ...],
        kernel: str,
    ) -> Points:
        """Trials as points: features of the table, or as noted, or by the function."""
        rows = self.rows
        features = rows.features[numbers]
        off = np.flatnonzero(numbers == OFF_TABLE)
        features[off] = np.nan
        for place in off if trials else ():
            noted = noted_features(trials[place])
            if noted is not None and len(noted) == features.shape[1]:
                features[place] = noted
        unknown = np.flatnonzero(~np.isfinite(features).any(axis=1))
        if len(unknown) and self.function is not None:
            features[unknown] = call_features(self.function, parameters[unknown], features.shape[1])
        return Points(rows.scale.standard(features), self._unit(parameters, kernel))

    def _log_weight(self, features: Floats, trials: int) -> Floats | None:
        """The prior's weights of features [m, k], as logarithms, [m]; None without a prior."""
        if self.options.prior is None:
            return None
        return fading_log_weight(self._prior.log_rank(features), self.options.prior_weight, trials)

    def _row_weight(self, trials: int) -> Floats | None:
        """The same of the rows that may be proposed."""
        if self.options.prior is None:
            return None
        return fading_log_weight(self._log_rank, self.options.prior_weight, trials)

    @cached_property
    def _log_rank(self) -> Floats:
        """Of the rows that may be proposed, by the prior, made once a process."""
        return self._prior.log_rank(self.rows.features[self.rows.numbers])

    @cached_property
    def _prior(self) -> FeaturePrior:
        """Ranks by the prior's feature, made once a process."""
        return self._new_prior()

    def _new_prior(self) -> FeaturePrior:
        """Ranks by the prior's feature among the rows that may be proposed."""
        assert self.options.prior is not None  # or there is nothing to rank by
        rows = self.rows
        return FeaturePrior.of(self.options.prior, rows.feature_names, rows.features[rows.offered])
