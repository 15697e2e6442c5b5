"""Which row of a table to try, or which point near the best rows, by the model of the costs."""

from abc import ABC

import numpy as np
from numpy.typing import NDArray
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial

from study.draws import Purpose
from study.sampler import first_trials
from study.sampler.acquisition import Model, argmax_random_tie
from study.sampler.candidate_table import CandidateTable
from study.sampler.candidates import nearby, not_among
from study.sampler.diagnostics import Present
from study.sampler.feature_function import Features, call_features
from study.sampler.history import OFF_TABLE, History, noted_features
from study.sampler.options import Options
from study.sampler.points import Points
from study.sampler.rows import Rows
from study.sampler.source import Candidate, Source
from study.sampler.transforms import Guess, Scale
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
        self.guess = None if options.prior is None else Guess.of(options.prior, self._names)

    @property
    def rows(self) -> Rows:
        """The content of the table."""
        return self.table.rows

    @property
    def _names(self) -> tuple[str, ...]:
        """Of the features, k."""
        return self.table.rows.feature_names

    def startup(self, offered: Mask, own_turn: int) -> Candidate:
        """A row before there is a model, of equal ones any."""
        rows, some = self.rows, offered[self.rows.numbers]
        merit = first_trials.merit(self.options, self.guess, self._points().features, own_turn)
        best = argmax_random_tie(
            np.where(some, merit, -np.inf), self.rng(Purpose.STARTUP_ROW, own_turn)
        )
        return self._row(int(rows.numbers[best]))

    def best(self, history: History, offered: Mask, own_turn: int) -> Candidate:
        """The candidate of the largest utility, of equal ones any.

        Args:
            history: at least one finished trial.
            offered: rows that may be proposed, [n].
            own_turn: the trial's.

        Raises:
            InputError: of the feature function.
        """
        rows = self.rows
        seen = self._seen(history.parameters, history.rows, history.trials)
        running = self._seen(history.running, history.running_rows, ())
        model = self.model(self.guess, len(rows.space), history, seen, running, own_turn)
        free = offered[rows.numbers]
        utility = np.full(len(free), -np.inf)
        if free.any():
            utility = model.utility(self._points(), free, self.rng(Purpose.CANDIDATES, own_turn))
        if self.options.off_grid:
            near = self._near(history, utility, own_turn)
            new = not_among(near, np.vstack([history.parameters, history.running]))
            value, off = self._best_of(near, new, model, own_turn)
            if not free.any() or value > utility.max():
                return off
        best = argmax_random_tie(utility, self.rng(Purpose.TIE_BREAK, own_turn))
        return self._row(int(rows.numbers[best]))

    def known(self, history: History) -> Present:
        """What is known of the features after the finished trials of a history."""
        features = self._shown(history.parameters, history.rows, history.trials)
        return Present(
            self._names,
            features,
            Points(self._scale.standard(features), self._unit(history.parameters)),
            history.cost,
            self._points(),
            self._scale.owners,
            len(self.rows.space),
            self.options.model,
            self.guess,
            self.options.learns_trust,
            self.constants,
        )

    def _near(self, history: History, utility: Floats, own_turn: int) -> Floats:
        """Points near the best rows and the best trials, [off_grid, d]."""
        best = np.argsort(-utility, kind="stable")[:CENTRES]
        best = best[np.isfinite(utility[best])]
        incumbents = history.parameters[np.argsort(history.cost, kind="stable")[:INCUMBENTS]]
        centres = np.vstack([self.rows.parameters[self.rows.numbers[best]], incumbents])
        rng = self.rng(Purpose.OFF_GRID, own_turn)
        return nearby(self.rows.space.pinned(history.fixed), centres, self.options.off_grid, rng)

    def _best_of(
        self, near: Floats, new: Mask, model: Model, own_turn: int
    ) -> tuple[float, Candidate]:
        """The best of some points off the table, of those that are new, and its utility."""
        assert self.function is not None  # checked with off_grid
        features = call_features(self.function, near, len(self._names))
        points = Points(self._scale.standard(features), self._unit(near))
        known = np.asarray(~np.isnan(features).any(axis=1))
        offered = known & new if (known & new).any() else known
        rng = self.rng(Purpose.OFF_GRID_UTILITY, own_turn)
        utility = model.utility(points, offered, rng)
        best = argmax_random_tie(utility, rng)
        return float(utility[best]), Candidate(OFF_TABLE, near[best], features[best])

    def _row(self, row: int) -> Candidate:
        """A row as a candidate."""
        return Candidate(row, self.rows.parameters[row], self.rows.features[row])

    @property
    def _scale(self) -> Scale:
        """Of the features, as the kernel wants them."""
        return self.rows.scale(by_order=self.options.model.by_order)

    def _points(self) -> Points:
        """Rows that may be proposed, with coordinates only where the kernel looks at them."""
        model = self.options.model
        return self.rows.points(by_order=model.by_order, coordinates=model.of_parameters)

    def _unit(self, parameters: Floats) -> Floats:
        """Parameters [m, d] as coordinates [m, e]; e = 0 where the kernel does not look at them."""
        if not self.options.model.of_parameters:
            return np.empty((len(parameters), 0))
        return self.rows.space.unit(parameters)

    def _seen(
        self,
        parameters: Floats,
        numbers: NDArray[np.int64],
        trials: tuple[FrozenTrial, ...],
    ) -> Points:
        """Trials as points, with the features of `_shown`."""
        features = self._shown(parameters, numbers, trials)
        return Points(self._scale.standard(features), self._unit(parameters))

    def _shown(
        self,
        parameters: Floats,
        numbers: NDArray[np.int64],
        trials: tuple[FrozenTrial, ...],
    ) -> Floats:
        """Features of trials, [n, k]: of the table, or as noted, or by the function."""
        rows = self.rows
        features = rows.features[numbers]
        off = np.flatnonzero(numbers == OFF_TABLE)
        features[off] = np.nan
        for place in off if trials else ():
            noted = noted_features(trials[place])
            if noted is not None and len(noted) == features.shape[1]:
                features[place] = noted
        missing = np.isnan(features)  # of points off the table also infinities: none are noted
        unknown = missing.all(axis=1) | (missing.any(axis=1) & (numbers == OFF_TABLE))
        if unknown.any() and self.function is not None:
            features[unknown] = call_features(
                self.function, parameters[unknown], features.shape[1], to_choose=False
            )
        return features
