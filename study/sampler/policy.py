"""The common part of proposals from a table and from a space.

The first trials come before there is a model. With worlds they are the best rows by
their mean, three or fewer, of one world up to six (`Evidence.follows_ranking`). With
features they are the `ENDS` of their first principal component, where candidates are
extreme by most of them at once, so that one end is good where several predict the cost;
else `RANDOM` ones.
"""

import warnings
from collections.abc import Callable, Collection, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial
from threadpoolctl import ThreadpoolController

from storage.inputs.errors import InputError
from study.sampler.acquisition import Learned, Model
from study.sampler.arrays import Floats, Mask
from study.sampler.calibration import Errors, past_errors
from study.sampler.covariance import ADDITIVE, NEARNESS, Kernel
from study.sampler.draws import Purpose, generator
from study.sampler.goals import Goals
from study.sampler.history import (
    OFF_TABLE,
    ROW_ATTRIBUTE,
    History,
    Placed,
    noted_features,
    read_limits,
)
from study.sampler.rows import Rows
from study.sampler.similarity import Relation
from study.sampler.transforms import Points
from study.sampler.worlds import Ensemble, matrix_of

Features = Callable[[Floats], Floats]
"""Features [n, k] of points [n, d], by a function of the user's."""

ENDS = 2
RANDOM = 3
ODD_TURN = 1  # of those that are left to the parameters where the rest is doubted
REMEMBERED = 1024  # trials; some never end


@dataclass(frozen=True)
class Options:
    """The options of `FeatureKernelSampler`, where they are explained; `kernel` is looked up.

    Attributes:
        kernel: that was named, or chosen where none was.
        off_grid: number of points off the table that are added to the candidates of
            each trial.
        space: distributions by name; None: those that all finished trials share, or the
            table's.
        extra_parameters: names that the study suggests and the table does not have.
        strict: whether what does not fit is an error; if not, the independent sampler
            takes over.
        success: value of the study from which on a trial has succeeded; None: nobody
            says it.
        allowed: rows of the table that may be proposed, [n]; None: all.
        limits_of: trials of other studies, whose constraints alone are learned.
        allowed_risk: of breaking limits; None: any.
    """

    kernel: Kernel
    off_grid: int
    space: Mapping[str, BaseDistribution] | None
    extra_parameters: frozenset[str]
    strict: bool
    success: float | None
    allowed: Mask | None
    limits_of: tuple[FrozenTrial, ...] = ()
    allowed_risk: float | Mapping[str, float] | None = None


@dataclass(frozen=True)
class Proposal:
    """The proposal for a trial that runs in this process, with its notes.

    Attributes:
        values: by parameter; none where the independent sampler gives them.
        notes: user attributes that say what these values are: the row, and its
            features.
    """

    values: Mapping[str, Any]
    notes: Mapping[str, Any]


NOTHING = Proposal({}, {})


class TableExhaustedError(RuntimeError):
    """Every row of the table has been tried."""


