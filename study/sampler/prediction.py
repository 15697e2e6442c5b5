"""What to expect, by a study's trials: of the best one, and of candidates not yet tried."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isinf, isnan, sqrt
from typing import Any

import numpy as np
import scipy

from study.sampler.acquisition import Model, log_chance_below_zero
from study.sampler.arrays import Floats, Whole
from study.sampler.diagnostics import NORMAL_95, Present, trials_text
from study.sampler.gp import misfit
from study.sampler.history import History, read_limits
from study.sampler.transforms import Points
from study.sampler.worlds import Ensemble

SHOWN_CANDIDATES = 10
LEAST_TOLD = 3  # trials that have told of a limit, for a chance that it is kept
# The spread of worlds, in standard deviations of the table: below, they agree by chance.
LEAST_SPREAD = 1e-6
NOISES = np.geomspace(1e-3, 1.0, 11)  # variances, in standard units


@dataclass(frozen=True)
class Best:
    """The trial that is best by the model, and not by luck: what all trials tell of it.

    Attributes:
        number: of the trial, the first of these parameters.
        params: its parameters.
        row: of the table; None off it, or without one.
        value: as likely too high as too low; infinite where the best one is.
        low: end of the interval that holds its value, without noise, with 95 %; NaN
            where nothing tells how far the value may be off: an infinite one, or all
            trials gave the same.
        high: its other end.
        trials: finished ones of these parameters.
        untold: limits of which other trials have told, and this one has not.
    """

    number: int
    params: Mapping[str, Any]
    row: int | None
    value: float
    low: float
    high: float
    trials: int
    untold: tuple[str, ...]

    def __str__(self) -> str:
        row = "" if self.row is None else f", row {self.row}"
        limits = (
            f" Whether it keeps {', '.join(self.untold)} is unknown."
            if self.untold
            else ""
        )
        return (
            f"Trial {self.number}{row}: {self.value:.4g} ({_interval_text(self.low, self.high)}), "
            f"by {trials_text(self.trials)} of it and what the others tell.{limits}"
        )


def best_of(present: Present, *, maximised: bool) -> Best:
    """The trial of the least expected cost, of those that kept their limits if any did.

    Where the model has no parameters, noise is what parameters do, and is part of the
    interval.
    """
    model, trials = present.model, present.trials
    mean, variance = _over_noise(model)
    mean += model.expected(model.trials, model.cost())
    kept = ~(read_limits(trials) > 0).any(axis=1)
    told = np.array([trial.values[0] for trial in trials])
    # To the model infinity is a number beyond the others, which noise may bring near to
    # them.
    told = np.where(np.isfinite(told), 0.0, -told if maximised else told)
    order = np.lexsort((mean, told, ~kept))
    best = int(order[0])
    trial = trials[best]
    value = trial.values[0]
    low = high = np.nan
    if np.isfinite(value):
        away = NORMAL_95 * sqrt(float(variance[best]))
        ends = model.in_units(mean[best] + away * np.array([0.0, -1.0, 1.0]))
        value, low, high = (-ends[[0, 2, 1]] if maximised else ends).tolist()
    if not model.knows_scale:
        low = high = np.nan
    limits = set().union(*(other.constraints for other in trials))
    return Best(
        number=trial.number,
        params=dict(trial.params),
        row=present.rows[best],
        value=value,
        low=low,
        high=high,
        trials=sum(other.params == trial.params for other in trials),
        untold=tuple(sorted(limits - trial.constraints.keys())),
    )


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the trials of a study, and all that was known before, let expect of m candidates.

    NaN stands for what is not known, never for 0 or for 1; `str` says "unknown".

    Attributes:
        rows: of the table, [m]; -1 off it.
        value: as likely too high as too low, [m]; NaN where nothing is known.
        low: end of the interval that holds the value with 95 %, [m], without noise
            unless the model is over features alone; NaN where nothing tells how far the
            value may be off: one world, worlds that agree, trials that all gave the
            same.
        high: its other end, [m].
        success: chance of a value that is a success, [m]; NaN where the interval is, or
            where no success is defined.
        kept: chance that all limits are kept, [m]; NaN before trials have told of them,
            and while fewer than three have, none of which broke one.
    """

    rows: Whole
    value: Floats
    low: Floats
    high: Floats
    success: Floats
    kept: Floats

    def __str__(self) -> str:
        """A line for each of the first candidates."""
        lines = []
        for place, row in enumerate(self.rows[:SHOWN_CANDIDATES].tolist()):
            name = "off the table" if row < 0 else f"row {row}"
            value = _number_text(float(self.value[place]))
            interval = _interval_text(float(self.low[place]), float(self.high[place]))
            success, kept = (
                _share_text(float(each[place])) for each in (self.success, self.kept)
            )
            lines.append(
                f"{name}: {value} ({interval}), success {success}, limits kept {kept}"
            )
        if (more := len(self.rows) - len(lines)) > 0:
            lines.append(f"and {more} more")
        return "\n".join(lines)


