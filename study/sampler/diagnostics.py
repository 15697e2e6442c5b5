"""What trials have shown of features and of worlds: are they worth anything?"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import atanh, sqrt, tanh

import numpy as np
import scipy
from optuna.trial import FrozenTrial

from study.sampler.acquisition import Model
from study.sampler.arrays import Floats
from study.sampler.covariance import seen_by
from study.sampler.gp import JITTER, Posterior
from study.sampler.transforms import Points

LEAST_TRIALS = 5
# Standard errors that make a gain: with two, one in ten studies of features that say
# nothing would have one, since the constants were learned from the trials that are left
# out.
GAIN = 3.0
TITLE = "Are the features worth anything?"
WORLDS_TITLE = "Which worlds is the robot like?"
SHOWN_WORLDS = 6  # most and least like
BAR = 30  # characters of the longest bar
ALIKE = 1e-9  # worlds whose values differ by less agree: the rest is rounding
HEAD = ("feature", "rank correlation with the cost")
LEAST_RANKED = 4  # trials with a feature, for its correlation
NORMAL_95 = 1.959964  # 97.5 % quantile of the normal distribution


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
        a, b = _centred_ranks(feature[known]), _centred_ranks(cost[known])
        spread = sqrt(float((a @ a) * (b @ b)))
        if spread == 0:
            return None
        value = float(np.clip(a @ b / spread, -1.0, 1.0))
        # 1 - 6 sum d^2 / (n^3 - n), two neighbours exchanged.
        most = 1.0 - 12.0 / (n**3 - n)
        inner = min(max(value, -most), most)
        z, error = atanh(inner), sqrt((1.0 + inner**2 / 2.0) / (n - 3))
        low, high = tanh(z - NORMAL_95 * error), tanh(z + NORMAL_95 * error)
        return cls(value, min(low, value), max(high, value), z / error)


def _centred_ranks(values: Floats) -> Floats:
    """Ranks less their mean, equal values sharing the mean of theirs, [n].

    As of `scipy.stats.rankdata`, which takes half a second to load.
    """
    ordered = np.sort(values)
    less = np.searchsorted(ordered, values)
    return (less + np.searchsorted(ordered, values, "right") - len(values)) / 2


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
        """The worth in a sentence; a correlation counts if it is sure at 95 % for all features."""
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
        errors: of the last trials, each predicted before it was made, [t, 2 + c].
    """

    trials: tuple[FrozenTrial, ...]
    rows: tuple[int | None, ...]
    names: tuple[str, ...]
    features: Floats
    model: Model
    is_doubted: bool
    errors: Floats


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
    """The errors of the model; None where all trials cost the same.

    The model without features is the same learned where all trials have the same
    features. The sampler's own model over the parameters alone learns no mean, and
    would fall behind also where features say nothing at all.
    """
    cost = model.cost()
    other = residuals_of_constant(cost)
    unit = rms(other)
    if unit <= 1e-12 * float(np.abs(cost).max()):
        return None
    with_features = residuals(model.posterior)
    without = None
    if model.kernel.of_parameters:
        alike = Points.of(
            np.zeros_like(model.trials.features), model.trials.coordinates
        )
        blind = residuals(replace(model, trials=alike).posterior)
        without = rms(blind) / unit
        if without < 1.0:
            other = blind
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
        """The likeness in a sentence."""
        if not self.trials:
            return "No trial has told yet which worlds the robot is like."
        ordered = self._ordered()
        by = f"By {trials_text(self.trials)}"
        (most, largest), (least, smallest) = ordered[0], ordered[-1]
        if largest - smallest < ALIKE:
            return f"{by}, no world is more like the robot than another: they do not differ."
        return f"{by}, the robot is most like {most}, and least like {least}."

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
    slopes = sqrt(variance) * (seen_by(term, posterior.x).T @ solved)
    return Likeness(len(model.costs), names, tuple(slopes.tolist()))


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


def trials_text(count: int) -> str:
    """A count of trials in words."""
    return "1 trial" if count == 1 else f"{count} trials"


def residuals_of_constant(cost: Floats) -> Floats:
    """Costs less the mean of the other costs, [n]."""
    return np.asarray((cost - cost.mean()) * len(cost) / (len(cost) - 1))


def rms(values: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))