class Policy:
    """A maker of proposals, which follow from the trials alone.

    Another process, without these memories, makes the same.
    """

    def __init__(
        self,
        function: Features | None,
        options: Options,
        seed: int,
        independent: BaseSampler,
    ) -> None:
        # Of points; None: they have no features, but rows may have.
        self.function = function
        self.options = options
        self.seed = seed
        self.independent = independent  # for what is not proposed here
        # Whether features are trusted as far as trials confirm them.
        self.learns_trust = options.kernel == ADDITIVE
        # How many trials have to finish before there is a model.
        self.first_trials = ENDS if self.learns_trust else RANDOM
        self.known: Learned = {}  # in this process
        self.past_errors: Errors = {}  # likewise
        self._proposals: dict[tuple[int, datetime | None], Proposal] = {}
        self._said: set[str] = set()

    def __getstate__(self) -> dict[str, Any]:
        """The state without constants, which another process computes again, and own trials."""
        return self.__dict__ | {"known": {}, "past_errors": {}, "_proposals": {}}

    def remember(self, trial: FrozenTrial, proposal: Proposal) -> None:
        """Keep what was proposed for a trial, and forget the oldest if they are many."""
        # Trials of several studies may have one number.
        self._proposals[trial.number, trial.datetime_start] = proposal
        if len(self._proposals) > REMEMBERED:
            self._proposals.pop(next(iter(self._proposals)), None)

    def remembered(self, trial: FrozenTrial) -> Proposal | None:
        """The proposal for a trial; None where this process has made none."""
        return self._proposals.get((trial.number, trial.datetime_start))

    def forget(self, trial: FrozenTrial) -> Proposal | None:
        """The proposal for a trial, which is forgotten."""
        return self._proposals.pop((trial.number, trial.datetime_start), None)

    def compared(self, study: optuna.Study) -> list[Floats]:
        """What infinite values of a study lie beyond, for each goal: the value of a success."""
        success = self.options.success
        return [np.array([] if success is None else [success])] * len(study.directions)

    def one_goal(
        self, history: History, turn: int, known: Floats | None = None
    ) -> History:
        """The history with one cost in place of several; `known` [n, k] tells their scale."""
        if len(history.signs) == 1:
            return history
        if self.options.success is not None:
            allowed = f"none in a study of {len(history.signs)} goals"
            raise InputError("success", self.options.success, allowed)
        known = history.costs if known is None else history.signs * known
        goals = Goals.drawn(known, self.rng(Purpose.GOALS, turn))
        return replace(history, cost=goals.cost(history.costs), goals=goals)

    def merit(self, features: Floats, turn: int) -> Floats:
        """How good each is as one of the first trials, [m], by features in standard units [m, k].

        Equal where any will do.
        """
        if not self.learns_trust or turn >= ENDS:  # of a batch, when the ends are taken
            return np.zeros(len(features))
        centred = features - features.mean(axis=0)
        first = np.linalg.eigh(centred.T @ centred)[1][:, -1]  # principal component
        first = first if first.sum() >= 0 else -first  # more of most features
        return np.asarray((1.0 if turn % ENDS == 0 else -1.0) * (centred @ first))

    def model(
        self,
        history: History,
        seen: Points,
        ensemble: Relation | None = None,
        running: Points | None = None,
        elsewhere: Points | None = None,
    ) -> Model:
        """The model after the trials of a history, for trials that follow the features.

        Args:
            history: of n finished trials.
            seen: where these were, n points.
            ensemble: what is known of rows beside features.
            running: where trials are that run elsewhere; None: there are none.
            elsewhere: where the trials of `limits_of` were; None: there are none.
        """
        n = len(history.cost)
        limits = read_limits([*history.done.trials, *self.options.limits_of])
        return Model(
            kernel=self.options.kernel,
            parameters=history.done.parameters.shape[1],
            trials=seen,
            rows=history.done.rows,
            costs=history.cost,
            limits=limits[:n],
            running=seen.take(np.arange(0)) if running is None else running,
            known=self.known,
            ensemble=ensemble,
            success=self.success(history, ensemble),
            elsewhere=elsewhere,
            limits_elsewhere=None if elsewhere is None else limits[n:],
            off_grid=bool(self.options.off_grid),
        )

    def success(self, history: History, ensemble: Relation | None) -> float | None:
        """The cost of a success; if nobody says it, what parts the costs of all worlds.

        Of rows alone nothing does: they have no steps that fall.
        """
        if self.options.success is not None:
            return history.sign * self.options.success
        if not self.options.off_grid or not isinstance(ensemble, Ensemble):
            return None
        return ensemble.parting

    def of_turn(self, model: Model, turn: int) -> Model:
        """The model of one trial: of the parameters alone, where features are doubted."""
        return replace(model, kernel=NEARNESS) if self.doubts(model, turn) else model

    def errors(self, model: Model) -> Floats:
        """Errors of the last trials, each predicted before it was made, [t, 2 + c]."""
        return past_errors(model, self.of_turn, self.past_errors)

    def doubts(self, model: Model, turn: int) -> bool:
        """Whether the trial of this turn is left to the parameters."""
        return self.learns_trust and model.has_stalled and turn % 2 == ODD_TURN

    def leaves_worlds(self, model: Model, turn: int) -> bool:
        """Whether the trial of this turn goes anywhere, by the parameters of all trials alone.

        Of a machine that is like no world it is every other one, until one has succeeded.
        """
        goes_anywhere = self.options.off_grid > 0 and self.options.allowed_risk is None
        return goes_anywhere and model.is_lost and turn % 2 == ODD_TURN

    def rng(self, purpose: Purpose, turn: int) -> np.random.Generator:
        """The generator of one draw of one trial."""
        return generator(self.seed, purpose, turn)

    def misfit(self, error: Exception) -> None:
        """Refuse what does not fit; if not strict, warn once and go on."""
        if self.options.strict:
            raise error
        self.take_over(error)

    def take_over(self, reason: object) -> None:
        """Warn that nothing is proposed here."""
        self.warn(f"{reason}; the independent sampler takes over")

    def warn(self, message: str) -> None:
        """Warn, once for each kind of message."""
        kind = message.split(":")[0]
        if kind not in self._said:
            self._said.add(kind)
            warnings.warn(message, UserWarning, stacklevel=2)