def _number_text(value: float) -> str:
    return "unknown" if isnan(value) else f"{value:.4g}"


def _interval_text(low: float, high: float) -> str:
    return (
        "interval unknown" if isnan(low) or isnan(high) else f"{low:.4g} to {high:.4g}"
    )


def _share_text(share: float) -> str:
    return "unknown" if isnan(share) else f"{100.0 * share:.0f} %"


def prediction_of(
    model: Model, points: Points, rows: Whole, history: History
) -> Prediction:
    """The prediction at points, after the trials of a history.

    Before any trial only worlds in the study's units tell something: their mean and
    spread.
    """
    unknown = np.full(len(points), np.nan)
    nothing = Prediction(
        rows=rows,
        value=unknown,
        low=unknown,
        high=unknown,
        success=unknown,
        kept=_chance_kept(model, points),
    )
    freedom = np.inf
    if len(model.costs):
        finite = np.isfinite([trial.values[0] for trial in history.done.trials])
        if not finite.any() and not model.in_table_units:
            return nothing
        mean, variance = model.posterior.predict(model.visible(points))
        mean += model.expected(points, model.cost())
        is_known = np.full(len(points), model.knows_scale)
    elif isinstance(model.ensemble, Ensemble) and model.ensemble.in_costs:
        mean = model.world_mean(points)
        parts = model.columns.worlds
        variance = (points.features[:, parts.start : parts.stop] ** 2).sum(axis=1)
        is_known = np.sqrt(variance) > LEAST_SPREAD
        freedom = model.ensemble.freedom
        if freedom > 0.0:  # of a further world, by those that were drawn
            variance = variance * (freedom + 2.0) / freedom
    else:
        return nothing
    errors = NORMAL_95
    if not isinf(freedom):
        errors = float(scipy.special.stdtrit(freedom, 0.975))
    away = errors * np.sqrt(variance)
    low, high = (
        np.where(is_known, history.sign * model.in_units(end), np.nan)
        for end in (mean - away, mean + away)
    )
    success = unknown
    if model.success is not None:
        (goal,) = model.standard(np.array([model.success]), model.costs)
        chance = _chance_below(goal - mean, variance, freedom)
        success = np.where(is_known, chance, np.nan)
    return replace(
        nothing,
        value=history.sign * model.in_units(mean),
        low=low if history.sign > 0 else high,
        high=high if history.sign > 0 else low,
        success=success,
    )


def _chance_below(away: Floats, variance: Floats, freedom: float) -> Floats:
    """P(y <= mean + away), [m]; by Student's t where the variance is that of few samples."""
    if isinf(freedom):
        return np.exp(log_chance_below_zero(-away, variance))
    return np.asarray(
        scipy.special.stdtr(freedom, away / np.sqrt(np.maximum(variance, 1e-24)))
    )


def _chance_kept(model: Model, points: Points) -> Floats:
    """The chance that all limits are kept, [m]; NaN where too few trials have told of one.

    Where all trials gave the same of a limit (a flag), nothing is known of its scale:
    it is Laplace's rule of succession. Else it is the model's, with Student's t for the
    few trials that its scale was learned from.
    """
    limits = [limit[np.isfinite(limit)] for limit in model.told_limits.T]
    limits = [told for told in limits if len(told)]
    chance = np.full(len(points), 1.0 if limits else np.nan)
    for told, posterior in zip(limits, model.limit_posteriors, strict=True):
        n, is_broken = len(told), bool((told > 0.0).any())
        if n < LEAST_TOLD and not is_broken:
            chance[:] = np.nan
        elif (told == told[0]).all():
            chance *= (1.0 if is_broken else n + 1.0) / (n + 2.0)
        else:
            mean, variance = posterior.predict(model.visible(points))
            chance *= _chance_below(-mean, variance, n - 1.0)
    return chance


def _over_noise(model: Model) -> tuple[Floats, Floats]:
    """Mean and variance of n trials' costs, averaged over the noise by its likelihood, [n] each.

    Proposals take the likeliest noise under a prior that expects little: enough to
    choose by, too sure for an interval.
    """
    own, points = model.posterior, model.visible(model.trials)
    found, misfits = list[tuple[Floats, Floats]](), list[float]()
    for noise in NOISES:
        posterior = replace(own, theta=np.append(own.theta[:-1], np.log(noise)))
        prior = own.covariance.noise
        z = (posterior.theta[-1] - prior.mode) / prior.sd
        misfits.append(
            misfit(own.covariance, own.x, own.y, posterior.theta)[0] - 0.5 * z**2
        )
        found.append(posterior.predict(points))
    means, variances = np.array(found).transpose(1, 0, 2)
    weights = scipy.special.softmax(-np.array(misfits))
    mean = weights @ means
    return mean, weights @ (variances + (means - mean) ** 2)
