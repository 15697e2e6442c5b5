"""Proposals from a table, where it fits what the study suggests."""

from functools import partial
from typing import Any

import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState

from study.draws import turn
from study.sampler import first_trials
from study.sampler.candidate_table import CandidateTable
from study.sampler.claims import withdraw_or_keep
from study.sampler.diagnostics import Present
from study.sampler.feature_function import Features
from study.sampler.fit import distribution_misfit, not_suggested, proves_fit, shown_misfit
from study.sampler.fixed_values import no_row_has
from study.sampler.history import (
    FEATURES_ATTRIBUTE,
    OFF_TABLE,
    ROW_ATTRIBUTE,
    History,
    next_trial,
    read_history,
    row_of,
    values_of,
)
from study.sampler.off_table import IGNORED, OffTable
from study.sampler.options import Options
from study.sampler.proposals import NOTHING, Proposal
from study.sampler.row_notes import notes_of, taken_back
from study.sampler.rows import Rows
from study.sampler.source import Candidate, one_thread, set_attributes
from study.sampler.space import as_suggested
from study.sampler.suggested import Inferred, as_suggested_rows, suggested_so_far
from study.sampler.table_choice import TableChoice
from taichi_nmm.errors import InputError


class TableExhaustedError(RuntimeError):
    """Every row of the table has been tried."""


