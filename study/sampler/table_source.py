"""Proposals from a table: its rows that no trial has taken, and points near the best ones."""

from functools import cached_property
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState

from study.draws import Purpose, turn
from study.sampler.acquisition import argmax_random_tie, fading_log_weight
from study.sampler.candidate_table import CandidateTable
from study.sampler.candidates import nearby
from study.sampler.claims import withdraw_or_keep
from study.sampler.feature_function import Features, call_features
from study.sampler.fit import first_misfit, proves_fit
from study.sampler.history import (
    FEATURES_ATTRIBUTE,
    OFF_TABLE,
    ROW_ATTRIBUTE,
    SCORE_ATTRIBUTE,
    History,
    read_history,
    row_of,
)
from study.sampler.model import Model
from study.sampler.options import Options
from study.sampler.points import Points
from study.sampler.prior import FeaturePrior
from study.sampler.rows import Rows
from study.sampler.source import Candidate, Source, gumbel_choice, one_thread, set_attributes
from study.sampler.space import same_kind
from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

CENTRES = 8  # best rows that points off the table are near to
INCUMBENTS = 3  # and best trials
STEP_TOLERANCE = 1e-8  # of a step: how far a value on the grid may be off, as for Optuna


class TableExhaustedError(RuntimeError):
    """Every row of the table has been tried."""


