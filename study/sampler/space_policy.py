"""Proposals from a whole space: points anywhere, and near the best trials."""

from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.search_space import intersection_search_space
from optuna.trial import FrozenTrial

from study.draws import Purpose, turn
from study.sampler.acquisition import argmax_random_tie
from study.sampler.diagnostics import Present
from study.sampler.history import (
    FEATURES_ATTRIBUTE,
    OFF_TABLE,
    History,
    next_trial,
    read_history,
    values_of,
)
from study.sampler.policy import (
    Candidate,
    Features,
    Options,
    Policy,
    Proposal,
    call_features,
    missing_in,
    one_thread,
    set_attributes,
)
from study.sampler.space import Space, anywhere, nearby, not_among
from study.sampler.transforms import Guess, NormalScores, Points, Scale, Standard
from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]

CANDIDATES = 2048  # points anywhere, a trial
INCUMBENTS = 5  # best trials that points are near to
LOCAL_SHARE = 4  # one point near them for so many anywhere
REFINEMENTS = 3  # rounds of points near the best candidates, where features cost nothing


class SpacePolicy(Policy):
    """Points of a space, with features by a function or without."""

    def __init__(
        self, function: Features | None, options: Options, seed: int, independent: BaseSampler
    ) -> None:
        super().__init__(options, seed, independent)
        self.function = function

    def search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """What was declared, or what all finished trials share."""
        space = self.options.space
        if space is None:
            space = intersection_search_space(study.get_trials(deepcopy=False))
        if self.function is not None:
            return dict(space)  # it wants all its columns
        return {name: d for name, d in space.items() if not d.single()}

    def propose(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """The parameters of one point; where that cannot be, independent draws."""
        if not search_space:
            return {}
        misfit = self._misfit(study, trial, search_space)
        if misfit is not None:
            self.misfit(misfit)
            return self.draw(study, trial, search_space)
        space = Space.of(search_space).pinned(values_of(trial))
        try:
            with one_thread():
                candidate = self._choose(study, trial, space)
        except InputError as error:  # of the feature function
            self.misfit(error)
            return self.draw(study, trial, search_space)
        values = space.values(candidate.parameters)
        if len(candidate.features):
            notes = {FEATURES_ATTRIBUTE: candidate.features.tolist()}
            set_attributes(study, trial, notes)
            self.remember(trial, Proposal(values, notes))
        return values

    def propose_one(
        self, study: optuna.Study, trial: FrozenTrial, name: str, distribution: BaseDistribution
    ) -> Any:
        """Independent; a declared parameter comes here if its range is not the declared one."""
        declared = (self.options.space or {}).get(name)
        if declared is not None:
            allowed = f"the range declared in `space`: {declared}"
            self.misfit(InputError(name, str(distribution), allowed))
        return self.independent.sample_independent(study, trial, name, distribution)

    def present(self, study: optuna.Study) -> Present | None:
        """With the candidates that the next trial would have."""
        trial = next_trial(study)
        known = self.search_space(study, trial)
        if not known or self.function is None:
            return None
        space = Space.of(known)
        history = read_history(study, trial, space).finished
        if not len(history.cost):
            return None
        rng = self.rng(Purpose.CANDIDATES, turn(study, trial))
        points = self._candidates(space, history, rng)
        features, shown, _ = self._features(points, history)
        scale = self._scale(features)
        seen = Points(scale.standard(shown), space.unit(history.parameters))
        candidates = Points(scale.standard(features), space.unit(points))
        return Present(
            _names(features),
            shown,
            seen,
            history.cost,
            candidates,
            scale.owners,
            len(space),
            self.options.kernel,
            self._guess(features),
            self.learns_trust,
            self.known,
            {},
        )

    def _misfit(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> InputError | None:
        """What is wrong with a declared space."""
        declared = self.options.space
        if declared is None:
            return None
        for name, distribution in declared.items():
            if name not in search_space and (self.function is not None):
                allowed = "a parameter left free: the feature function wants all of them"
                return InputError(name, f"fixed, of {distribution}", allowed)
        names = [name for name in search_space if name in declared]
        ours = None if self.function is None else FEATURES_ATTRIBUTE  # nothing is noted without
        return missing_in(names, study, trial, ours)

    def _choose(self, study: optuna.Study, trial: FrozenTrial, space: Space) -> Candidate:
        """A random point at first, then the best by the model."""
        own_turn = turn(study, trial)
        history = read_history(study, trial, space)
        if len(history.cost) < self.first_trials:
            return self._startup(space, own_turn)
        if self.function is None:
            return self._best_point(space, history, own_turn)
        return self._best_featured(space, history, own_turn)

    def _startup(self, space: Space, own_turn: int) -> Candidate:
        """A point before there is a model."""
        rng = self.rng(Purpose.STARTUP_POINT, own_turn)
        if self.function is None:
            return Candidate(OFF_TABLE, anywhere(space, 1, rng)[0], np.empty(0))
        points = anywhere(space, CANDIDATES, rng)
        features = call_features(self.function, points)
        standard = self._scale(features).standard(features)
        merit = self.merit(self._guess(features), standard, own_turn)
        merit[np.isnan(features).any(axis=1)] = -np.inf
        best = argmax_random_tie(merit, rng)
        return Candidate(OFF_TABLE, points[best], features[best])

    def _best_point(self, space: Space, history: History, own_turn: int) -> Candidate:
        """The best of points anywhere and near the incumbents, then of points near those."""
        rng = self.rng(Purpose.CANDIDATES, own_turn)
        taken = np.vstack([history.parameters, history.running])
        seen, running = _bare(space, history.parameters), _bare(space, history.running)
        model = self.model(None, len(space), history, seen, running, own_turn)
        points = self._candidates(space, history, rng)
        utility = model.utility(_bare(space, points), not_among(points, taken), rng)
        for _ in range(REFINEMENTS):
            best = np.argsort(-utility, kind="stable")[:INCUMBENTS]
            near = nearby(space, points[best], CANDIDATES // LOCAL_SHARE, rng)
            points = np.vstack([points[best], near])
            utility = model.utility(_bare(space, points), not_among(points, taken), rng)
        best_one = argmax_random_tie(utility, self.rng(Purpose.TIE_BREAK, own_turn))
        return Candidate(OFF_TABLE, points[best_one], np.empty(0))

    def _best_featured(self, space: Space, history: History, own_turn: int) -> Candidate:
        """The best of points anywhere and near the incumbents, their features by one call."""
        rng = self.rng(Purpose.CANDIDATES, own_turn)
        points = self._candidates(space, history, rng)
        features, known, running = self._features(points, history)
        scale = self._scale(features)
        seen = Points(scale.standard(known), space.unit(history.parameters))
        elsewhere = Points(scale.standard(running), space.unit(history.running))
        candidates = Points(scale.standard(features), space.unit(points))
        guess = self._guess(features)
        model = self.model(guess, len(space), history, seen, elsewhere, own_turn)
        taken = np.vstack([history.parameters, history.running])
        offered = not_among(points, taken) & ~np.isnan(features).any(axis=1)
        if not offered.any():
            offered = np.asarray(~np.isnan(features).any(axis=1))
        utility = model.utility(candidates, offered, rng)
        best = argmax_random_tie(utility, self.rng(Purpose.TIE_BREAK, own_turn))
        return Candidate(OFF_TABLE, points[best], features[best])

    def _candidates(self, space: Space, history: History, rng: np.random.Generator) -> Floats:
        """Points anywhere, and near the best trials, [m, d]."""
        incumbents = history.parameters[np.argsort(history.cost, kind="stable")[:INCUMBENTS]]
        local = max(CANDIDATES // LOCAL_SHARE, self.options.off_grid)
        return np.vstack([anywhere(space, CANDIDATES, rng), nearby(space, incumbents, local, rng)])

    def _features(self, points: Floats, history: History) -> tuple[Floats, Floats, Floats]:
        """Of candidates, of finished trials (noted in them, or computed), of running ones."""
        assert self.function is not None  # or there are none
        noted = [trial.user_attrs.get(FEATURES_ATTRIBUTE) for trial in history.trials]
        missing = np.array([not isinstance(values, list) for values in noted], dtype=bool)
        batch = np.vstack([points, history.running, history.parameters[missing]])
        features = call_features(self.function, batch)
        width, m, r = features.shape[1], len(points), len(history.running)
        known = np.empty((len(noted), width))
        known[missing] = features[m + r :]
        for place, values in enumerate(noted):
            if not isinstance(values, list):
                continue
            if len(values) != width:
                number = history.trials[place].number
                raise InputError(f"features of trial {number}", len(values), f"{width} numbers")
            known[place] = values
        return features[:m], known, features[m : m + r]

    def _scale(self, features: Floats) -> Scale:
        """Of features [m, k] of points anywhere, as the kernel wants them."""
        by_order = self.options.kernel.by_order
        return NormalScores.of(features) if by_order else Standard.of(features)

    def _guess(self, features: Floats) -> Guess | None:
        """What the user says of one of the k features."""
        if self.options.prior is None:
            return None
        return Guess.of(self.options.prior, _names(features))


def _names(features: Floats) -> tuple[str, ...]:
    """Of features [m, k], which a function does not name."""
    return tuple(f"feature_{column}" for column in range(features.shape[1]))


def _bare(space: Space, points: Floats) -> Points:
    """Points [n, d] without features, by their coordinates alone."""
    return Points(np.empty((len(points), 0)), space.unit(points))
