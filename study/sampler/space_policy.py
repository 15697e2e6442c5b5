"""Proposals from a whole space: points anywhere, and near the best trials."""

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.search_space import intersection_search_space
from optuna.trial import FrozenTrial

from storage.inputs.errors import InputError
from study.sampler.acquisition import Aim, argmax_random_tie
from study.sampler.arrays import Floats, Mask
from study.sampler.covariance import EUCLIDEAN
from study.sampler.diagnostics import Present
from study.sampler.draws import Purpose, turn
from study.sampler.history import (
    FEATURES_ATTRIBUTE,
    OFF_TABLE,
    WHY_ATTRIBUTE,
    History,
    next_trial,
    not_suggested,
    notes_of,
    read_history,
    values_of,
)
from study.sampler.policy import (
    ODD_TURN,
    Policy,
    Proposal,
    call_features,
    one_thread,
    set_attributes,
)
from study.sampler.rows import Rows
from study.sampler.space import Space, anywhere, nearby, not_among, not_near
from study.sampler.transforms import NormalScores, Points, Scale, Standard

CANDIDATES = 2048  # points anywhere, a trial
INCUMBENTS = 5  # best trials that points are near to
LOCAL_SHARE = 4  # one point near them for so many anywhere
# Rounds of points near the best candidates, where features cost nothing.
REFINEMENTS = 3


