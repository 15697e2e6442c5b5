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

The numbers below are round ones near the best of 320 made-up campaigns
(`tests/study/sampler/campaigns.py`, seed 5); other seeds are reported.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import blake2b
from math import sqrt

import numpy as np
import scipy

from study.sampler.acquisition import Model
from study.sampler.arrays import Floats, Mask
from study.sampler.gp import Posterior
from study.sampler.transforms import Points
from study.sampler.worlds import Ensemble

MOST_ERRORS = 32  # of the last trials
# Constants of a past trial are learned anew after so many: their errors hardly change.
REFITS = ((8, 1), (32, 4), (128, 8), (np.inf, 32))
LARGEST_ERROR = 4.0  # what is larger counts as this: one cliff does not tell of others
SCALE, SCALE_TRIALS = 1.5, 3.0  # s_0, and of how many trials it is worth: N_s
BIAS, BIAS_TRIALS = 0.25, 16.0  # b_0, and N_b
MOST_FREEDOM = 5.0  # nu_most
FIRST_FREEDOM = 4.0  # of the first trial, from worlds alone, at most
# The spread of worlds, in standard deviations of the table: below, they agree by chance.
LEAST_SPREAD = 1e-6
MISFIT = 0.5  # of a machine from all worlds, in standard deviations of the table

Errors = dict[bytes, Floats]
"""Errors that were computed so far: of the cost and of each limit, by what they follow from."""


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
    def of(cls, errors: Floats, *, bias: float = BIAS) -> "Calibration":
        """What past errors [n] tell; NaN is of a trial of which nothing was predicted.

        Args:
            errors: in standard deviations of the model.
            bias: that is expected of proposals.
        """
        z = np.clip(errors[~np.isnan(errors)], -LARGEST_ERROR, LARGEST_ERROR)
        n = len(z)
        middle = (BIAS_TRIALS * bias + float(z.sum())) / (BIAS_TRIALS + n)
        squares = SCALE_TRIALS * SCALE**2 + float(((z - middle) ** 2).sum())
        freedom = min(SCALE_TRIALS + n, MOST_FREEDOM)
        return cls(middle, sqrt(squares / (SCALE_TRIALS + n)), freedom)

    @classmethod
    def before_any_trial(cls, model: Model) -> "Calibration":
        """What the worlds alone tell; few of them leave little freedom."""
        known = model.ensemble.freedom if isinstance(model.ensemble, Ensemble) else 1.0
        return cls(BIAS, 1.0, min(max(known, 1.0), FIRST_FREEDOM))

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
        z = (bound - mean) / np.sqrt(np.maximum(variance, 1e-24))
        return np.asarray(
            scipy.special.stdtr(self.freedom, (z - self.bias) / self.scale)
        )


def reading_of(model: Model, points: Points) -> tuple[Floats, Floats]:
    """Mean and variance of a reading at m points, noise included, in the model's units, [m].

    Before any trial they are those of one more world, and of a machine that is none.
    """
    if len(model.costs):
        mean, variance = model.posterior.predict(model.visible(points))
        mean += model.expected(points, model.cost())
        return mean, variance + noise_of(model.posterior)
    variance = spread_of(model, points) ** 2
    freedom = model.ensemble.freedom if isinstance(model.ensemble, Ensemble) else 0.0
    if freedom > 0.0:  # of a further world, by those that were drawn
        variance *= (freedom + 2.0) / freedom
    return model.world_mean(points), variance + MISFIT**2


def spread_of(model: Model, points: Points) -> Floats:
    """The standard deviation of the worlds at m points, [m]."""
    parts = model.columns.worlds
    return np.sqrt((points.features[:, parts.start : parts.stop] ** 2).sum(axis=1))


def tells_scale(model: Model, points: Points) -> Mask:
    """Whether anything tells how far a reading may be off, at m points, [m]."""
    if len(model.costs):
        return np.full(len(points), model.knows_scale)
    if not model.in_table_units:
        return np.zeros(len(points), dtype=bool)
    return np.asarray(spread_of(model, points) > LEAST_SPREAD)


def noise_of(posterior: Posterior) -> float:
    """The variance that a reading has beside the variance of a posterior."""
    return 0.0 if posterior.noisy else posterior.noise * posterior.cost_sd**2


def past_errors(
    model: Model, of_turn: Callable[[Model, int], Model], known: Errors
) -> Floats:
    """Errors of the last trials, each predicted before it was made, [t, 1 + c].

    Of the cost, and of each of the c limits; NaN where nothing was predicted.

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
    return np.array([*used.values()]).reshape(len(used), 1 + model.limits.shape[1])


def _key(model: Model, count: int) -> bytes:
    """What the errors of the last of so many trials follow from."""
    digest = blake2b(np.ascontiguousarray(model.trials.matrix[:count]).data)
    digest.update(model.costs[:count].tobytes())
    digest.update(model.limits[:count].tobytes())
    if model.limits_elsewhere is not None:
        digest.update(model.limits_elsewhere.tobytes())
    return digest.digest()


def _errors_of(
    model: Model, of_turn: Callable[[Model, int], Model], number: int
) -> Floats:
    """Errors of one trial, by the trials before it, [1 + c]."""
    found = np.full(1 + model.limits.shape[1], np.nan)
    before = of_turn(
        replace(
            model,
            trials=model.trials.take(np.arange(number)),
            costs=model.costs[:number],
            limits=model.limits[:number],
            running=model.trials.take(np.arange(0)),
            known={},
            refits=REFITS,
        ),
        number,
    )
    point = model.trials.take(np.array([number]))
    if tells_scale(before, point)[0]:
        mean, variance = reading_of(before, point)
        (cost,) = before.standard(model.costs[[number]], before.costs)
        found[0] = _error(cost, mean, variance)
    for column, posterior in before.limit_posteriors.items():
        limit = model.limits[number, column]
        told = before.told_limits[:, column]
        if np.nanmin(told) < np.nanmax(told) and not np.isnan(limit):
            mean, variance = posterior.predict(before.visible(point))
            found[1 + column] = _error(limit, mean, variance + noise_of(posterior))
    return found


def _error(value: float, mean: Floats, variance: Floats) -> float:
    return float((value - mean[0]) / sqrt(max(float(variance[0]), 1e-24)))
