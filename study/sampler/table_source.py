"""Proposals from a table, where it fits what the study suggests."""

from math import isfinite
from typing import Any

import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState

from study.draws import turn
from study.sampler.candidate_table import CandidateTable
from study.sampler.claims import withdraw_or_keep
from study.sampler.feature_function import Features
from study.sampler.fit import distribution_misfit, not_suggested, proves_fit, shown_misfit
from study.sampler.history import (
    FEATURES_ATTRIBUTE,
    OFF_TABLE,
    ROW_ATTRIBUTE,
    SCORE_ATTRIBUTE,
    Floats,
    History,
    noted_features,
    read_history,
    row_of,
    values_of,
)
from study.sampler.nearest_row import NearestRow
from study.sampler.options import Options
from study.sampler.proposals import NOTHING, Proposal
from study.sampler.rows import Rows
from study.sampler.source import Candidate, one_thread, set_attributes
from study.sampler.space import as_suggested
from study.sampler.suggested import Inferred, as_suggested_rows, suggested_so_far
from study.sampler.table_choice import TableChoice
from taichi_nmm.errors import InputError

IGNORED = "trials whose parameters are no row of the table are ignored"


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
        self._nearest: NearestRow | None = None
        super().__init__(table, function, options, seed, independent)
        if options.nearest is not None and function is not None:
            allowed = "none with a feature_function, which knows the features of any point"
            raise InputError("nearest", options.nearest, allowed)

    @property
    def rows(self) -> Rows:
        """The content of the table, on the scales on which the study suggests it."""
        return self._suggested or self.table.rows

    def __getstate__(self) -> dict[str, Any]:
        """Without what follows from the table and the study."""
        return super().__getstate__() | {"_suggested": None, "_nearest": None}

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

    def before(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Note the row of a trial that was enqueued with all parameters of one.

        At its start, so that other workers see it; none of its parameters is asked for here.
        """
        fixed = values_of(trial)
        if fixed and ROW_ATTRIBUTE not in trial.user_attrs and len(study.directions) == 1:
            row = self.table.rows.find(fixed)
            if row is not None:
                set_attributes(study, trial, self._notes(row, self.table.rows.features[row]))

    def after(self, study: optuna.Study, trial: FrozenTrial, state: TrialState) -> None:
        """See to it that what is noted in the trial is what was run.

        Raises:
            InputError: the objective has returned without suggesting all of the table (strict).
        """
        if len(study.directions) > 1:
            return
        rows, proposal = self.table.rows, self.proposals.take(trial)
        noted = trial.user_attrs.get(ROW_ATTRIBUTE)
        row = rows.find(trial.params)
        if noted is None:
            if row is not None:
                set_attributes(study, trial, self._notes(row, rows.features[row]))
            return
        missing = not_suggested(rows, trial) if state is TrialState.COMPLETE else None
        if missing is not None:
            self._take_back(study, trial)
            self.misfit(missing)
        elif noted == OFF_TABLE and row is None:
            if proposal is not None and not proposal.was_run(trial.params):
                self._take_back(study, trial)
        elif noted == OFF_TABLE or row_of(rows, trial) != noted:
            if row is None:
                self._take_back(study, trial)
            else:
                set_attributes(study, trial, self._notes(row, rows.features[row]))

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
            return Proposal(rows.as_parameters(row), self._notes(row, rows.features[row]))
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
            notes = self._notes(candidate.row, candidate.features)
            set_attributes(study, trial, notes)
            if candidate.row == OFF_TABLE or withdraw_or_keep(
                study, trial, rows, candidate.row, withdrawn
            ):
                return Proposal(rows.space.values(candidate.parameters), notes)

    def _withdraw(self, study: optuna.Study, trial: FrozenTrial, withdrawn: set[int]) -> None:
        """Take back the note of a row that another worker has."""
        if withdrawn:
            self._take_back(study, trial)

    def _notes(self, row: int, features: Floats) -> dict[str, Any]:
        """What is left in a trial: the row and its features, those unknown as None."""
        values = [value if isfinite(value) else None for value in features.tolist()]
        notes: dict[str, Any] = {ROW_ATTRIBUTE: row}
        if len(values) == 1:
            notes[SCORE_ATTRIBUTE] = values[0]
        if len(values) > 1 or row == OFF_TABLE:
            notes[FEATURES_ATTRIBUTE] = values
        return notes

    def _take_back(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Say in a trial that it is no row; attributes cannot be removed."""
        one = self.table.rows.features.shape[1] == 1
        noted = SCORE_ATTRIBUTE if one else FEATURES_ATTRIBUTE
        notes: dict[str, Any] = {ROW_ATTRIBUTE: OFF_TABLE, noted: None}
        if one and trial.user_attrs.get(FEATURES_ATTRIBUTE) is not None:
            notes[FEATURES_ATTRIBUTE] = None  # of a point off the table
        set_attributes(study, trial, notes)

    def _choose(
        self, study: optuna.Study, trial: FrozenTrial, withdrawn: set[int]
    ) -> Candidate | None:
        """A row that no trial has taken, or a point off the table."""
        rows, own_turn = self.rows, turn(study, trial)
        history = read_history(study, trial, rows.space, rows, self._features_of)
        self._warn_of(history)
        offered = rows.offered & ~history.tried
        offered[list(withdrawn)] = False
        if history.fixed:
            offered &= rows.having(history.fixed)
        if not offered.any() and not (self.options.off_grid and len(history.cost)):
            self._say_none_is_left(history)
            return None
        if len(history.cost) < self.options.n_startup_trials and offered.any():
            return self.startup(offered, own_turn)
        try:
            return self.best(history, offered, own_turn)
        except InputError as error:  # of the feature function
            self.misfit(error)
            return None

    def _say_none_is_left(self, history: History) -> None:
        """An error or a warning: no row may be proposed, or none that has the fixed values."""
        if history.fixed:
            error = self._no_such_row(history)
            if self._any_is_usable:
                self.warn(f"{error}; the independent sampler takes over")
            else:
                self.misfit(error)
            return
        message = f"all {len(self.rows)} rows of the table have been tried"
        if self.options.strict:
            raise TableExhaustedError(message)
        self.warn(f"{message}; the independent sampler takes over")

    def _no_such_row(self, history: History) -> InputError:
        """Of values that were fixed in a trial, the rest being left to the sampler."""
        fixed, having = history.fixed, self.rows.having(history.fixed)
        name, value = ", ".join(fixed), tuple(fixed.values())
        what = "values that a row of the table has together"
        if having.any():
            what = "values of a row that has not been tried"
        elif len(fixed) == 1:
            what = "a value that a row of the table has"
            near = self._nearest_value(name, value[0])
            what += "" if near is None else f", such as {near!r}"
        allowed = f"{what}; or all parameters, in enqueue_trial"
        return InputError(name, value[0] if len(value) == 1 else value, allowed)

    def _nearest_value(self, name: str, value: Any) -> Any:
        """The value of a row that is nearest to a number; None for what is no number."""
        column = self.rows.names.index(name)
        number = self.rows.space.number(column, value)
        if number is None:
            return None
        distances = abs(self.rows.parameters[:, column] - number)
        return self.rows.as_parameters(int(distances.argmin()))[name]

    @property
    def _any_is_usable(self) -> bool:
        """Whether trials off the table may be learned from."""
        near = self.options.nearest is not None
        return near or self.function is not None or not self.options.uses_features

    def _features_of(self, trial: FrozenTrial, parameters: Floats) -> int | None:
        """The row that lends its features to a trial off the table (see `read_history`)."""
        if self.function is not None or not self.options.uses_features:
            return OFF_TABLE
        if noted_features(trial) is not None:
            return OFF_TABLE
        if self.options.nearest is None:
            return None
        row, distance = self._nearest_row(parameters)
        return row if distance <= self.options.nearest else None

    def _nearest_row(self, parameters: Floats) -> tuple[int, float]:
        """The nearest row of a point [d], and its distance."""
        if self._nearest is None or self._nearest.rows is not self.rows:
            self._nearest = NearestRow(self.rows)
        return self._nearest.of(parameters)

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
        if not history.unplaced or IGNORED in self._said:
            return
        trial, far = history.unplaced[0], ""
        parameters = self.rows.space.row(trial.params)
        if parameters is not None:
            far = f", {self._nearest_row(parameters)[1]:.2g} from its nearest row"
        self.warn(
            f"{IGNORED}: such as trial {trial.number}{far}; enqueue rows of the table instead, or "
            "give the sampler a feature_function, or nearest=, the distance at which a row lends "
            "its features"
        )