class TableSource(TableChoice):
    """Proposals of rows of a table that no trial has taken and, if asked for, of points near.

    A trial's row is chosen when the first of the table's parameters is suggested that nobody has
    fixed. Its values are handed out one by one, each as the study suggests it (see `Inferred`).
    """

    def __init__(
        self,
        table: CandidateTable,
        function: Features | None,
        options: Options,
        seed: int,
        independent: BaseSampler,
    ) -> None:
        self._suggested: Rows | None = None
        self._off_table = OffTable(options, function is not None)
        super().__init__(table, function, options, seed, independent)

    @property
    def rows(self) -> Rows:
        """The content of the table, on the scales on which the study suggests it."""
        return self.table.rows if self._suggested is None else self._suggested

    def __getstate__(self) -> dict[str, Any]:
        """Without what follows from the table and the study."""
        return super().__getstate__() | {"_suggested": None}

    def search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """The table's parameters."""
        return Inferred(self.table.rows.space.as_dict())

    def propose(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """What is wrong is said here; of the table, `propose_one` gives the values."""
        asked = {} if isinstance(search_space, Inferred) else search_space
        fixed = values_of(trial)
        if all(name in fixed for name in self.table.rows.names):
            return {}  # nothing of the table is left to choose
        suggested = suggested_so_far(self.table.rows.names, study)
        self._adopt(suggested)
        if not self.options.strict:
            self._warn_of_foreign(study)
        misfit = self._misfit(study, search_space, suggested)
        if misfit is not None:
            self._refuse(study, trial, misfit)
        proposal = self._proposal(study, trial) if asked else NOTHING
        if not proposal.values:
            return self.draw(study, trial, asked)
        values = {}
        for name, distribution in asked.items():
            try:
                values[name] = as_suggested(distribution, proposal.values[name])
            except (KeyError, ValueError):
                continue  # of another table, or not held: for `propose_one`
        return values

    def propose_one(
        self, study: optuna.Study, trial: FrozenTrial, name: str, distribution: BaseDistribution
    ) -> Any:
        """Of the table: its row's value, where all rows fit. Of others: independent."""
        if name not in self.rows.names:
            self._require_table_first(study, trial, name)
            return self.independent.sample_independent(study, trial, name, distribution)
        proposal = self._proposal(study, trial)
        if proposal.values:
            error = distribution_misfit(self.table.rows, self.rows.names.index(name), distribution)
            try:
                if error is None:
                    return as_suggested(distribution, proposal.values[name])
            except ValueError:
                value = proposal.values[name]
                allowed = f"what has {value!r}, a point off the table (give it this by space=)"
                error = InputError(name, str(distribution), allowed)
            self._refuse(study, trial, error)
        return self.independent.sample_independent(study, trial, name, distribution)

    def present(self, study: optuna.Study) -> Present:
        """With all rows that may be proposed, tried or not."""
        self._adopt(suggested_so_far(self.table.rows.names, study))
        return self.known(self._history(study, next_trial(study)).finished)

    def before(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Note the row of a trial that was enqueued with all parameters of one.

        At its start, so that other workers see it; none of its parameters is asked for here.
        """
        if len(study.directions) > 1 or not values_of(trial):
            return
        rows, row = self.table.rows, self.table.rows.find(values_of(trial))
        if row is not None and row_of(rows, trial) != trial.user_attrs.get(ROW_ATTRIBUTE):
            set_attributes(study, trial, notes_of(row, rows.features[row]))

    def after(self, study: optuna.Study, trial: FrozenTrial, state: TrialState) -> None:
        """See to it that what is noted in the trial is what was run.

        Raises:
            InputError: the objective has returned without suggesting all of the table, or has left
                no choice of some parameter (strict).
        """
        proposal = self.proposals.take(trial) or NOTHING
        if len(study.directions) > 1:
            return
        rows, noted = self.table.rows, trial.user_attrs.get(ROW_ATTRIBUTE)
        ended = state is TrialState.COMPLETE
        missing = not_suggested(rows, trial) if ended else None
        other = proposal.other_in(trial.params)
        row, known = rows.find(trial.params), row_of(rows, trial)
        if row is not None and known != noted:
            set_attributes(study, trial, notes_of(row, rows.features[row]))
        wrong = missing is not None or other is not None or noted not in (OFF_TABLE, known)
        if row is None and noted is not None and wrong:
            self._take_back(study, trial)
        asked = noted is not None or (self.options.strict and bool(trial.params))
        if missing is not None and asked:
            self.misfit(missing)
        elif ended and other is not None:
            self.misfit(self._not_as_proposed(trial, other, proposal))

    def _not_as_proposed(self, trial: FrozenTrial, name: str, proposal: Proposal) -> InputError:
        """Of a parameter that had another value: no sampler is asked of a range of one value."""
        column, suggested = self.table.rows.names.index(name), trial.distributions[name]
        allowed = f"{proposal.values[name]!r}, as was proposed"
        own = InputError(name, trial.params[name], allowed)
        return distribution_misfit(self.table.rows, column, suggested) or own

    def _misfit(
        self,
        study: optuna.Study,
        search_space: dict[str, BaseDistribution],
        suggested: dict[str, BaseDistribution],
    ) -> InputError | None:
        """What is wrong before anything is chosen.

        Something is fixed elsewhere; or, where the table need not fit, trials have shown that it
        does not. Where it must, what this trial suggests is an error by itself, and what others
        did (of an earlier study, of an objective that was mended since) is none.
        """
        for name in self.rows.names:
            if name not in search_space:
                return InputError(name, "fixed", "a parameter left free: rows are proposed whole")
        return None if self.options.strict else shown_misfit(self.table.rows, suggested, study)

    def _refuse(self, study: optuna.Study, trial: FrozenTrial, error: InputError) -> None:
        """Propose nothing of the table for this trial; an error, or a warning (not strict)."""
        proposal = self.proposals.of(trial)
        if proposal is not None and proposal.notes:
            self._take_back(study, trial)
        self.proposals.keep(trial, NOTHING)
        self.misfit(error)

    def _adopt(self, suggested: dict[str, BaseDistribution]) -> None:
        """Put the rows on the scales that the study is known to suggest."""
        rows = as_suggested_rows(self.table.rows, suggested)
        if rows.space.distributions != self.rows.space.distributions:
            self._suggested = rows

    def _require_table_first(self, study: optuna.Study, trial: FrozenTrial, name: str) -> None:
        """Refuse a name that may be a misspelt one of the table, before the trial is run."""
        if not self.options.strict or name in self.options.extra_parameters:
            return
        open_names = [known for known in self.rows.names if known not in trial.params]
        if open_names and not proves_fit(self.table.rows, study):
            allowed = (
                f"the table's parameters first ({', '.join(open_names[:3])}, ...), "
                f"or extra_parameters=[{name!r}]"
            )
            raise InputError(name, "suggested, and not in the table", allowed)

    def _proposal(self, study: optuna.Study, trial: FrozenTrial) -> Proposal:
        """The trial's, chosen if need be; without values where the independent sampler has it."""
        proposal = self.proposals.of(trial)
        if proposal is None:
            proposal = self._propose_row(study, trial)
            self.proposals.keep(trial, proposal)
        return proposal

    def _propose_row(self, study: optuna.Study, trial: FrozenTrial) -> Proposal:
        """A candidate that no other trial has, noted in the trial."""
        rows = self.rows
        row = row_of(rows, trial)  # a trial that repeats a killed one has its row already
        if row is not None:
            return Proposal(rows.as_parameters(row), notes_of(row, rows.features[row]))
        withdrawn: set[int] = set()
        while True:
            try:
                with one_thread():
                    candidate = self._choose(study, trial, withdrawn)
            except (InputError, TableExhaustedError):
                self._withdraw(study, trial, withdrawn)
                raise
            if candidate is None:
                self._withdraw(study, trial, withdrawn)
                return NOTHING
            notes = notes_of(candidate.row, candidate.features)
            set_attributes(study, trial, notes)
            if candidate.row == OFF_TABLE or withdraw_or_keep(
                study, trial, rows, candidate.row, withdrawn
            ):
                return Proposal(rows.space.values(candidate.parameters), notes)

    def _withdraw(self, study: optuna.Study, trial: FrozenTrial, withdrawn: set[int]) -> None:
        """Take back the note of a row that another worker has."""
        if withdrawn:
            self._take_back(study, trial)

    def _take_back(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Say in a trial that it is no row."""
        listed = self.options.off_grid > 0 or FEATURES_ATTRIBUTE in trial.user_attrs
        width = self.table.rows.features.shape[1]
        set_attributes(study, trial, taken_back(width, listed))

    def _choose(
        self, study: optuna.Study, trial: FrozenTrial, withdrawn: set[int]
    ) -> Candidate | None:
        """A row that no trial has taken, or a point off the table."""
        rows, own_turn = self.rows, turn(study, trial)
        history = self._history(study, trial)
        self._warn_of(history)
        offered = rows.offered & ~history.tried
        offered[list(withdrawn)] = False
        if history.fixed:
            offered &= rows.having(history.fixed)
        if not offered.any() and not (self.options.off_grid and len(history.cost)):
            self._say_none_is_left(history)
            return None
        if len(history.cost) < first_trials.count(self.options) and offered.any():
            return self.startup(offered, own_turn)
        try:
            return self.best(history, offered, own_turn)
        except InputError as error:  # of the feature function
            self.misfit(error)
            return None

    def _history(self, study: optuna.Study, trial: FrozenTrial) -> History:
        """What a trial is proposed from."""
        rows = self.rows
        features_of = partial(self._off_table.features_of, rows)
        return read_history(study, trial, rows.space, rows, features_of)

    def _say_none_is_left(self, history: History) -> None:
        """An error or a warning: no row may be proposed, or none that has the fixed values."""
        if history.fixed:
            error = no_row_has(self.rows, history.fixed)
            if not self._off_table.may_teach:
                self.misfit(error)
            else:
                self.warn(f"{error}; the independent sampler takes over")
            return
        message = f"all {len(self.rows)} rows of the table have been tried"
        if self.options.strict:
            raise TableExhaustedError(message)
        self.warn(f"{message}; the independent sampler takes over")

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
        if history.unplaced and IGNORED not in self._said:
            self.warn(self._off_table.ignored(self.rows, history.unplaced[0]))