class SpacePolicy(Policy):
    """Points of a space, with features by a function or without."""

    def search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """The declared space, or the parameters that all finished trials share."""
        space = self.options.space
        if space is None:
            space = intersection_search_space(study.get_trials(deepcopy=False))
        if self.function is not None:
            return dict(space)  # the function takes all of its columns
        return {name: d for name, d in space.items() if not d.single()}

    def propose(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        search_space: dict[str, BaseDistribution],
    ) -> dict[str, Any]:
        """The parameters of one point; where that cannot be, independent draws."""
        if not search_space:
            return {}
        space = Space.of(search_space).pinned(values_of(trial))
        try:
            self._require_declared(study, search_space)
            own_turn = turn(study, trial)
            found = read_history(study, trial, space, compared=self.compared(study))
            history = self.one_goal(found, own_turn)
            with one_thread():
                if len(history.cost) < self.first_trials:
                    point, features = self._first(space, own_turn)
                    aim = Aim.BEGIN
                else:
                    point, features, aim = self._best(space, history, own_turn)
        except InputError as error:
            self.misfit(error)
            draw = self.independent.sample_independent
            return {
                name: draw(study, trial, name, d) for name, d in search_space.items()
            }
        values = space.values(point)
        notes: dict[str, Any] = {WHY_ATTRIBUTE: str(aim)}
        if len(features):
            notes[FEATURES_ATTRIBUTE] = features.tolist()
        set_attributes(study, trial, notes)
        self.remember(trial, Proposal(values, notes))
        return values

    def propose_one(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        name: str,
        distribution: BaseDistribution,
    ) -> Any:
        """Independent; a declared parameter comes here if its range is not the declared one."""
        declared = (self.options.space or {}).get(name)
        if declared is not None:
            allowed = f"the range declared in `space`: {declared}"
            self.misfit(InputError(name, str(distribution), allowed))
        return self.independent.sample_independent(study, trial, name, distribution)

    def present(self, study: optuna.Study) -> Present | None:
        """See `Present`; None: there is nothing to show."""
        trial = next_trial(study)
        known = self.search_space(study, trial)
        if not known:
            return None
        space = Space.of(known)
        history = read_history(study, trial, space, compared=self.compared(study))
        if not len(history.cost):
            return None
        rng = self.rng(Purpose.CANDIDATES, turn(study, trial))
        features, shown, _ = self._features(
            self._candidates(space, history, rng), history
        )
        seen = _placed(self._scale(features), shown, space, history.done.parameters)
        model = self.model(history, seen)
        return Present(
            trials=history.done.trials,
            rows=(None,) * len(shown),
            names=tuple(f"feature_{column}" for column in range(features.shape[1])),
            features=shown,
            model=model,
            is_doubted=self.doubts(model, ODD_TURN),
            errors=self.errors(model),
        )

    def before(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Nothing is noted."""

    def after(
        self, study: optuna.Study, trial: FrozenTrial, *, is_complete: bool
    ) -> None:
        """Take the notes back if another point was run."""
        proposal = self.forget(trial)
        if proposal is not None and not proposal.values.items() <= trial.params.items():
            set_attributes(study, trial, dict.fromkeys(proposal.notes))

    def _require_declared(
        self, study: optuna.Study, search_space: Collection[str]
    ) -> None:
        """Refuse parameters of the declared space that are fixed, or were not suggested before.

        The latest finished trial that was proposed here tells.
        """
        declared = self.options.space or {}
        for name, distribution in declared.items():
            if name not in search_space and self.function is not None:
                allowed = (
                    "a parameter left free: the feature function needs all of them"
                )
                raise InputError(name, f"fixed, of {distribution}", allowed)
        names = [name for name in search_space if name in declared]
        for other in reversed(study.get_trials(deepcopy=False)):
            is_ours = self.function is None or FEATURES_ATTRIBUTE in other.user_attrs
            if other.values is not None and is_ours:
                if (error := not_suggested(names, other)) is not None:
                    raise error
                return

    def _first(self, space: Space, own_turn: int) -> tuple[Floats, Floats]:
        """A point [d] before there is a model, and its features [k]."""
        rng = self.rng(Purpose.STARTUP_POINT, own_turn)
        if self.function is None:
            return anywhere(space, 1, rng)[0], np.empty(0)
        points = anywhere(space, CANDIDATES, rng)
        features = call_features(self.function, points)
        merit = self.merit(self._scale(features).standard(features), own_turn)
        merit[np.isnan(features).any(axis=1)] = -np.inf
        best = argmax_random_tie(merit, rng)
        return points[best], features[best]

    def _best(
        self, space: Space, history: History, own_turn: int, *, is_apart: bool = False
    ) -> tuple[Floats, Floats, Aim]:
        """The best of points anywhere and near the incumbents, its features, and for what.

        Without features, also of points near those, round by round. If it is to be
        apart, none that lies so near a trial that it repeats it.
        """
        rng = self.rng(Purpose.CANDIDATES, own_turn)
        points = self._candidates(space, history, rng)
        features, shown, running = self._features(points, history)
        scale = self._scale(features)
        seen = _placed(scale, shown, space, history.done.parameters)
        elsewhere = _placed(scale, running, space, history.running.parameters)
        model = self.model(history, seen, running=elsewhere)
        model = self.of_turn(model, own_turn)
        taken = space.unit(history.taken)

        def is_new(some: Floats) -> Mask:
            unit = space.unit(some)
            new = not_among(unit, taken)
            apart = new & not_near(unit, taken) if is_apart else new
            return apart if apart.any() else new

        known = np.asarray(~np.isnan(features).any(axis=1))
        new = is_new(points) & known
        candidates = _placed(scale, features, space, points)
        utility = model.utility(candidates, new if new.any() else known, rng)
        for _ in range(REFINEMENTS if self.function is None else 0):
            best = np.argsort(-utility, kind="stable")[:INCUMBENTS]
            near = nearby(space, points[best], CANDIDATES // LOCAL_SHARE, rng)
            points = np.vstack([points[best], near])
            features = np.empty((len(points), 0))
            candidates = _placed(scale, features, space, points)
            utility = model.utility(candidates, is_new(points), rng)
        best_one = argmax_random_tie(utility, self.rng(Purpose.TIE_BREAK, own_turn))
        return points[best_one], features[best_one], model.aim

    def _candidates(
        self, space: Space, history: History, rng: np.random.Generator
    ) -> Floats:
        """Points anywhere, and near the best trials, [m, d]."""
        incumbents = history.done.parameters[
            np.argsort(history.cost, kind="stable")[:INCUMBENTS]
        ]
        local = max(CANDIDATES // LOCAL_SHARE, self.options.off_grid)
        return np.vstack(
            [anywhere(space, CANDIDATES, rng), nearby(space, incumbents, local, rng)]
        )

    def _features(
        self, points: Floats, history: History
    ) -> tuple[Floats, Floats, Floats]:
        """Features of candidates, finished trials (noted in them, or computed) and running ones."""
        done, running = history.done, history.running
        if self.function is None:
            counts = (len(points), len(done.rows), len(running.rows))
            some, shown, elsewhere = (np.empty((count, 0)) for count in counts)
            return some, shown, elsewhere
        noted = [trial.user_attrs.get(FEATURES_ATTRIBUTE) for trial in done.trials]
        is_noted = np.array([isinstance(each, list) for each in noted], dtype=bool)
        batch = [points, running.parameters, done.parameters[~is_noted]]
        features = call_features(self.function, np.vstack(batch))
        ends = np.cumsum([len(points), len(running.rows)])
        own, elsewhere, computed = np.split(features, ends)
        shown = np.empty((len(done.rows), features.shape[1]))
        shown[~is_noted] = computed
        for place in np.flatnonzero(is_noted):
            values: list[float] = noted[place]  # type: ignore[assignment]
            if len(values) != features.shape[1]:
                field = f"features of trial {done.trials[place].number}"
                raise InputError(field, len(values), f"{features.shape[1]} numbers")
            shown[place] = values
        return own, shown, elsewhere

    def _scale(self, features: Floats) -> Scale:
        """The scale of features [m, k] of points anywhere."""
        scale = NormalScores if self.options.kernel.by_order else Standard
        return scale.of(features)


def by_parameters(
    policy: Policy, rows: Rows, history: History, own_turn: int
) -> Proposal:
    """A point of a table's space by the parameters of the trials, as if no row told anything."""
    options = replace(policy.options, kernel=EUCLIDEAN, off_grid=0, success=None)
    plain = SpacePolicy(None, options, policy.seed, policy.independent)
    space = rows.space.pinned(history.fixed)
    point, _, _ = plain._best(space, history, own_turn, is_apart=True)
    unknown = np.full(len(rows.feature_names), np.nan)
    notes = notes_of(OFF_TABLE, unknown, Aim.PARAMETERS)
    return Proposal(space.values(point), notes)


def _placed(scale: Scale, features: Floats, space: Space, parameters: Floats) -> Points:
    """Features [n, k] and parameters [n, d] as the model sees them."""
    return Points.of(scale.standard(features), space.unit(parameters))
