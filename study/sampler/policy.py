"""What proposals from a table and from a space have in common.

The first trials come before there is a model: they ask which end of the features is good, or follow
what the user says it is.

| | first trials |
|---|---|
| a feature's good end is known (`prior`) | the best `RANKED` of that ranking, in its order |
| features, and nothing said | both ends of what they have in common |
| a kernel that takes features as they are, or none | `RANDOM`, at random |

What features have in common is their first principal component: candidates at its ends are extreme
by most of them at once. Of several guesses of a cost, the good end is one of the two.
"""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cache
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState
from threadpoolctl import ThreadpoolController

from study.draws import Purpose, generator
from study.sampler.acquisition import Learned, Model
from study.sampler.diagnostics import Present
from study.sampler.gp import ADDITIVE, NEARNESS, Kernel
from study.sampler.history import History, read_limits
from study.sampler.transforms import Guess, Points, is_doubtful
from taichi_nmm import checks
from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]
Features = Callable[[Floats], Floats]
"""Features [n, k] of points [n, d], by a function of the user's."""

RANKED = 3
ENDS = 2
RANDOM = 3
REMEMBERED = 1024  # trials; those that are never told would else pile up


@dataclass(frozen=True)
class Options:
    """The options of `FeatureKernelSampler`, where they are explained; `kernel` is looked up."""

    kernel: Kernel
    prior: str | None
    off_grid: int
    nearest: float | None
    space: Mapping[str, BaseDistribution] | None
    extra_parameters: frozenset[str]
    strict: bool


@dataclass(frozen=True, eq=False)
class Candidate:
    """One proposal: a row of a table, or (row -1) a point off it, with its features."""

    row: int
    parameters: Floats
    features: Floats


@dataclass(frozen=True)
class Proposal:
    """What was proposed for a trial that runs in this process, and what was noted in it.

    Attributes:
        values: by parameter; none where the independent sampler gives them.
        notes: user attributes that say what these values are.
    """

    values: Mapping[str, Any]
    notes: Mapping[str, Any]

    def was_run(self, params: Mapping[str, Any]) -> bool:
        """Whether a trial of these parameters had all of the values."""
        return all(name in params and params[name] == v for name, v in self.values.items())

    def other_in(self, params: Mapping[str, Any]) -> str | None:
        """The first parameter that a trial of these had with another value; None without any."""
        others = (name for name, v in self.values.items() if name in params and params[name] != v)
        return next(others, None)


NOTHING = Proposal({}, {})


