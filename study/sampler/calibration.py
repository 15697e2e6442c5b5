"""How far off the model's predictions have been: what intervals and chances rest on.

Each trial is predicted from the trials before it, with the constants that these taught
(Dawid 1984, "Present position and potential developments: the prequential approach").
Its error z is counted in the standard deviations that the model gave. The errors of n
trials tell what the next one may be: Student's t about b, of scale s and nu degrees of
freedom,

    b = (N_b b_0 + sum z) / (N_b + n),
    s^2 = (N_s s_0^2 + sum (z - b)^2) / (N_s + n),   nu = min(N_s + n, nu_most).

b_0 is above 0, since a proposal is chosen because it looks good: it is likely to be
worse (Smith, Winkler 2006, "The optimizer's curse"). nu stays small, since costs have
cliffs, and errors heavy tails. Before any trial the worlds alone tell; how unlike all
of them a machine may be, no world can tell. That is a guess, `MISFIT`.

Where costs jump, a chance of success is what this t says, and then what became of such
chances (`Odds`): no bell over costs is right about falls, and proposals are where the
chance looks best.

`COST` and `MISFIT` are round numbers near the best of 320 made-up campaigns
(`tests/study/sampler/campaigns.py`, seed 5); other seeds are reported.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import blake2b
from math import sqrt

import numpy as np
import scipy

from study.sampler.acquisition import ODDS, Model
from study.sampler.arrays import Floats, Mask
from study.sampler.gp import Posterior
from study.sampler.transforms import Points
from study.sampler.unlike import READING
from study.sampler.worlds import Ensemble

MOST_ERRORS = 32  # of the last trials
# Constants of a past trial are learned anew after so many: their errors hardly change.
REFITS = ((8, 1), (32, 4), (128, 8), (np.inf, 32))
LARGEST_ERROR = 3.0  # what is larger counts as this: one cliff does not tell of others
FIRST_FREEDOM = 4.0  # of the first trial, from worlds alone, at most
# The spread of worlds, in standard deviations of the table: below, they agree by chance.
LEAST_SPREAD = 1e-6
MISFIT = 0.4  # of a machine from all worlds, in standard deviations of the table

# Of an error, where the goal of a success was, in the same standard deviations: the last
# one of a trial's errors.
GOAL = -1

Errors = dict[str, Floats]
"""Errors that were computed so far: of the cost and of each limit, by what they follow from."""


@dataclass(frozen=True)
class Expected:
    """What is expected of errors before there is one.

    Attributes:
        bias: b_0.
        bias_trials: of how many trials it is worth, N_b.
        scale: s_0.
        scale_trials: of how many trials it is worth, N_s.
        freedom: nu_most.
    """

    bias: float
    bias_trials: float
    scale: float
    scale_trials: float
    freedom: float


COST = Expected(bias=0.3, bias_trials=16.0, scale=1.3, scale_trials=3.0, freedom=4.0)
# Of a machine that its first trials have shown to be like no world.
COST_UNLIKE = replace(COST, scale=1.8)
# Limits are smoother than costs, and proposals are not chosen by how far below they are.
# What the first trials show of the scale is of a model that had hardly learned.
LIMIT = Expected(bias=0.0, bias_trials=16.0, scale=1.0, scale_trials=12.0, freedom=30.0)
# Of the log odds of success, shift and slope, before anything has happened.
ODDS_MODES = np.array(ODDS)
ODDS_SDS = np.array([1.0, 0.25])
LEAST_SLOPE = 0.1
MOST_LOG_ODDS = 6.0  # that are learned from
LEAST_TOLD = 3  # trials that have told of a limit, for a chance that it is kept


@dataclass(frozen=True)
class Calibration:
    """Student's t of the errors of predictions, in standard deviations of the model.

    Attributes:
        bias: b.
        scale: s.
        freedom: nu.
    """

    bias: float
    scale: float
    freedom: float

    @classmethod
    def of(cls, errors: Floats, expected: Expected = COST) -> "Calibration":
        """What past errors [n] tell; NaN is of a trial of which nothing was predicted.

        Args:
            errors: in standard deviations of the model.
            expected: of errors before there was one.
        """
        z = np.clip(errors[~np.isnan(errors)], -LARGEST_ERROR, LARGEST_ERROR)
        n, worth = len(z), expected.scale_trials
        bias = expected.bias * expected.bias_trials + float(z.sum())
        bias /= expected.bias_trials + n
        squares = worth * expected.scale**2 + float(((z - bias) ** 2).sum())
        freedom = min(worth + n, expected.freedom)
        return cls(bias, sqrt(squares / (worth + n)), freedom)

    @classmethod
    def before_any_trial(cls, model: Model) -> "Calibration":
        """What the worlds alone tell; few of them leave little freedom."""
        known = model.ensemble.freedom if isinstance(model.ensemble, Ensemble) else 1.0
        return cls(COST.bias, 1.0, min(max(known, 1.0), FIRST_FREEDOM))

    @cached_property
    def reach(self) -> float:
        """How far the ends of a 95 % interval are from its middle."""
        return self.scale * float(scipy.special.stdtrit(self.freedom, 0.975))

    def ends(self, mean: Floats, variance: Floats) -> tuple[Floats, Floats]:
        """The 95 % interval of what a model gives this mean and variance, [m] each."""
        sd = np.sqrt(variance)
        return mean + (self.bias - self.reach) * sd, mean + (
            self.bias + self.reach
        ) * sd

    def chance_below(self, bound: float, mean: Floats, variance: Floats) -> Floats:
        """The chance of at most `bound` where a model gives this mean and variance, [m]."""
        return self.chance_of((bound - mean) / np.sqrt(np.maximum(variance, 1e-24)))

    def chance_of(self, z: Floats) -> Floats:
        """The chance of an error of at most z, in standard deviations of the model, [m]."""
        return np.asarray(
            scipy.special.stdtr(self.freedom, (z - self.bias) / self.scale)
        )


@dataclass(frozen=True)
class Odds:
    """Chances of success as they happen, by those that were said (Platt 1999, equation 1).

        log odds = a + b (log odds said),   a ~ N(a_0, s_a^2),   b ~ N(b_0, s_b^2).

    Attributes:
        shift: a.
        slope: b.
    """

    shift: float
    slope: float

    @classmethod
    def of(cls, said: Floats, happened: Mask) -> "Odds":
        """The likeliest a and b after n trials; what is said to be likelier stays likelier.

        Args:
            said: the chance of success that was said before each, [n].
            happened: whether it came, [n].
        """
        most = MOST_LOG_ODDS
        x = np.clip(scipy.special.logit(said), -most, most)

        def misfit(theta: Floats) -> tuple[float, Floats]:
            log_odds, away = theta[0] + theta[1] * x, (theta - ODDS_MODES) / ODDS_SDS
            value = np.logaddexp(0.0, log_odds).sum() - log_odds[happened].sum()
            wrong = scipy.special.expit(log_odds) - happened
            slope = np.array([wrong.sum(), wrong @ x]) + away / ODDS_SDS
            return float(value + 0.5 * away @ away), slope

        found = scipy.optimize.minimize(
            misfit,
            ODDS_MODES,
            jac=True,
            method="L-BFGS-B",
            bounds=[(None, None), (LEAST_SLOPE, None)],
        )
        return cls(*found.x.tolist())

    def chance(self, said: Floats) -> Floats:
        """How often what was said to be so likely happens, [m]."""
        log_odds = self.shift + self.slope * scipy.special.logit(said)
        return np.asarray(scipy.special.expit(log_odds))


def odds_of(errors: Floats, succeeded: Mask, expected: Expected) -> Odds:
    """What past trials tell of chances of success.

    Args:
        errors: of past trials, each predicted before it was made, [t, 2 + c].
        succeeded: which of these t trials did.
        expected: of errors of the cost before there was one.
    """
    known = np.flatnonzero(~np.isnan(errors[:, GOAL]))
    said = [
        Calibration.of(errors[:trial, 0], expected).chance_of(errors[trial, [GOAL]])[0]
        for trial in known
    ]
    return Odds.of(np.array(said), succeeded[known])


def chance_in_worlds(model: Model, points: Points, goal: float) -> Floats:
    """The chance of a reading of at most `goal` at m points before any trial, [m].

    It is the share of the worlds that have such a cost there, a reading being off by
    `READING`; with one world more that has it and one that has not (Laplace), so that
    few worlds promise little. Costs of worlds are far from normal: a walker falls, or
    does not. On worlds and families that are left out it is right within 7 %.
    """
    worlds = model.ensemble
    assert isinstance(worlds, Ensemble)
    z = (goal - worlds.told(points.features)) / READING
    alike = worlds.freedom + 1.0
    return np.asarray(
        (alike * (scipy.special.ndtr(z) @ worlds.weights) + 1.0) / (alike + 2.0)
    )


def reading_of(model: Model, points: Points) -> tuple[Floats, Floats]:
    """Mean and variance of a reading at m points, noise included, in the model's units, [m].

    Before any trial they are those of one more world, and of a machine that is none.
    """
    if len(model.costs):
        mean, variance = model.posterior.predict(model.visible(points))
        mean += model.expected(points, model.cost())
        # Beyond all that was simulated or read, a line through few trials is as
        # doubtful as it is long.
        known = np.clip(mean, *ends_of(model))
        return known, variance + noise_of(model.posterior) + (mean - known) ** 2
    variance = spread_of(model, points) ** 2
    freedom = model.ensemble.freedom if isinstance(model.ensemble, Ensemble) else 0.0
    if freedom > 0.0:  # of a further world, by those that were drawn
        variance *= (freedom + 2.0) / freedom
    return model.world_mean(points), variance + MISFIT**2


def ends_of(model: Model) -> tuple[float, float]:
    """The least and the largest cost that was simulated or read, where worlds have costs.

    Elsewhere nothing is known of what costs may be, and both are infinite.
    """
    if not isinstance(model.ensemble, Ensemble) or model.of_table is None:
        return -np.inf, np.inf
    every = [*model.ensemble.ends, *model.cost().tolist()]
    return min(every), max(every)


def spread_of(model: Model, points: Points) -> Floats:
    """The standard deviation of the worlds at m points, [m]."""
    parts = model.columns.worlds
    squares = points.features[:, parts.start : parts.stop] ** 2
    return np.asarray(np.sqrt(squares.sum(axis=1)))


def tells_scale(model: Model, points: Points) -> Mask:
    """Whether anything tells how far a reading may be off, at m points, [m]."""
    if len(model.costs):
        return np.full(len(points), model.knows_scale)
    if model.of_table is None:
        return np.zeros(len(points), dtype=bool)
    return np.asarray(spread_of(model, points) > LEAST_SPREAD)


def noise_of(posterior: Posterior) -> float:
    """The variance that a reading has beside the variance of a posterior."""
    return 0.0 if posterior.noisy else posterior.noise * posterior.cost_sd**2


def past_errors(
    model: Model, of_turn: Callable[[Model, int], Model], known: Errors
) -> Floats:
    """Errors of the last trials, each predicted before it was made, [t, 2 + c].

    Of the cost, of each of the c limits, and of a success (`GOAL`); NaN where nothing was
    predicted. Errors are in the unit that the model has now: how far it was off in another
    one does not tell how sure it is in this one.

    Args:
        model: after the trials.
        of_turn: the model that a trial was proposed by, from the sampler's.
        known: errors that were computed before; it is brought up to date.
    """
    n, used = len(model.costs), Errors()
    for number in range(max(n - MOST_ERRORS, 0), n):
        key = _key(model, number + 1)
        used[key] = known[key] if key in known else _errors_of(model, of_turn, number)
    known.clear()
    known.update(used)
    return np.array([*used.values()]).reshape(len(used), 2 + model.limits.shape[1])


def _key(model: Model, count: int) -> str:
    """What the errors of the last of so many trials follow from."""
    digest = blake2b(digest_size=16)
    digest.update(bytes([model.is_familiar]))
    digest.update(repr(model.success).encode())
    digest.update(np.ascontiguousarray(model.trials.matrix[:count]).data)
    digest.update(model.costs[:count].tobytes())
    digest.update(model.limits[:count].tobytes())
    if model.limits_elsewhere is not None:
        digest.update(model.limits_elsewhere.tobytes())
    return digest.hexdigest()


def _errors_of(
    model: Model, of_turn: Callable[[Model, int], Model], number: int
) -> Floats:
    """Errors of one trial, by the trials before it, [2 + c]."""
    found = np.full(2 + model.limits.shape[1], np.nan)
    before = of_turn(
        replace(
            model,
            trials=model.trials.take(np.arange(number)),
            rows=model.rows[:number],
            costs=model.costs[:number],
            limits=model.limits[:number],
            running=model.trials.take(np.arange(0)),
            known={},
            refits=REFITS,
            familiar=model.is_familiar,
        ),
        number,
    )
    point = model.trials.take(np.array([number]))
    if tells_scale(before, point)[0]:
        mean, variance = reading_of(before, point)
        (cost,) = before.standard(model.costs[[number]], before.costs)
        found[0] = _error(cost, mean, variance)
        if model.success is not None:
            (goal,) = before.standard(np.array([model.success]), before.costs)
            found[GOAL] = _error(goal, mean, variance)
    for column, posterior in before.limit_posteriors.items():
        limit = model.limits[number, column]
        told = before.told_limits[:, column]
        told = told[~np.isnan(told)]
        is_known = len(told) >= LEAST_TOLD and told.min() < told.max()
        if is_known and not np.isnan(limit):
            mean, variance = posterior.predict(before.visible(point))
            found[1 + column] = _error(limit, mean, variance + noise_of(posterior))
    return found


def _error(value: float, mean: Floats, variance: Floats) -> float:
    return float((value - mean[0]) / sqrt(max(float(variance[0]), 1e-24)))
