"""Proposals from a table: which row to try next, or which point near the best rows.

Workers that share a study come to propose different rows with no lock between them. A
worker writes the number of its row into its trial, and only then reads the trials
again. Of two that choose one row, the one that writes later is sure to see the other's
number and takes another row; if both write before either reads, both do. Nobody waits.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState

from storage.inputs.errors import InputError
from study.sampler.acquisition import Model, argmax_random_tie
from study.sampler.diagnostics import Prediction, Present, prediction_of
from study.sampler.draws import Purpose, turn
from study.sampler.gp import WORLDS
from study.sampler.history import (
    FEATURES_ATTRIBUTE,
    OFF_TABLE,
    ROW_ATTRIBUTE,
    SCORE_ATTRIBUTE,
    History,
    LookedUp,
    as_suggested_rows,
    distribution_misfit,
    next_trial,
    no_row_has,
    not_suggested,
    noted_features,
    notes_of,
    proves_fit,
    read_history,
    row_of,
    shown_misfit,
    suggested_so_far,
    values_of,
)
from study.sampler.policy import (
    NOTHING,
    ODD_TURN,
    RANKED,
    Features,
    Options,
    Policy,
    Proposal,
    call_features,
    one_thread,
    set_attributes,
)
from study.sampler.rows import Rows
from study.sampler.similarity import Relation
from study.sampler.space import as_suggested, nearby, not_among, not_near
from study.sampler.table import FeatureTable
from study.sampler.transforms import Points

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

CENTRES = 8  # best rows that points off the table are near to
INCUMBENTS = 3  # and best trials
# Of a range: a point off the table that is nearer to a trial, in every parameter,
# repeats it. With two knobs half of the trials were such repeats; in 16 dimensions none
# is.
REPEAT = 0.01


class TableExhaustedError(RuntimeError):
    """Every row of the table has been tried."""


class Inferred(dict[str, BaseDistribution]):
    """The search space of a table, as it is given to Optuna: distributions by name.

    Optuna requires the study to suggest with the very distributions of a search space
    whose values it was given at once, and a study that suggests another scale, kind, or
    order of choices fails with them. Where the space is this one, values are therefore
    handed out one by one.
    """


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
        super().__init__(function, options, seed, independent)
        self._table = table
        self._suggested: Rows | None = None
        self._looked_up: LookedUp = {}
        worlds = self.own_rows.worlds if options.kernel == WORLDS else None
        # Costs in worlds are a model before any trial. What only ranks tells no cost.
        self._in_costs = worlds is not None and worlds.better is None
        if worlds is not None:
            self.first_trials = (
                1 if self._in_costs and options.success is None else RANKED
            )

    @cached_property
    def own_rows(self) -> Rows:
        """The content of the table, on its own scales."""
        return self._table.rows

    @property
    def rows(self) -> Rows:
        """The content of the table, on the scales on which the study suggests it."""
        return self.own_rows if self._suggested is None else self._suggested

    def __getstate__(self) -> dict[str, Any]:
        """Without rows and trials, which follow from the table and the study."""
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
        suggested, misfit = self._adopt(study), None
        if not self.options.strict:
            finished = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
            if finished and not any(name in finished[-1].params for name in names):
                self.warn(
                    f"the study suggests none of the table's parameters: {', '.join(names[:3])}, "
                    "...; the independent sampler takes over"
                )
            misfit = shown_misfit(self.own_rows, suggested, study)
        if unfree := [name for name in names if name not in search_space]:
            allowed = "a parameter left free: rows are proposed whole"
            misfit = InputError(unfree[0], "fixed", allowed)
        if misfit is not None:
            self._refuse(study, trial, misfit)
        if isinstance(search_space, Inferred):
            return {}
        return {
            name: self.propose_one(study, trial, name, d)
            for name, d in search_space.items()
        }

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
        if proposal.values:
            error = distribution_misfit(
                self.own_rows, self.rows.names.index(name), distribution
            )
            try:
                if error is None:
                    return as_suggested(distribution, proposal.values[name])
            except ValueError:
                value = proposal.values[name]
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
            self._take_back(study, trial, proposal.notes)
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
        row = row_of(
            self.rows, trial
        )  # a trial that repeats a killed one has its row already
        if row is not None:
            return self._of_row(row)
        withdrawn: set[int] = set()
        noted: dict[str, Any] = {}
        while True:
            try:
                with one_thread():
                    proposal = self._choose(study, trial, withdrawn)
            except (InputError, TableExhaustedError):
                self._take_back(study, trial, noted)
                raise
            if proposal is None:
                self._take_back(study, trial, noted)
                return NOTHING
            noted |= proposal.notes
            set_attributes(study, trial, proposal.notes)
            row = proposal.notes[ROW_ATTRIBUTE]
            if row == OFF_TABLE or self._is_own(study, trial, row):
                return proposal
            withdrawn.add(row)

    def _is_own(self, study: optuna.Study, trial: FrozenTrial, row: int) -> bool:
        """Whether no other trial has the row that was just written into this one.

        A trial that was enqueued with the row, and still waits, has it too; one that
        has the number and did something else has not.
        """
        return not any(
            (
                other.user_attrs.get(ROW_ATTRIBUTE) == row
                or other.state is TrialState.WAITING
            )
            and row_of(self.rows, other) == row
            for other in study.get_trials(deepcopy=False)
            if other.number != trial.number
        )

    def _take_back(
        self, study: optuna.Study, trial: FrozenTrial, notes: Mapping[str, Any]
    ) -> None:
        """Mark a trial with these notes as no row: notes cannot be removed."""
        if notes:
            set_attributes(
                study, trial, dict.fromkeys(notes) | {ROW_ATTRIBUTE: OFF_TABLE}
            )

    def _choose(
        self, study: optuna.Study, trial: FrozenTrial, withdrawn: set[int]
    ) -> Proposal | None:
        """A row that no trial has taken, or a point off the table."""
        rows, own_turn = self.rows, turn(study, trial)
        try:
            history = self._history(study, trial)
        except InputError as error:  # of worlds with other goals than the study
            self.misfit(error)
            return None
        if history.unplaced:
            self.warn(
                "trials whose parameters are no row of the table are ignored: such as trial "
                f"{history.unplaced[0].number}; enqueue rows of the table instead, or give the "
                "table outcomes in worlds, or the sampler a feature_function"
            )
        offered = rows.offered & ~history.tried
        offered[list(withdrawn)] = False
        if self.options.allowed is not None:
            offered &= self.options.allowed
        if history.fixed:
            offered &= rows.having(history.fixed)
        if not offered.any() and not (self.options.off_grid and len(history.cost)):
            self._refuse_exhausted(history)
            return None
        if self._begins(history) and offered.any():
            return self._first_row(offered, own_turn, self._ensemble(history))
        try:
            return self._best_candidate(history, offered, own_turn)
        except InputError as error:  # of the feature function
            self.misfit(error)
            return None

    def _begins(self, history: History) -> bool:
        """Whether this is one of the first trials; with costs in worlds, none of them succeeded.

        Two falls do not yet tell which worlds a robot is like.
        """
        if not self._in_costs or (success := self.options.success) is None:
            return len(history.cost) < self.first_trials
        failed = bool((history.cost > history.sign * success).all())
        return failed and len(history.cost) < self.first_trials

    def _history(self, study: optuna.Study, trial: FrozenTrial) -> History:
        rows, compared = self.rows, self.compared(study)
        if (
            self._in_costs
            and rows.worlds is not None
            and rows.worlds.goals == len(compared)
        ):
            pairs = zip(compared, rows.worlds.ends, strict=True)
            compared = [np.append(known, ends) for known, ends in pairs]
        found = read_history(
            study, trial, rows.space, rows, self._places_all, self._looked_up, compared
        )
        known, k = None, len(found.signs)
        if rows.worlds is not None and self.options.kernel.worlds:
            if rows.worlds.goals != k:
                allowed = f"those of {k} goals, as many as the study has: [n, w, {k}]"
                raise InputError(
                    "table.outcomes", f"costs of {rows.worlds.goals}", allowed
                )
            if k > 1:
                known = rows.worlds.costs[rows.numbers].reshape(-1, k)
        return self.one_goal(found, turn(study, trial), known)

    @property
    def _places_all(self) -> bool:
        """Whether any point has features, or none are needed."""
        found = self.function is not None or self.rows.worlds is not None
        return found or not self.options.kernel.of_features

    def _ensemble(self, history: History) -> Relation | None:
        """The worlds, with costs that are minimised; None where they do not count."""
        worlds = self.options.kernel.worlds
        return self.rows.ensemble(history.signs, history.goals) if worlds else None

    def _first_row(
        self, offered: Mask, own_turn: int, ensemble: Relation | None
    ) -> Proposal:
        """A row before there is a model, of equal ones any."""
        rows, points = self.rows, self._points(ensemble)
        merit = self.merit(points.features, own_turn)
        if ensemble is not None:
            merit = -ensemble.mean
        merit = np.where(offered[rows.numbers], merit, -np.inf)
        best = argmax_random_tie(merit, self.rng(Purpose.STARTUP_ROW, own_turn))
        return self._of_row(int(rows.numbers[best]))

    def _best_candidate(
        self, history: History, offered: Mask, own_turn: int
    ) -> Proposal:
        """The candidate of the largest utility after some trials, of equal ones any."""
        rows = self.rows
        model = self._model(history, own_turn)
        points, free = self._points(model.ensemble), offered[rows.numbers]
        utility = np.full(len(free), -np.inf)
        if free.any():
            utility = model.utility(
                points, free, self.rng(Purpose.CANDIDATES, own_turn)
            )
        if self.options.off_grid:
            value, off = self._off_table(history, utility, model, own_turn)
            if not free.any() or value > utility.max():
                return off
        best = argmax_random_tie(utility, self.rng(Purpose.TIE_BREAK, own_turn))
        return self._of_row(int(rows.numbers[best]))

    def _model(self, history: History, own_turn: int) -> Model:
        ensemble = self._ensemble(history)
        seen = self._seen(history.parameters, history.rows, history.trials, ensemble)
        running = self._seen(history.running, history.running_rows, (), ensemble)
        elsewhere = None
        if others := self.options.limits_of:
            elsewhere = self._seen(
                *self._places([trial.params for trial in others]), (), ensemble
            )
        model = self.model(history, seen, ensemble, running, elsewhere)
        return self.of_turn(model, own_turn)

    def _places(
        self, params: Sequence[Mapping[str, Any]]
    ) -> tuple[Floats, NDArray[np.int64]]:
        """Parameters as rows have them, [m, d], and the row that each is, or OFF_TABLE, [m]."""
        rows, places = self.rows, np.empty((len(params), len(self.rows.names)))
        for place, values in enumerate(params):
            known = rows.space.row(values)
            if known is None:
                raise InputError(
                    f"params[{place}]", dict(values), f"one of {rows.space.as_dict()}"
                )
            places[place] = known
        found = [OFF_TABLE if (row := rows.find(v)) is None else row for v in params]
        return places, np.array(found, dtype=np.int64)

    def _off_table(
        self, history: History, utility: Floats, model: Model, own_turn: int
    ) -> tuple[float, Proposal]:
        """The best of some points near the best rows and trials, and its utility.

        Beside worlds no point that repeats a trial, unless nothing else is left:
        repeats are asked for by enqueuing them.

        `utility` is that of the rows that may be proposed, [m].
        """
        rows, space, free = self.rows, self.rows.space, bool(np.isfinite(utility).any())
        incumbents = history.parameters[
            np.lexsort((history.cost, ~model.feasible))[:INCUMBENTS]
        ]
        centres = incumbents
        if self.function is not None:
            best = np.argsort(-utility, kind="stable")[:CENTRES]
            best = best[np.isfinite(utility[best])]
            centres = np.vstack([rows.parameters[rows.numbers[best]], incumbents])
        rng = self.rng(Purpose.OFF_GRID, own_turn)
        near = nearby(space.pinned(history.fixed), centres, self.options.off_grid, rng)
        taken = np.vstack([history.parameters, history.running])
        new = not_among(near, taken)
        features = np.full((len(near), len(rows.feature_names)), np.nan)
        if self.function is not None:
            features = call_features(self.function, near, features.shape[1])
            known = np.asarray(~np.isnan(features).any(axis=1))
            new = new & known if (new & known).any() else known
            placed = self._placed(near, features)
        else:
            unit = space.unit(near)
            elsewhere = new & not_near(unit, space.unit(taken), REPEAT)
            new = elsewhere if free or elsewhere.any() else new
            mixed = rows.mixed(
                self._points(model.ensemble).features, unit, space.unit(centres)
            )
            placed = Points(mixed, unit)
        rng = self.rng(Purpose.OFF_GRID_UTILITY, own_turn)
        utility = model.utility(placed, new, rng)
        chosen = argmax_random_tie(utility, rng)
        notes = notes_of(OFF_TABLE, features[chosen])
        return float(utility[chosen]), Proposal(space.values(near[chosen]), notes)

    def _of_row(self, row: int) -> Proposal:
        return Proposal(
            self.rows.as_parameters(row), notes_of(row, self.rows.features[row])
        )

    def _points(self, ensemble: Relation | None = None) -> Points:
        """Rows that may be proposed, with coordinates only where the kernel uses them."""
        by_order, coordinates = (
            self.options.kernel.by_order,
            self.options.kernel.of_parameters,
        )
        return self.rows.points(
            by_order=by_order, coordinates=coordinates, ensemble=ensemble
        )

    def _seen(
        self,
        parameters: Floats,
        numbers: NDArray[np.int64],
        trials: Sequence[FrozenTrial],
        ensemble: Relation | None,
    ) -> Points:
        """Trials as points: with worlds, those off the table have what their nearest rows have."""
        if ensemble is None:
            return self._placed(parameters, self._features(parameters, numbers, trials))
        rows, points, unit = (
            self.rows,
            self._points(ensemble),
            self.rows.space.unit(parameters),
        )
        place = np.minimum(
            np.searchsorted(rows.numbers, numbers), len(rows.numbers) - 1
        )
        features = points.features[place]
        for off in np.flatnonzero(rows.numbers[place] != numbers).tolist():
            features[off] = rows.mixed_at(points, unit[off])
        return Points(features, unit)

    def _placed(self, parameters: Floats, features: Floats) -> Points:
        """Parameters [m, d] and features [m, k] as the kernel sees them."""
        unit = np.empty((len(parameters), 0))
        if self.options.kernel.of_parameters:
            unit = self.rows.space.unit(parameters)
        scale = self.rows.scale(by_order=self.options.kernel.by_order)
        return Points(scale.standard(features), unit)

    def _features(
        self,
        parameters: Floats,
        numbers: NDArray[np.int64],
        trials: Sequence[FrozenTrial],
    ) -> Floats:
        """Features of trials, [n, k]: of the table, or as noted, or by the function."""
        features = self.rows.features[numbers]
        off = np.flatnonzero(numbers == OFF_TABLE)
        features[off] = np.nan
        for place in off.tolist() if trials else ():
            noted = noted_features(trials[place])
            if noted is not None and len(noted) == features.shape[1]:
                features[place] = noted
        missing = np.isnan(
            features
        )  # of points off the table also infinities: none are noted
        unknown = missing.all(axis=1) | (missing.any(axis=1) & (numbers == OFF_TABLE))
        if unknown.any() and self.function is not None:
            features[unknown] = call_features(
                self.function, parameters[unknown], features.shape[1], to_choose=False
            )
        return features

    def _refuse_exhausted(self, history: History) -> None:
        """An error or a warning: no row is left, or none that has the fixed values."""
        if history.fixed:
            error = no_row_has(self.rows, history.fixed)
            if self.options.strict and not self._places_all:
                raise error
            self.warn(f"{error}; the independent sampler takes over")
            return
        message = f"all {len(self.rows)} rows of the table have been tried"
        if self.options.strict:
            raise TableExhaustedError(message)
        self.warn(f"{message}; the independent sampler takes over")

    def present(self, study: optuna.Study) -> Present:
        """See `Present`."""
        self._adopt(study)
        history = self._history(study, next_trial(study))
        ensemble = self._ensemble(history)
        shown = self._features(history.parameters, history.rows, history.trials)
        seen = self._seen(history.parameters, history.rows, history.trials, ensemble)
        model = self.model(history, seen, ensemble)
        return Present(
            trials=history.trials,
            rows=tuple(row_of(self.rows, trial) for trial in history.trials),
            names=self.rows.feature_names,
            features=shown,
            model=model,
            is_doubted=self.doubts(model, ODD_TURN),
        )

    def predict(
        self, study: optuna.Study, params: Sequence[Mapping[str, Any]] | None
    ) -> Prediction:
        """See `FeatureKernelSampler.predict`."""
        self._adopt(study)
        rows, history = self.rows, self._history(study, next_trial(study))
        model = self._model(history, len(history.cost))
        if params is None:
            points, numbers = self._points(model.ensemble), rows.numbers
            return prediction_of(model, points, numbers, history)
        places, numbers = self._places(params)
        points = self._seen(places, numbers, (), model.ensemble)
        return prediction_of(model, points, numbers, history)

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
        missing, ran = (
            not_suggested(rows.names, trial) if is_complete else None,
            trial.params,
        )
        row, known = rows.find(ran), row_of(rows, trial)
        other = None
        if row is None or row != proposal.notes.get(ROW_ATTRIBUTE):
            others = (
                n
                for n, v in proposal.values.items()
                if n in ran and not _is(trial, n, v)
            )
            other = next(others, None)
        if row is not None and known != noted:
            set_attributes(study, trial, notes_of(row, rows.features[row]))
        wrong = (
            missing is not None or other is not None or noted not in (OFF_TABLE, known)
        )
        if row is None and noted is not None and wrong:
            notes = (ROW_ATTRIBUTE, SCORE_ATTRIBUTE, FEATURES_ATTRIBUTE)
            self._take_back(
                study, trial, {key: 0 for key in notes if key in trial.user_attrs}
            )
        if missing is not None and (noted is not None or self.options.strict):
            self.misfit(missing)
        elif is_complete and other is not None:
            # Optuna calls no sampler where a range has one value.
            error = distribution_misfit(
                rows, rows.names.index(other), trial.distributions[other]
            )
            allowed = f"{proposal.values[other]!r}, as was proposed"
            self.misfit(error or InputError(other, ran[other], allowed))


def _is(trial: FrozenTrial, name: str, value: Any) -> bool:
    """Whether a trial ran a value of a parameter, in the form in which it was suggested."""
    ran = trial.params[name]
    try:
        return bool(
            ran == value or ran == as_suggested(trial.distributions[name], value)
        )
    except ValueError:
        return False
