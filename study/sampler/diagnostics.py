"""What trials have shown: what features and worlds are worth, the best trial, what is next."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import atanh, isinf, isnan, sqrt, tanh
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from optuna.trial import FrozenTrial

from study.sampler.acquisition import Model, log_kept
from study.sampler.gp import JITTER, Posterior, misfit
from study.sampler.history import History, read_limits
from study.sampler.transforms import Points
from study.sampler.worlds import Ensemble

Floats = NDArray[np.float64]

LEAST_TRIALS = 5
# Standard errors that make a gain: with two, one in ten studies of features that say
# nothing would have one, since the constants were learned from the trials that are left
# out.
GAIN = 3.0
TITLE = "Are the features worth anything?"
WORLDS_TITLE = "Which worlds is the robot like?"
SHOWN_WORLDS = 6  # most and least like
BAR = 30  # characters of the longest bar
HEAD = ("feature", "rank correlation with the cost")
LEAST_RANKED = 4  # trials with a feature, for its correlation
NORMAL_95 = 1.959964  # 97.5 % quantile of the normal distribution
SHOWN_CANDIDATES = 10
LEAST_TOLD = 3  # trials that have told of a limit, for a chance that it is kept
LEAST_SPREAD = (
    1e-6  # of worlds, in standard deviations of the table: below, they agree by chance
)
NOISES = np.geomspace(1e-3, 1.0, 11)  # variances, in standard units


@dataclass(frozen=True)
class RankCorrelation:
    """Spearman's rank correlation of a feature and the cost, -1 to 1, with its interval.

    r is the correlation of ranks, equal values sharing the mean of theirs. Its interval
    is that of Fisher's z = artanh r, which is about normal with the standard error

        sqrt((1 + r^2 / 2) / (n - 3))

    (Bonett, Wright 2000, "Sample size requirements for estimating Pearson, Kendall and
    Spearman correlations"). Of trials in perfect order z is infinite: they get the
    interval of trials of which two neighbours are out of order, up to the end of the
    scale.

    Attributes:
        value: r.
        low: end of the interval that holds it with 95 %.
        high: its other end.
        errors: r in standard errors, on the scale of z.
    """

    value: float
    low: float
    high: float
    errors: float

    def __str__(self) -> str:
        return f"{self.value:+.2f} ({self.low:+.2f} to {self.high:+.2f})"

    @classmethod
    def of(cls, feature: Floats, cost: Floats) -> "RankCorrelation | None":
        """The correlation in n trials, [n] each; those without the feature (NaN) are left out.

        None: too few trials are left, or all have the same feature or the same cost.
        """
        known = ~np.isnan(feature)
        n = int(known.sum())
        if n < LEAST_RANKED:
            return None
        a, b = (
            scipy.stats.rankdata(v) - (n + 1) / 2 for v in (feature[known], cost[known])
        )
        spread = sqrt(float((a @ a) * (b @ b)))
        if spread == 0:
            return None
        value = float(np.clip(a @ b / spread, -1.0, 1.0))
        most = 1.0 - 12.0 / (
            n**3 - n
        )  # 1 - 6 sum d^2 / (n^3 - n), two neighbours exchanged
        inner = min(max(value, -most), most)
        z, error = atanh(inner), sqrt((1.0 + inner**2 / 2.0) / (n - 3))
        low, high = tanh(z - NORMAL_95 * error), tanh(z + NORMAL_95 * error)
        return cls(value, min(low, value), max(high, value), z / error)


@dataclass(frozen=True)
class Errors:
    """Leave-one-out errors, as shares of that of a constant.

    Attributes:
        model: of the sampler's model.
        without: of one over the parameters alone; None: the sampler has none.
        gain: by how much the model is nearer to the costs than the better of the
            others, on average over the trials, in standard errors of this average.
    """

    model: float
    without: float | None
    gain: float


@dataclass(frozen=True)
class Worth:
    """The importance of features to a sampler, by the finished trials of a study.

    Attributes:
        trials: that could be learned from.
        names: of the k features; () where nothing is known of them yet.
        correlations: of each with the cost; None: too few trials have it, or it is
            constant.
        errors: None: too few trials, or all cost the same.
        is_doubted: every other trial is left to the parameters at present.
        maximised: the study's value is; costs are minus the values.
    """

    trials: int
    names: tuple[str, ...]
    correlations: tuple[RankCorrelation | None, ...]
    errors: Errors | None
    is_doubted: bool
    maximised: bool

    @property
    def verdict(self) -> str:
        """In a sentence; a correlation counts if it is sure at 95 % for all features at once."""
        if self.trials < LEAST_TRIALS:
            return f"too few trials: {self.trials} of {LEAST_TRIALS}"
        if self.errors is None:
            return f"nothing is known of the features: all {self.trials} trials cost the same"
        without = self.errors.without
        other = "" if without is None else f", and {without:.2f} of it without features"
        error = f"the model's error is {self.errors.model:.2f} of a constant's{other}"
        better = self.errors.model < min(1.0, 1.0 if without is None else without)
        if better and self.errors.gain > GAIN:
            return f"The features explain part of the costs of these trials: {error}."
        if (found := self._strongest()) is not None:
            name, r = found
            gain = "may gain" if better else "does not gain"
            return (
                f"The costs follow a feature ({name}, {r.value:+.2f}); among these trials, the "
                f"model {gain} by the features: {error}."
            )
        if better:
            part = f"part of the costs, which {self.trials} trials do not settle"
            return f"The features may explain {part}: {error}."
        return (
            f"Among these trials, the features are not (yet) worth anything: {error}."
        )

    def _strongest(self) -> tuple[str, RankCorrelation] | None:
        """The feature with the surest correlation; None: none is sure, of so many."""
        named = zip(self.names, self.correlations, strict=True)
        known = [(name, r) for name, r in named if r is not None]
        needed = scipy.special.ndtri(1.0 - 0.025 / max(len(known), 1))  # Bonferroni
        sure = [one for one in known if abs(one[1].errors) > needed]
        return max(sure, key=lambda one: abs(one[1].errors), default=None)

    def __str__(self) -> str:
        rows = [HEAD, *self._rows()]
        width = max(len(name) for name, _ in rows)
        lines = [f"{name:<{width}}  {r}" for name, r in rows]
        return "\n".join(
            [self.verdict, "", *(lines if self.names else ()), *self._remarks()]
        )

    def markdown(self) -> str:
        """The table in Markdown, for a note in the dashboard."""
        head = [f"| {' | '.join(HEAD)} |", "|---|---|"]
        rows = [
            "| {} | {} |".format(name.replace("|", "\\|"), r)
            for name, r in self._rows()
        ]
        table = [*head, *rows, ""] if self.names else []
        return "\n".join(
            [f"## {TITLE}", "", self.verdict, "", *table, *self._remarks()]
        ).rstrip()

    def _rows(self) -> list[tuple[str, str]]:
        named = zip(self.names, self.correlations, strict=True)
        return [(name, "-" if r is None else str(r)) for name, r in named]

    def _remarks(self) -> Iterator[str]:
        """Notes on how to read the figures."""
        if not self.names:
            return
        yield (
            f"{self.trials} trials. In brackets: 95 % intervals. The sampler selected these "
            "trials, so correlations are biased towards zero. Evaluate some random rows for an "
            "unbiased estimate."
        )
        if self.maximised:
            yield "The cost is minus the study's value."
        if self.is_doubted:
            yield (
                "No trial has been better than all before for some time: every other one is left "
                "to the parameters."
            )


@dataclass(frozen=True, eq=False)
class Present:
    """The finished trials of a study, and what the sampler makes of them.

    Attributes:
        trials: n of them.
        rows: the row of the table that each is; None off it, or without a table.
        names: of the k features.
        features: of the n trials, in units of their own, [n, k]; NaN where unknown.
        model: the sampler's, for trials that follow the features.
        is_doubted: whether every other trial is left to the parameters at present.
    """

    trials: tuple[FrozenTrial, ...]
    rows: tuple[int | None, ...]
    names: tuple[str, ...]
    features: Floats
    model: Model
    is_doubted: bool


def worth_of(present: Present | None, *, maximised: bool) -> Worth:
    """The worth of features.

    The error of a model is compared with that of a constant and, where the model uses
    parameters too, with that of the same model blind to the features. The gain is the
    difference of the absolute leave-one-out errors, averaged over the trials; its
    standard error follows from how it differs from trial to trial, as in Vehtari,
    Gelman, Gabry 2017 ("Practical Bayesian model evaluation using leave-one-out
    cross-validation and WAIC", section 5.1) for log densities.
    """
    if present is None:
        return Worth(
            trials=0,
            names=(),
            correlations=(),
            errors=None,
            is_doubted=False,
            maximised=maximised,
        )
    cost = present.model.costs
    correlations = [RankCorrelation.of(each, cost) for each in present.features.T]
    return Worth(
        trials=len(cost),
        names=present.names,
        correlations=tuple(correlations),
        errors=_errors(present.model) if len(cost) >= LEAST_TRIALS else None,
        is_doubted=present.is_doubted,
        maximised=maximised,
    )


def _errors(model: Model) -> Errors | None:
    """None where all trials cost the same.

    The model without features is the same learned where all trials have the same
    features. The sampler's own model over the parameters alone learns no mean, and
    would fall behind also where features say nothing at all.
    """
    cost = model.cost()
    constant = residuals_of_constant(cost)
    unit = rms(constant)
    if unit <= 1e-12 * float(np.abs(cost).max()):
        return None
    with_features, other, without = residuals(model.posterior), constant, None
    if model.kernel.of_parameters:
        alike = Points(np.zeros_like(model.trials.features), model.trials.coordinates)
        blind = residuals(replace(model, trials=alike).posterior)
        without = rms(blind) / unit
        other = blind if without < 1.0 else constant
    less = np.abs(other) - np.abs(with_features)
    spread = float(less.std(ddof=1)) / sqrt(len(less))
    gain = float(less.mean()) / spread if spread > 0 else 0.0
    return Errors(rms(with_features) / unit, without, gain)


@dataclass(frozen=True)
class Likeness:
    """Which simulated worlds a robot is like, by the finished trials of a study.

    Attributes:
        trials: that could be learned from.
        names: of the w worlds.
        values: above 0 where the trials cost what the world adds to the mean, below 0
            where they cost the opposite, in standard deviations of what was thought
            before any trial.
    """

    trials: int
    names: tuple[str, ...]
    values: tuple[float, ...]

    @property
    def verdict(self) -> str:
        """In a sentence."""
        if not self.trials:
            return "No trial has told yet which worlds the robot is like."
        ordered = self._ordered()
        most, least = ordered[0][0], ordered[-1][0]
        return f"By {_trials(self.trials)}, the robot is most like {most}, and least like {least}."

    def __str__(self) -> str:
        """The worlds in the order of their values, a bar each."""
        shown = self._ordered()
        if len(shown) > 2 * SHOWN_WORLDS:
            shown = shown[:SHOWN_WORLDS] + shown[-SHOWN_WORLDS:]
        width = max(len(name) for name, _ in shown)
        largest = max(*map(abs, self.values), 1e-12)
        lines = []
        for name, value in shown:
            bar = ("+" if value > 0 else "-") * round(BAR * abs(value) / largest)
            lines.append(f"{name:<{width}}  {value:+.2f}  {bar}".rstrip())
        return "\n".join([self.verdict, "", *lines])

    def _ordered(self) -> list[tuple[str, float]]:
        named = zip(self.names, self.values, strict=True)
        return sorted(named, key=lambda one: -one[1])

    def markdown(self) -> str:
        """The same, for a note in the dashboard."""
        verdict, _, chart = str(self).partition("\n\n")
        return f"## {WORLDS_TITLE}\n\n{verdict}\n\n```text\n{chart}\n```"


def likeness_of(model: Model, names: tuple[str, ...]) -> Likeness:
    """E[b] / a after the trials, [w]: b ~ N(0, a^2 I) are the slopes along what each world adds.

    a^2 d^T K^-1 (y - m) / a (Rasmussen, Williams 2006, section 2.7).
    """
    if not len(model.costs):
        return Likeness(0, names, (0.0,) * len(names))
    posterior = model.posterior
    # The worlds' term comes first.
    term, variance, _ = next(posterior.covariance.valued(posterior.theta))
    noisy = posterior.gram() + (posterior.noise + JITTER) * np.eye(len(posterior.y))
    solved = np.linalg.solve(noisy, posterior.y)
    slopes = sqrt(variance) * (term.seen(posterior.x).T @ solved)
    return Likeness(len(model.costs), names, tuple(slopes.tolist()))


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
            f"by {_trials(self.trials)} of it and what the others tell.{limits}"
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
    value, low, high = trial.values[0], np.nan, np.nan
    if np.isfinite(value):
        away = NORMAL_95 * sqrt(float(variance[best]))
        ends = model.in_units(mean[best] + away * np.array([0.0, -1.0, 1.0]))
        value, low, high = (-ends[[0, 2, 1]] if maximised else ends).tolist()
    if not model.knows_scale:
        low, high = np.nan, np.nan
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

    rows: NDArray[np.int64]
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
    model: Model, points: Points, rows: NDArray[np.int64], history: History
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
        finite = np.isfinite([trial.values[0] for trial in history.trials])
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
        return np.exp(log_kept(-away, variance))
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
        z = (posterior.theta[-1] - own.covariance.modes[-1]) / own.covariance.spreads[
            -1
        ]
        misfits.append(
            misfit(own.covariance, own.x, own.y, posterior.theta)[0] - 0.5 * z**2
        )
        found.append(posterior.predict(points))
    means, variances = np.array(found).transpose(1, 0, 2)
    weights = scipy.special.softmax(-np.array(misfits))
    mean = weights @ means
    return mean, weights @ (variances + (means - mean) ** 2)


def residuals(posterior: Posterior) -> Floats:
    """Costs less what the other trials let expect, in the unit of the costs, [n].

    With K the covariance of the n trials, noise included, and y their costs less what
    is expected before any of them, the cost of trial i is missed by [K^-1 y]_i /
    [K^-1]_ii (Rasmussen, Williams 2006, equation 5.12), without a fit for each trial:
    the constants are those learned from all. What is expected is the mean of the costs,
    here that of the others, so that a model that knows nothing errs as the constant
    does.
    """
    n, y = len(posterior.y), posterior.y  # whose mean is zero
    inverse = np.linalg.inv(posterior.gram() + (posterior.noise + JITTER) * np.eye(n))
    others = -y / (n - 1)  # mean of the others
    missed = (inverse @ y - others * inverse.sum(axis=1)) / np.diag(inverse)
    return np.asarray(posterior.cost_sd * missed)


def _trials(count: int) -> str:
    return f"{count} trial{'s' if count > 1 else ''}"


def residuals_of_constant(cost: Floats) -> Floats:
    """Costs less the mean of the other costs, [n]."""
    return np.asarray((cost - cost.mean()) * len(cost) / (len(cost) - 1))


def rms(values: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))