class Policy(ABC):
    """A maker of proposals for the trials of any study.

    Nothing is decided by what it remembers that the trials do not say: another process has none.

    Attributes:
        options: of the sampler.
        seed: of the sampler.
        independent: sampler for what is not proposed here.
        learns_trust: whether features are trusted as far as trials confirm them.
        first_trials: how many trials are to finish before the model is asked.
        known: constants that were learned in this process.
    """

    def __init__(self, options: Options, seed: int, independent: BaseSampler) -> None:
        self.options = options
        self.seed = seed
        self.independent = independent
        self.learns_trust = options.kernel == ADDITIVE
        unranked = ENDS if self.learns_trust else RANDOM
        self.first_trials = unranked if options.prior is None else RANKED
        self.known: Learned = {}
        self._proposals: dict[tuple[int, datetime | None], Proposal] = {}
        self._said: set[str] = set()

    @abstractmethod
    def search_space(self, study: optuna.Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """What `propose` will give values for: distributions by name."""

    @abstractmethod
    def propose(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Values of all parameters of the search space."""

    @abstractmethod
    def propose_one(
        self, study: optuna.Study, trial: FrozenTrial, name: str, distribution: BaseDistribution
    ) -> Any:
        """The value of one parameter that `propose` has not given."""

    @abstractmethod
    def present(self, study: optuna.Study) -> Present | None:
        """What is known of the features at present; None: nothing, there is no trial.

        Raises:
            InputError: of the feature function.
        """

    def before(self, study: optuna.Study, trial: FrozenTrial) -> None:  # noqa: B027
        """What is to be noted at a trial's start, before anything is asked for: nothing."""

    def after(self, study: optuna.Study, trial: FrozenTrial, state: TrialState) -> None:
        """Take back what was noted in the trial if something else was run."""
        proposal = self.forget(trial)
        if proposal is not None and not proposal.was_run(trial.params):
            set_attributes(study, trial, dict.fromkeys(proposal.notes))

    def __getstate__(self) -> dict[str, Any]:
        """Without what another process computes again, and what runs here."""
        return self.__dict__ | {"known": {}, "_proposals": {}}

    def remember(self, trial: FrozenTrial, proposal: Proposal) -> None:
        """Keep what was proposed for a trial, and forget the oldest if they are many."""
        self._proposals[trial.number, trial.datetime_start] = proposal  # also of several studies
        if len(self._proposals) > REMEMBERED:
            self._proposals.pop(next(iter(self._proposals)), None)

    def remembered(self, trial: FrozenTrial) -> Proposal | None:
        """What was proposed for a trial; None where this process has proposed nothing."""
        return self._proposals.get((trial.number, trial.datetime_start))

    def forget(self, trial: FrozenTrial) -> Proposal | None:
        """The same, which is forgotten."""
        return self._proposals.pop((trial.number, trial.datetime_start), None)

    def merit(self, guess: Guess | None, features: Floats, turn: int) -> Floats:
        """How good each candidate is as one of the first trials, [m]; equal where any will do.

        Args:
            guess: of the user.
            features: in standard units, [m, k].
            turn: of the trial; ends are taken by turns.
        """
        if guess is not None:
            return guess.merit(features)
        if not self.learns_trust:
            return np.zeros(len(features))
        return (1.0 if turn % ENDS == 0 else -1.0) * _common(features)

    def model(
        self,
        guess: Guess | None,
        parameters: int,
        history: History,
        seen: Points,
        running: Points,
        own_turn: int,
    ) -> Model:
        """The model of one trial, after the trials of a history, at the points where they were."""
        limits = read_limits(history.trials)
        kernel = self.options.kernel
        after = Model(kernel, guess, parameters, seen, history.cost, limits, running, self.known)
        kept = history.cost[after.feasible]
        if self.learns_trust and is_doubtful(kept, own_turn, guess is not None):
            return replace(after, kernel=NEARNESS, guess=None)
        return after

    def rng(self, purpose: Purpose, turn: int) -> np.random.Generator:
        """The generator of one draw of one trial."""
        return generator(self.seed, purpose, turn)

    def draw(
        self, study: optuna.Study, trial: FrozenTrial, space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """All parameters of a space from the independent sampler."""
        return {
            name: self.independent.sample_independent(study, trial, name, distribution)
            for name, distribution in space.items()
        }

    def misfit(self, error: InputError) -> None:
        """Refuse what does not fit, or, where that was asked for, say so once and go on."""
        if self.options.strict:
            raise error
        self.warn(f"{error}; the independent sampler takes over")

    def warn(self, message: str) -> None:
        """Once a sampler and kind of message."""
        kind = message.split(":")[0]
        if kind not in self._said:
            self._said.add(kind)
            warnings.warn(message, UserWarning, stacklevel=2)


def _common(features: Floats) -> Floats:
    """Candidates [m, k] along their first principal component, more of most features first, [m]."""
    centred = features - features.mean(axis=0)
    _, directions = np.linalg.eigh(centred.T @ centred)
    first = directions[:, -1]
    return np.asarray(centred @ (first if first.sum() >= 0 else -first))


def call_features(
    function: Features, points: Floats, width: int | None = None, *, to_choose: bool = True
) -> Floats:
    """Features [n, k] of points [n, d], by one call; NaN is a gap, infinity a value.

    Args:
        function: of the user.
        points: as rows of `study.sampler.space`.
        width: k, where it is known.
        to_choose: one of the points is to be proposed; else gaps in all of them are no error.

    Raises:
        InputError: the function raised (its exception is the cause), or returned something else.
    """
    try:
        returned = function(points.copy())
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise InputError("features(params)", what, "features [n, k], no exception") from error
    try:
        features = np.array(checks.unmasked(returned), dtype=np.float64)
    except (TypeError, ValueError):
        name = type(returned).__name__
        raise InputError("features(params)", name, "an array of numbers [n, k]") from None
    features = features[:, None] if features.ndim == 1 else features
    expected = f"[{len(points)}, {'k' if width is None else width}]"
    if features.ndim != 2 or len(features) != len(points) or width not in (None, features.shape[1]):
        raise InputError("features(params).shape", features.shape, expected)
    if not features.shape[1]:
        raise InputError("features(params).shape", features.shape, "at least one feature")
    if to_choose and len(features) and np.isnan(features).any(axis=1).all():
        raise InputError("features(params)", "no row without NaN", f"finite numbers {expected}")
    return features


def one_thread() -> AbstractContextManager[Any]:
    """BLAS on one thread: on these sizes more are slower, and workers are parallel already."""
    return _thread_pools().limit(limits=1, user_api="blas")  # type: ignore[no-any-return]


@cache
def _thread_pools() -> ThreadpoolController:
    """The libraries of this process, looked for once."""
    return ThreadpoolController()


def set_attributes(study: optuna.Study, trial: FrozenTrial, attributes: dict[str, Any]) -> None:
    """Leave notes in a running trial: samplers are given no public way, Optuna's own do this."""
    for key, value in attributes.items():
        study._storage.set_trial_user_attr(trial._trial_id, key, value)


def missing_in(
    names: Sequence[str], study: optuna.Study, before: FrozenTrial, ours: str | None
) -> InputError | None:
    """An error if the latest finished trial that was proposed here lacks a parameter.

    `ours` is the user attribute that tells proposals of this sampler; None takes any trial.
    """
    for trial in reversed(study.get_trials(deepcopy=False)):
        if trial.number == before.number or not trial.state.is_finished():
            continue
        if trial.values is None or (ours is not None and ours not in trial.user_attrs):
            continue
        for name in names:
            if name not in trial.params:
                allowed = f"an objective that suggests all of {', '.join(names)}"
                return InputError(name, f"not suggested in trial {trial.number}", allowed)
        return None
    return None
