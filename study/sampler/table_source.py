"""Proposals from a table, where it fits what the study suggests."""

from typing import Any

import optuna
from optuna.distributions import BaseDistribution
from optuna.trial import FrozenTrial, TrialState

from study.draws import turn
from study.sampler.claims import withdraw_or_keep
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
from study.sampler.source import Candidate, one_thread, set_attributes
from study.sampler.space import same_kind, takes
from study.sampler.table_choice import TableChoice
from taichi_nmm.errors import InputError


class TableExhaustedError(RuntimeError):
    """Every row of the table has been tried."""


class TableSource(TableChoice):
    """Proposals of rows of a table that no trial has taken and, if asked for, of points near."""

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
            if takes(distribution, values[name]):
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
            return self.startup(offered, own_turn)
        try:
            return self.best(history, offered, own_turn)
        except InputError as error:  # of the feature function
            self.misfit(error)
            return None

    def _usable(self, trial: FrozenTrial) -> bool:
        """Whether a trial off the table can be learned from."""
        noted = FEATURES_ATTRIBUTE in trial.user_attrs
        return self.function is not None or noted or not self.options.uses_features

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
