"""What to expect, by a study's trials: of the best one, and of candidates not yet tried."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isnan, sqrt
from typing import Any

import numpy as np
import scipy

from study.sampler.acquisition import Model
from study.sampler.arrays import Floats, Whole
from study.sampler.calibration import (
    COST,
    COST_UNLIKE,
    Calibration,
    chance_in_worlds,
    ends_of,
    odds_of,
    reading_of,
    tells_scale,
)
from study.sampler.diagnostics import Present, trials_text
from study.sampler.gp import misfit
from study.sampler.history import History, read_limits
from study.sampler.transforms import Points
from study.sampler.worlds import Ensemble

SHOWN_CANDIDATES = 10
# How far an interval reaches beyond all that was simulated or read, in standard deviations
# of the table: costs have a logarithm, and few trials an interval to 1e9.
REACH = 1.5
SAME = 1e-6  # of what is read: what the units of the model change by more, they do not have
NOISES = np.geomspace(1e-3, 1.0, 11)  # variances, in standard units


@dataclass(frozen=True)
class Best:
    """The trial of the best reading, repeats as their mean, and what all trials tell of it.

    Attributes:
        number: of the trial, the first of these parameters.
        params: its parameters.
        row: of the table; None off it, or without one.
        reading: the mean of its trials' values.
        value: as likely too high as too low; infinite where the best one is.
        low: end of the interval that holds its value, without noise, with 95 %; NaN
            where nothing tells how far the value may be off: an infinite one, or all
            trials gave the same.
        high: its other end.
        trials: finished ones of these parameters.
        untold: limits of which other trials have told, and this one has not.
        unlike: as of a `Prediction`.
    """

    number: int
    params: Mapping[str, Any]
    row: int | None
    reading: float
    value: float
    low: float
    high: float
    trials: int
    untold: tuple[str, ...]
    unlike: str

    def __str__(self) -> str:
        row = "" if self.row is None else f", row {self.row}"
        limits = (
            f" Whether it keeps {', '.join(self.untold)} is unknown."
            if self.untold
            else ""
        )
        return (
            f"Trial {self.number}{row}: read {self.reading:.4g}; expected "
            f"{self.value:.4g} ({_interval_text(self.low, self.high)}), "
            f"by {trials_text(self.trials)} of it and what the others tell.{limits} {self.unlike}"
        ).strip()


def best_of(present: Present, *, maximised: bool) -> Best:
    """The trial of the best reading, of those that kept their limits if any did.

    The readings of the same parameters count as their mean. No trial takes its place by
    the model's mean: by that alone as many were worse as better, and where the model was
    sure of another one by two standard deviations, more were worse: a valley narrower
    than the model knows looks like luck. Repeats tell these apart.

    Where the model has no parameters, noise is what parameters do, and is part of the
    interval.
    """
    model, trials = present.model, present.trials
    mean, variance = _over_noise(model)
    mean += model.expected(model.trials, model.cost())
    best = _chosen(present, maximised=maximised)
    strange = model.unlike(-1.0 if maximised else 1.0)
    trial = trials[best]
    alike = [other.values[0] for other in trials if other.params == trial.params]
    reading = float(np.mean(alike))
    value, low, high = reading, np.nan, np.nan
    # In the table's units there is nothing far below all of its worlds.
    seen = model.in_units(model.cost())[best]
    if np.isfinite(value) and np.isclose(seen, model.costs[best], rtol=SAME):
        expected = COST_UNLIKE if strange else COST
        calibration = Calibration.of(present.errors[:, 0], expected)
        away = calibration.reach * sqrt(float(variance[best]))
        ends = model.in_units(mean[best] + away * np.array([0.0, -1.0, 1.0]))
        value, low, high = (-ends[[0, 2, 1]] if maximised else ends).tolist()
    if not model.knows_scale:
        low = high = np.nan
    limits = set().union(*(other.constraints for other in trials))
    return Best(
        number=trial.number,
        params=dict(trial.params),
        row=present.rows[best],
        reading=reading,
        value=value,
        low=low,
        high=high,
        trials=len(alike),
        untold=tuple(sorted(limits - trial.constraints.keys())),
        unlike="" if strange is None else str(strange),
    )


def _chosen(present: Present, *, maximised: bool) -> int:
    """The place of the best trial; of trials alike by their mean value."""
    trials, cost = present.trials, present.model.costs
    kept = np.asarray(~(read_limits(trials) > 0).any(axis=1))
    told = np.array([trial.values[0] for trial in trials])
    # To the model infinity is a number beyond the others, which noise may bring near to
    # them.
    told = np.where(np.isfinite(told), 0.0, -told if maximised else told)
    first = np.lexsort((told, ~kept))[0]
    may_be = np.flatnonzero((kept == kept[first]) & (told == told[first]))
    alike = np.array(
        [[own.params == other.params for other in trials] for own in trials]
    )
    reading = alike @ cost / alike.sum(axis=1)
    return int(may_be[np.argmin(reading[may_be])])


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
        kept: chance that all limits are kept, [m]; NaN where a risk is.
        risks: chance that a limit is broken, by its name, [m]; NaN before worlds or
            trials have told of it, and while fewer than three trials have, none of which
            broke it.
        unlike: in one line, that the first trials were unlike all worlds; "": they were
            not, or nothing tells.
    """

    rows: Whole
    value: Floats
    low: Floats
    high: Floats
    success: Floats
    kept: Floats
    risks: Mapping[str, Floats]
    unlike: str

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
        if self.unlike:
            lines.append(self.unlike)
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
    model: Model,
    points: Points,
    rows: Whole,
    history: History,
    *,
    success_is_told: bool,
    errors: Floats,
    risks: Mapping[str, Floats],
    kept: Floats,
) -> Prediction:
    """The prediction at points, after the trials of a history.

    Before any trial only worlds in the study's units tell something: their mean and
    spread.

    Args:
        model: after the trials.
        points: m of them.
        rows: of the table, [m]; -1 off it.
        history: of the study.
        success_is_told: whether somebody has said what a success is, and not the table's
            costs alone.
        errors: of past trials, each predicted before it was made, [t, 2 + c].
        risks: of limits, by their names, [m].
        kept: the chance that all are kept, [m].
    """
    unknown = np.full(len(points), np.nan)
    nothing = Prediction(
        rows=rows,
        value=unknown,
        low=unknown,
        high=unknown,
        success=unknown,
        kept=kept if risks else unknown,
        risks=risks,
        unlike="",
    )
    costs = model.costs
    if (
        model.of_table is None
        and not np.isfinite([trial.values[0] for trial in history.done.trials]).any()
    ):
        return nothing
    mean, variance = reading_of(model, points)
    strange = model.unlike(history.sign) if len(costs) else None
    expected = COST_UNLIKE if strange else COST
    found = Calibration.before_any_trial(model)
    if len(costs):
        found = Calibration.of(errors[:, 0], expected)
    is_known = tells_scale(model, points)
    least, most = ends_of(model)
    low, high = (
        np.where(is_known, history.sign * model.in_units(end), np.nan)
        for end in np.clip(found.ends(mean, variance), least - REACH, most + REACH)
    )
    success = unknown
    if success_is_told:
        assert model.success is not None
        (goal,) = model.standard(np.array([model.success]), costs)
        if not len(costs):
            chance = chance_in_worlds(model, points, goal)
        else:
            chance = found.chance_below(goal, mean, variance)
            if isinstance(model.ensemble, Ensemble) and model.ensemble.jumps:
                last = costs[len(costs) - len(errors) :]
                odds = odds_of(errors, last <= model.success, expected)
                chance = odds.chance(chance)
        success = np.where(is_known, chance, np.nan)
    return replace(
        nothing,
        value=history.sign * model.in_units(mean),
        low=low if history.sign > 0 else high,
        high=high if history.sign > 0 else low,
        success=success,
        unlike="" if strange is None else str(strange),
    )


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