class TableSource(Source):
    """Proposals of rows of a table that no trial has taken and, if asked for, of points near."""

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
        return {key: v for key, v in state.items() if key not in ("_prior", "_everything")}

    def search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """The table's parameters; where it need not fit, once a trial has shown that it does."""
        if not self.options.strict and not proves_fit(self.rows, study, trial):
            self._warn_of_foreign(study)
            return {}
        return self.rows.space.as_dict()

    def propose(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """The parameters of one row, or of a point off the table."""
        rows = self.rows
        left_out = [name for name in rows.names if name not in search_space]
        if left_out:
            if search_space or self.options.strict:
                allowed = "a parameter left free: rows are proposed whole"
                self.misfit(InputError(left_out[0], "fixed", allowed))
            return self.draw(study, trial, search_space)
        misfit = first_misfit(rows, study, trial)
        if misfit is not None:
            self.misfit(misfit)
            return self.draw(study, trial, search_space)
        values = self._values(study, trial)
        if values is None:
            return self.draw(study, trial, search_space)
        return values

    def propose_one(
        self, study: optuna.Study, trial: FrozenTrial, name: str, distribution: BaseDistribution
    ) -> Any:
        """Of the table: its row's value, where that fits. Of others: independent."""
        known = self.rows.space.as_dict().get(name)
        if known is None:
            self._require_table_first(study, trial, name)
        elif self.options.strict:  # Optuna comes here when the row lies outside the study's range
            raise InputError(name, str(distribution), f"the table's range: {known}")
        else:
            value = self._lenient(study, trial, name, distribution, known)
            if value is not None:
                return value
        return self.independent.sample_independent(study, trial, name, distribution)

    def _lenient(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        name: str,
        distribution: BaseDistribution,
        known: BaseDistribution,
    ) -> Any:
        """The row's value if the study's distribution takes it; else None, with one warning."""
        misfit = first_misfit(self.rows, study, trial)
        if misfit is None and same_kind(known, distribution):
            row = row_of(self.rows, trial)
            values = self._values(study, trial) if row is None else self.rows.as_parameters(row)
            if values is None:
                return None
            if _holds(distribution, values[name]):
                return values[name]
        error = InputError(name, str(distribution), f"the table's range: {known}")
        self.misfit(misfit or error)
        return None

    def _require_table_first(self, study: optuna.Study, trial: FrozenTrial, name: str) -> None:
        """Refuse a name that may be a misspelt one of the table, before the trial is run."""
        if not self.options.strict or name in self.options.extra_parameters:
            return
        open_names = [known for known in self.rows.names if known not in trial.params]
        if open_names and not proves_fit(self.rows, study, trial):
            allowed = (
                f"the table's parameters first ({', '.join(open_names[:3])}, ...), "
                f"or extra_parameters=[{name!r}]"
            )
            raise InputError(name, "suggested, and not in the table", allowed)

    def _values(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, Any] | None:
        """The trial's candidate, chosen if need be; None where nothing is left (not strict)."""
        rows = self.rows
        row = row_of(rows, trial)  # a trial that repeats a killed one has its row already
        if row is not None:
            return rows.as_parameters(row)
        withdrawn: set[int] = set()
        while True:
            with one_thread():
                candidate = self._choose(study, trial, withdrawn)
            if candidate is None:
                return None
            self._note(study, trial, candidate)
            if candidate.row == OFF_TABLE or withdraw_or_keep(
                study, trial, candidate.row, withdrawn
            ):
                return rows.space.values(candidate.parameters)

    def _note(self, study: optuna.Study, trial: FrozenTrial, candidate: Candidate) -> None:
        """Leave the row and its features in the trial."""
        features = candidate.features.tolist()
        notes: dict[str, Any] = {ROW_ATTRIBUTE: candidate.row}
        if len(features) == 1:
            notes[SCORE_ATTRIBUTE] = features[0]
        if len(features) > 1 or candidate.row == OFF_TABLE:
            notes[FEATURES_ATTRIBUTE] = features
        set_attributes(study, trial, notes)

    def _choose(
        self, study: optuna.Study, trial: FrozenTrial, withdrawn: set[int]
    ) -> Candidate | None:
        """A row that no trial has taken, or a point off the table."""
        rows, own_turn = self.rows, turn(study, trial)
        history = read_history(study, trial, rows.space, rows, self._usable)
        self._warn_of(history)
        offered = rows.offered & ~history.tried
        offered[list(withdrawn)] = False
        if not offered.any() and not self.options.off_grid:
            error = f"all {len(rows)} rows of the table have been tried"
            if self.options.strict:
                raise TableExhaustedError(error)
            self.warn(f"{error}; the independent sampler takes over")
            return None
        if len(history.cost) < self.options.n_startup_trials and offered.any():
            return self._row(self._startup(offered, own_turn))
        try:
            return self._best(history, offered, own_turn)
        except InputError as error:  # of the feature function
            self.misfit(error)
            return None

    def _startup(self, offered: Mask, own_turn: int) -> int:
        """A row at random, the likelier the better the prior thinks of it."""
        rng = self.rng(Purpose.STARTUP_ROW, own_turn)
        free = np.flatnonzero(offered)
        weight = self._log_weight(self.rows.features, 0)
        return (
            int(rng.choice(free)) if weight is None else int(free[gumbel_choice(weight[free], rng)])
        )

    def _best(self, history: History, offered: Mask, own_turn: int) -> Candidate:
        """The candidate of the largest utility, of equal ones any."""
        rows, kernel = self.rows, self.kernel(own_turn)
        simulated = self._seen(history.parameters, history.rows, history.trials, kernel)
        running = self._seen(history.running, history.running_rows, (), kernel)
        mismatch, seen = self.correction(history, simulated, rows.scale, len(rows.space))
        candidates = self._points(kernel)
        if mismatch is not None:
            candidates, running = mismatch.corrected(candidates), mismatch.corrected(running)
        model = self.model(kernel, len(rows.space), history, seen, running)
        trials = len(history.cost)
        utility = model.utility(
            candidates,
            offered,
            self._log_weight(rows.features, trials),
            self.rng(Purpose.CANDIDATES, own_turn),
        )
        best = argmax_random_tie(utility, self.rng(Purpose.TIE_BREAK, own_turn))
        if not self.options.off_grid:
            return self._row(best)
        near = self._near(history, utility, own_turn)
        value, off = self._best_of(near, kernel, model, mismatch, trials, own_turn)
        return off if value > utility[best] or not offered.any() else self._row(best)

    def _near(self, history: History, utility: Floats, own_turn: int) -> Floats:
        """Points near the best rows and the best trials, [off_grid, d]."""
        best = np.argsort(-utility, kind="stable")[:CENTRES]
        best = best[np.isfinite(utility[best])]
        incumbents = history.parameters[np.argsort(history.cost, kind="stable")[:INCUMBENTS]]
        centres = np.vstack([self.rows.parameters[best], incumbents])
        rng = self.rng(Purpose.OFF_GRID, own_turn)
        return nearby(self.rows.space, centres, self.options.off_grid, rng)

    def _best_of(
        self, near: Floats, kernel: str, model: Model, mismatch: Any, trials: int, own_turn: int
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
        """All n rows, with coordinates only where the kernel looks at them."""
        return self._everything if self.needs_coordinates(kernel) else self.rows.features_alone

    @cached_property
    def _everything(self) -> Points:
        """All n rows with features and coordinates."""
        return Points(self.rows.standard, self.rows.unit)

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
            noted = trials[place].user_attrs.get(FEATURES_ATTRIBUTE)
            if isinstance(noted, list) and len(noted) == features.shape[1]:
                features[place] = noted
        unknown = np.flatnonzero(~np.isfinite(features).any(axis=1))
        if len(unknown) and self.function is not None:
            features[unknown] = call_features(self.function, parameters[unknown], features.shape[1])
        return Points(rows.scale.standard(features), self._unit(parameters, kernel))

    def _usable(self, trial: FrozenTrial) -> bool:
        """Whether a trial off the table can be learned from."""
        noted = FEATURES_ATTRIBUTE in trial.user_attrs
        return self.function is not None or noted or not self.options.uses_features

    def _log_weight(self, features: Floats, trials: int) -> Floats | None:
        """The prior's weights of features [m, k], as logarithms, [m]; None without a prior."""
        if self.options.prior is None:
            return None
        rank = self._prior.rank(features)
        return fading_log_weight(rank, self.options.prior_weight, trials)

    @cached_property
    def _prior(self) -> FeaturePrior:
        """Ranks by the prior's feature, made once a process."""
        return self._new_prior()

    def _new_prior(self) -> FeaturePrior:
        """Ranks by the prior's feature among the rows that may be proposed."""
        assert self.options.prior is not None  # or there is nothing to rank by
        rows = self.rows
        return FeaturePrior.of(self.options.prior, rows.feature_names, rows.features[rows.offered])

    def _warn_of_foreign(self, study: optuna.Study) -> None:
        """Where the table need not fit: say so once a trial has suggested none of its names."""
        finished = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        if finished and not any(name in finished[-1].params for name in self.rows.names):
            self.warn(
                f"the study suggests none of the table's parameters: "
                f"{', '.join(self.rows.names[:3])}, ...; the independent sampler takes over"
            )

    def _warn_of(self, history: History) -> None:
        """Say once that trials off the table teach nothing."""
        if history.unplaced:
            self.warn(
                "trials whose parameters are no row of the table are ignored: such as trial "
                f"{history.unplaced[0]}; enqueue rows of the table instead, or give the sampler "
                "a feature_function"
            )


def _holds(distribution: BaseDistribution, value: Any) -> bool:
    """Whether a value of the same kind lies in a distribution."""
    if isinstance(distribution, CategoricalDistribution):
        return value in distribution.choices
    assert isinstance(distribution, FloatDistribution | IntDistribution)
    if not distribution.low <= value <= distribution.high:
        return False
    if distribution.step is None:
        return True
    steps = (value - distribution.low) / distribution.step
    return bool(abs(steps - round(steps)) < STEP_TOLERANCE)