def call_features(
    function: Features,
    points: Floats,
    width: int | None = None,
    *,
    to_choose: bool = True,
) -> Floats:
    """Features [n, k] of points [n, d], by one call; NaN is a gap, infinity a value.

    `width` is k, where it is known. Gaps in all points are an error if one is to be
    proposed, as is what the function raises (its exception is the cause), and all that
    is not [n, k].
    """
    try:
        returned = function(points.copy())
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise InputError(
            "features(params)", what, "features [n, k], no exception"
        ) from error
    features = matrix_of("features(params)", returned, "k")
    shape, expected = (
        features.shape,
        f"[{len(points)}, {'k' if width is None else width}]",
    )
    if shape[0] != len(points) or width not in (None, shape[1]):
        raise InputError("features(params).shape", shape, expected)
    if to_choose and np.isnan(features).any(axis=1).all():
        raise InputError(
            "features(params)", "no row without NaN", f"finite numbers {expected}"
        )
    return features


def features_of(rows: Rows, placed: Placed, function: Features | None) -> Floats:
    """Features of trials over a table, [n, k]: its own, or as noted, or by the function."""
    features, is_off = rows.features[placed.rows], placed.rows == OFF_TABLE
    features[is_off] = np.nan
    for place, trial in enumerate(placed.trials):
        noted = noted_features(trial) if is_off[place] else None
        if noted is not None and len(noted) == features.shape[1]:
            features[place] = noted
    # Of points off the table also infinities are missing: none are noted.
    missing = np.isnan(features)
    unknown = missing.all(axis=1) | (missing.any(axis=1) & is_off)
    if unknown.any() and function is not None:
        points = placed.parameters[unknown]
        features[unknown] = call_features(
            function, points, features.shape[1], to_choose=False
        )
    return features


def points_of(
    rows: Rows, kernel: Kernel, parameters: Floats, features: Floats
) -> Points:
    """Parameters [m, d] and features [m, k] as the kernel sees them, on the scale of the rows."""
    unit = np.empty((len(parameters), 0))
    if kernel.of_parameters:
        unit = rows.space.unit(parameters)
    scale = rows.scale(by_order=kernel.by_order)
    return Points.of(scale.standard(features), unit)


def one_thread() -> AbstractContextManager[Any]:
    """BLAS on one thread: on these sizes more are slower, and workers are parallel already."""
    return _thread_pools().limit(limits=1, user_api="blas")  # type: ignore[no-any-return]


@cache
def _thread_pools() -> ThreadpoolController:
    """The BLAS libraries of this process, found once: NumPy's, and SciPy's own."""
    # SciPy loads its library with this module, at first use.
    import_module("scipy.linalg")
    return ThreadpoolController()


def set_attributes(
    study: optuna.Study, trial: FrozenTrial, attributes: Mapping[str, Any]
) -> None:
    """Leave notes in a running trial: samplers are given no public way, Optuna's own do this."""
    for key, value in attributes.items():
        study._storage.set_trial_user_attr(trial._trial_id, key, value)
        # The objective sees it, as it does what it sets itself.
        trial.user_attrs[key] = value


def take_back(study: optuna.Study, trial: FrozenTrial, notes: Collection[str]) -> None:
    """Mark a trial with these notes as no row of a table: notes cannot be removed."""
    if notes:
        nothing = dict.fromkeys(notes) | {ROW_ATTRIBUTE: OFF_TABLE}
        set_attributes(study, trial, nothing)
