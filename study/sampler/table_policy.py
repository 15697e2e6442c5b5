"""Proposals from a table: which row to try next, or which point near the best rows.

Workers that share a study come to propose different rows with no lock between them. A
worker writes the number of its row into its trial, and only then reads the trials
again. Of two that choose one row, the one that writes later is sure to see the other's
number and takes another row; if both write before either reads, both do. Nobody waits.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState

from storage.inputs.errors import InputError
from study.sampler.acquisition import Aim, Model, argmax_random_tie
from study.sampler.arrays import Floats, Mask
from study.sampler.asking import Asked
from study.sampler.covariance import WITH_WORLDS
from study.sampler.diagnostics import Present
from study.sampler.draws import Purpose, turn
from study.sampler.evidence import RANKED, RANKED_OF_ONE
from study.sampler.history import (
    NOTES,
    OFF_TABLE,
    ROW_ATTRIBUTE,
    WHY_ATTRIBUTE,
    History,
    Inferred,
    LookedUp,
    Placed,
    as_suggested_rows,
    distribution_misfit,
    is_own,
    next_trial,
    no_row_has,
    not_suggested,
    notes_of,
    placed,
    proves_fit,
    read_history,
    row_of,
    run_otherwise,
    shown_misfit,
    suggested_so_far,
    values_of,
)
from study.sampler.off_table import OffTable
from study.sampler.policy import (
    NOTHING,
    ODD_TURN,
    Features,
    Options,
    Policy,
    Proposal,
    TableExhaustedError,
    features_of,
    one_thread,
    points_of,
    set_attributes,
    take_back,
)
from study.sampler.prediction import Prediction, prediction_of
from study.sampler.risk import Certificate, Places, all_kept, by_trials, risks_of
from study.sampler.rows import Rows
from study.sampler.similarity import Relation
from study.sampler.space import as_suggested
from study.sampler.space_policy import by_parameters
from study.sampler.table import FeatureTable
from study.sampler.transforms import Points
from study.sampler.worlds import Ensemble


class TablePolicy(Policy):
    """Proposals of rows of a table that no trial has taken and, if asked for, of points near.

    A trial's row is chosen when the first of the table's parameters is suggested that
    nobody has fixed. Its values are handed out one by one, each as the study suggests
    it (see `Inferred`).
    """

    def __init__(
        self,
        table: FeatureTable,
        function: Features | None,
        options: Options,
        seed: int,
        independent: BaseSampler,
    ) -> None:
        in_worlds = options.kernel == WITH_WORLDS
        super().__init__(None if in_worlds else function, options, seed, independent)
        self._asked = None
        if in_worlds and function is not None:
            self._asked = Asked(function)
        self._table = table
        self._suggested: Rows | None = None
        self._looked_up: LookedUp = {}
        worlds = self.own_rows.worlds if in_worlds else None
        # Costs in worlds are a model before any trial. What only ranks tells no cost.
        self._in_costs = worlds is not None and worlds.better is None
        if worlds is not None:
            self.first_trials = RANKED

    @cached_property
    def own_rows(self) -> Rows:
        """The content of the table, on its own scales."""
        return self._table.rows

    @property
    def rows(self) -> Rows:
        """The content of the table, on the scales on which the study suggests it."""
        return self.own_rows if self._suggested is None else self._suggested

    def __getstate__(self) -> dict[str, Any]:
        """The state without rows and trials, which follow from the table and the study."""
        state = super().__getstate__() | {"_suggested": None, "_looked_up": {}}
        return {name: value for name, value in state.items() if name != "own_rows"}

    def search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """The table's parameters."""
        return Inferred(self.own_rows.space.as_dict())

    def propose(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        search_space: dict[str, BaseDistribution],
    ) -> dict[str, Any]:
        """Refuse what does not fit; values are given by `propose_one`.

        Where the table must fit (strict), only what this trial suggests is refused, not
        what others did: those of an earlier study, or of an objective that was mended
        since.
        """
        fixed, names = values_of(trial), self.own_rows.names
        if all(name in fixed for name in names):
            return {}  # nothing of the table is left to choose
        suggested = self._adopt(study)
        misfit = None
        if not self.options.strict:
            self._warn_of_other_names(study)
            misfit = shown_misfit(self.own_rows, suggested, study)
        taken = [name for name in names if name not in search_space]
        if taken:
            allowed = "a parameter left free: rows are proposed whole"
            misfit = InputError(taken[0], "fixed", allowed)
        if misfit is not None:
            self._refuse(study, trial, misfit)
        if isinstance(search_space, Inferred):
            return {}
        return {
            name: self.propose_one(study, trial, name, d)
            for name, d in search_space.items()
        }

    def _warn_of_other_names(self, study: optuna.Study) -> None:
        """Warn where the latest finished trial suggested none of the table's parameters."""
        names = self.own_rows.names
        finished = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        if finished and not any(name in finished[-1].params for name in names):
            first = ", ".join(names[:3])
            none = "the study suggests none of the table's parameters"
            self.take_over(f"{none}: {first}, ...")

    def propose_one(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        name: str,
        distribution: BaseDistribution,
    ) -> Any:
        """The value of the trial's row, where all rows fit; other parameters are independent."""
        if name not in self.rows.names:
            self._require_table_first(study, trial, name)
            return self.independent.sample_independent(study, trial, name, distribution)
        proposal = self.remembered(trial)
        if proposal is None:
            proposal = self._propose_row(study, trial)
            self.remember(trial, proposal)
        if not proposal.values:
            return self.independent.sample_independent(study, trial, name, distribution)
        value = proposal.values[name]
        column = self.rows.names.index(name)
        error = distribution_misfit(self.own_rows, column, distribution)
        if error is None:
            try:
                return as_suggested(distribution, value)
            except ValueError:
                allowed = f"what has {value!r}, a point off the table (give it this by space=)"
                error = InputError(name, str(distribution), allowed)
        self._refuse(study, trial, error)
        return self.independent.sample_independent(study, trial, name, distribution)

    def _adopt(self, study: optuna.Study) -> dict[str, BaseDistribution]:
        """Put the rows on the logarithmic scales that the study suggests: what it suggests."""
        suggested = suggested_so_far(self.own_rows.names, study)
        rows = as_suggested_rows(self.own_rows, suggested)
        if rows.space.distributions != self.rows.space.distributions:
            self._suggested = rows
        return suggested

    def _refuse(
        self, study: optuna.Study, trial: FrozenTrial, error: InputError
    ) -> None:
        """Propose nothing of the table for this trial; an error, or a warning (not strict)."""
        proposal = self.remembered(trial)
        if proposal is not None:
            take_back(study, trial, proposal.notes)
        self.remember(trial, NOTHING)
        self.misfit(error)

    def _require_table_first(
        self, study: optuna.Study, trial: FrozenTrial, name: str
    ) -> None:
        """Refuse a name that may be a misspelt one of the table, before the trial is run."""
        if not self.options.strict or name in self.options.extra_parameters:
            return
        open_names = [known for known in self.rows.names if known not in trial.params]
        if open_names and not proves_fit(self.own_rows, study):
            allowed = (
                f"the table's parameters first ({', '.join(open_names[:3])}, ...), "
                f"or extra_parameters=[{name!r}]"
            )
            raise InputError(name, "suggested, and not in the table", allowed)

    def _propose_row(self, study: optuna.Study, trial: FrozenTrial) -> Proposal:
        """A candidate that no other trial has, noted in the trial."""
        # A trial that repeats a killed one has its row already.
        row = row_of(self.rows, trial)
        if row is not None:
            return self._of_row(row)
        withdrawn: set[int] = set()
        noted: dict[str, Any] = {}
        while True:
            try:
                with one_thread():
                    proposal = self._choose(study, trial, withdrawn)
            except (InputError, TableExhaustedError) as error:
                take_back(study, trial, noted)
                self.misfit(error)
                return NOTHING
            if proposal is NOTHING:
                take_back(study, trial, noted)
                return NOTHING
            noted |= proposal.notes
            set_attributes(study, trial, proposal.notes)
            row = proposal.notes[ROW_ATTRIBUTE]
            if row == OFF_TABLE or is_own(self.rows, study, trial, row):
                return proposal
            withdrawn.add(row)

    def _choose(
        self, study: optuna.Study, trial: FrozenTrial, withdrawn: set[int]
    ) -> Proposal:
        """A row that no trial has taken, or a point off the table.

        Raises:
            InputError: nothing can be proposed: worlds with other goals than the study,
                fixed values that no row has, or a feature function that fails.
            RiskError: no candidate has a risk as small as is allowed.
            TableExhaustedError: no row is left.
        """
        rows, own_turn = self.rows, turn(study, trial)
        history = self._history(study, trial)
        if history.unplaced:
            self.warn(
                "trials whose parameters are no row of the table are ignored: such as trial "
                f"{history.unplaced[0].number}; enqueue rows of the table instead, or give the "
                "table outcomes in worlds, or the sampler a feature_function"
            )
        self._warn_of_success(history)
        offered = rows.offered.copy()
        if self.options.allowed is not None:
            offered &= self.options.allowed
        count = int(offered.sum())
        offered &= ~history.tried
        offered[list(withdrawn)] = False
        if history.fixed:
            offered &= rows.having(history.fixed)
        is_near = bool(self.options.off_grid and len(history.cost))
        if not offered.any() and not is_near:
            if not history.fixed:
                message = f"all {count} rows that may be proposed have been tried"
                raise TableExhaustedError(message)
            error = no_row_has(rows, history.fixed)
            # Of values drawn at random nobody would know the risk.
            if not self._places_all or self.options.allowed_risk is not None:
                raise error
            self.take_over(error)  # what the user fixed is tried all the same
            return NOTHING
        certificate = None
        if self.options.allowed_risk is not None:
            model = self._model(history, own_turn)
            certificate = Certificate.of(
                self.options.allowed_risk,
                partial(self._risks, history, model),
                Places(rows.numbers, rows.unit),
                self._points(model.ensemble),
                offered,
            )
            offered = certificate.offered
            if not offered.any() and not is_near:
                raise certificate.refusal()
        if offered.any() and self._begins(history):
            return self._first_row(offered, own_turn, self._ensemble(history))
        found = self._best_candidate(history, offered, own_turn, certificate)
        if found is NOTHING and certificate is not None:
            raise certificate.refusal()
        return found

    def _risks(
        self, history: History, model: Model, places: Places, points: Points
    ) -> dict[str, Floats]:
        """The chance to break each limit at places, which are these points, [k]."""
        return risks_of(
            self.rows,
            history,
            self.options.limits_of,
            places,
            partial(by_trials, model, points, partial(self.errors, model)),
        )

    def _warn_of_success(self, history: History) -> None:
        """Warn where no row has a success in any world, or all have: its unit or sign may be wrong.

        Not beside infinite outcomes, for which numbers stand in.
        """
        given, success = self.rows.worlds, self.options.success
        if success is None or given is None or given.as_before is not None:
            return
        worlds = self._ensemble(history)
        if not isinstance(worlds, Ensemble) or not worlds.in_costs:
            return
        best, worst = history.sign * worlds.costs(np.array(worlds.ends))
        cost = history.sign * success
        if not worlds.reaches(cost):
            what = f"is better than all that any world has, {best:.4g} at best"
        elif worlds.all_reach(cost):
            what = f"is reached by all rows in all worlds, {worst:.4g} at worst"
        else:
            return
        self.warn(
            f"success: {success:g} {what};"
            " is it in the unit of the outcomes, and good where they are?"
        )

    def _begins(self, history: History) -> bool:
        """Whether this trial comes before the model."""
        count = len(history.cost)
        if not self._in_costs or count == 0:
            return count < self.first_trials
        return count < RANKED_OF_ONE and self._model(history, count).follows_ranking

    def _history(self, study: optuna.Study, trial: FrozenTrial) -> History:
        rows, compared = self.rows, self.compared(study)
        worlds, goals = rows.worlds, len(study.directions)
        if worlds is not None and self._in_costs and worlds.goals == goals:
            pairs = zip(compared, worlds.ends, strict=True)
            compared = [np.append(known, ends) for known, ends in pairs]
        found = read_history(
            study,
            trial,
            rows.space,
            table=rows,
            places_all=self._places_all,
            known=self._looked_up,
            compared=compared,
        )
        known = None
        if worlds is not None and self.options.kernel.related:
            if worlds.goals != goals:
                allowed = (
                    f"those of {goals} goals, as many as the study has: [n, w, {goals}]"
                )
                raise InputError("table.outcomes", f"costs of {worlds.goals}", allowed)
            # One goal needs no ends of costs, and the copy is of the whole table.
            if goals > 1:
                known = worlds.costs[rows.numbers].reshape(-1, goals)
        return self.one_goal(found, turn(study, trial), known)

    @property
    def _places_all(self) -> bool:
        """Whether any point has features, or none are needed."""
        found = self.function is not None or self.rows.worlds is not None
        return found or not self.options.kernel.of_features

    def _ensemble(self, history: History) -> Relation | None:
        """The worlds, with costs that are minimised; None where they do not count."""
        if not self.options.kernel.related:
            return None
        found = self.rows.ensemble(history.signs, history.goals)
        if not isinstance(found, Ensemble):
            return found
        return found.with_successes(self.success(history, found))

    def _first_row(
        self, offered: Mask, own_turn: int, ensemble: Relation | None
    ) -> Proposal:
        """A row before there is a model; of equally good ones any."""
        if ensemble is None:
            merit = self.merit(self._points().features, own_turn)
        else:
            merit = -ensemble.mean
        rng = self.rng(Purpose.STARTUP_ROW, own_turn)
        aim = Aim.RANKING if isinstance(ensemble, Ensemble) else Aim.BEGIN
        return self._best_row(merit, offered, rng, aim)

    def _best_row(
        self, merit: Floats, offered: Mask, rng: np.random.Generator, aim: Aim
    ) -> Proposal:
        """The best of the rows that are offered [n], by the merit of those that may be, [m]."""
        numbers = self.rows.numbers
        best = argmax_random_tie(np.where(offered[numbers], merit, -np.inf), rng)
        return self._of_row(int(numbers[best]), aim)

    def _best_candidate(
        self,
        history: History,
        offered: Mask,
        own_turn: int,
        certificate: Certificate | None,
    ) -> Proposal:
        """The candidate of the largest utility after some trials; of equal ones any."""
        model = self._model(history, own_turn)
        if self.leaves_worlds(model, own_turn):
            return by_parameters(self, self.rows, history, own_turn)
        points, free = self._points(model.ensemble), offered[self.rows.numbers]
        utility = np.full(len(free), -np.inf)
        if free.any():
            rng = self.rng(Purpose.CANDIDATES, own_turn)
            utility = model.utility(points, free, rng)
        if self._asked is not None and isinstance(model.ensemble, Ensemble):
            doubt = self._asked.doubt(self.rows, model.ensemble)
            if doubt:
                self.warn(doubt)
        if self.options.off_grid:
            search = OffTable(
                policy=self,
                rows=self.rows,
                history=history,
                model=model,
                own_turn=own_turn,
                known=points,
                utility=utility,
                asked=self._asked,
            )
            value, off = search.best(certificate)
            if not free.any() or value > utility.max():
                return off
        rng = self.rng(Purpose.TIE_BREAK, own_turn)
        return self._best_row(utility, offered, rng, model.aim)

    def _model(self, history: History, own_turn: int) -> Model:
        ensemble = self._ensemble(history)
        others = [trial.params for trial in self.options.limits_of]
        model = self.model(
            history,
            seen=self._seen(history.done, ensemble),
            ensemble=ensemble,
            running=self._seen(history.running, ensemble),
            elsewhere=self._seen(placed(self.rows, others), ensemble)
            if others
            else None,
        )
        return self.of_turn(model, own_turn)

    def _of_row(self, row: int, why: Aim | None = None) -> Proposal:
        notes = notes_of(row, self.rows.features[row], why)
        return Proposal(self.rows.as_parameters(row), notes)

    def _points(self, ensemble: Relation | None = None) -> Points:
        """Rows that may be proposed, with coordinates only where the kernel uses them."""
        kernel = self.options.kernel
        return self.rows.points(
            by_order=kernel.by_order,
            coordinates=kernel.of_parameters,
            ensemble=ensemble,
        )

    def _seen(self, placed: Placed, ensemble: Relation | None) -> Points:
        """Trials as points: with worlds, off the table, as simulated or as rows near them tell."""
        if ensemble is None:
            features = features_of(self.rows, placed, self.function)
            kernel = self.options.kernel
            return points_of(self.rows, kernel, placed.parameters, features)
        rows, points = self.rows, self._points(ensemble)
        unit = rows.space.unit(placed.parameters)
        place = np.searchsorted(rows.numbers, placed.rows)
        place = np.minimum(place, len(rows.numbers) - 1)
        features = points.features[place]
        off = np.flatnonzero(rows.numbers[place] != placed.rows)
        for each in off.tolist():
            # Features beside the worlds, too, are those of rows near it.
            features[each] = rows.between_at(points, unit[each], ensemble)
        if self._asked is not None and isinstance(ensemble, Ensemble) and len(off):
            found = self._asked.columns(placed.parameters[off], ensemble)
            told = ~np.isnan(found).any(axis=1)
            features[off[told], -found.shape[1] :] = found[told]
        return Points.of(features, unit)

    def present(self, study: optuna.Study) -> Present:
        """See `Present`."""
        self._adopt(study)
        history = self._history(study, next_trial(study))
        done, ensemble = history.done, self._ensemble(history)
        model = self.model(history, self._seen(done, ensemble), ensemble)
        return Present(
            trials=done.trials,
            rows=tuple(row_of(self.rows, trial) for trial in done.trials),
            names=self.rows.feature_names,
            features=features_of(self.rows, done, self.function),
            model=model,
            is_doubted=self.doubts(model, ODD_TURN),
            errors=self.errors(model),
        )

    def predict(
        self, study: optuna.Study, params: Sequence[Mapping[str, Any]] | None
    ) -> Prediction:
        """See `FeatureKernelSampler.predict`."""
        self._adopt(study)
        history = self._history(study, next_trial(study))
        model = self._model(history, len(history.cost))
        # What runs has told nothing; only proposals believe that it costs what is expected.
        model = replace(model, running=model.running.take(np.arange(0)))
        if params is None:
            places = Places(self.rows.numbers, self.rows.unit)
            points = self._points(model.ensemble)
        else:
            asked = placed(self.rows, params)
            places = Places(asked.rows, self.rows.space.unit(asked.parameters))
            points = self._seen(asked, model.ensemble)
        risks = self._risks(history, model, places, points)
        trials = [*self.options.limits_of, *history.done.trials]
        errors = self.errors(model)
        return prediction_of(
            model,
            points,
            places.rows,
            history,
            success_is_told=self.options.success is not None,
            errors=errors,
            risks=risks,
            kept=all_kept(risks, self.rows.limits, trials, errors),
        )

    def before(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Note the row of a trial that was enqueued with all parameters of one.

        At its start, so that other workers see it; none of its parameters will be
        sampled here.
        """
        if not values_of(trial):
            return
        rows, row = self.own_rows, self.own_rows.find(values_of(trial))
        if row is not None and row_of(rows, trial) != trial.user_attrs.get(
            ROW_ATTRIBUTE
        ):
            set_attributes(study, trial, notes_of(row, rows.features[row]))

    def after(
        self, study: optuna.Study, trial: FrozenTrial, *, is_complete: bool
    ) -> None:
        """Correct the notes of the trial if something else was run.

        Raises:
            InputError: the objective has returned without suggesting all of the table,
                or has left no choice of some parameter (strict).
        """
        proposal = self.forget(trial) or NOTHING
        rows, noted = self.own_rows, trial.user_attrs.get(ROW_ATTRIBUTE)
        row, known = rows.find(trial.params), row_of(rows, trial)
        missing = not_suggested(rows.names, trial) if is_complete else None
        other = None
        if row is None or row != proposal.notes.get(ROW_ATTRIBUTE):
            other = run_otherwise(trial, proposal.values)
        if row is not None and known != noted:
            set_attributes(study, trial, notes_of(row, rows.features[row]))
        if row is not None and other is not None:
            set_attributes(study, trial, {WHY_ATTRIBUTE: None})
        if row is None and noted is not None:
            is_wrong = noted not in (OFF_TABLE, known)
            if is_wrong or missing is not None or other is not None:
                take_back(study, trial, NOTES & trial.user_attrs.keys())
        if missing is not None and (noted is not None or self.options.strict):
            self.misfit(missing)
        elif is_complete and other is not None:
            # Optuna calls no sampler where a range has one value.
            error = distribution_misfit(
                rows, rows.names.index(other), trial.distributions[other]
            )
            allowed = f"{proposal.values[other]!r}, as was proposed"
            self.misfit(error or InputError(other, trial.params[other], allowed))
