"""The chance that a candidate breaks a limit, or falls; and proposals that keep to a small one.

Worlds may tell of a limit: in which of them each row breaks it. Rows differ, and most
keep a limit everywhere or nowhere. So the chance of a row has a Beta prior, of mean
a / N and worth N worlds, by the moments over all rows and pairs of worlds, with one
world more in which each row keeps the limit and one in which each breaks it (Laplace).
It is never worth more than Laplace's two worlds: where worlds agree on each row, N is
small, and a row that keeps the limit in all of twelve worlds has a chance of 2 or 3 %.

Trials move it in three ways:

- a world is as many times less likely as e to `DISAGREES` times the trials that went
  otherwise there: the trials of a campaign lie together, and tell less than one each;
- a trial is one more world for the candidates near it;
- if more trials broke the limit than was said before each, by the same rule, the odds of
  all candidates grow by that: the machine is not quite like the worlds.

A limit of which worlds tell nothing has the chance that the model of its trials gives
(`prediction`), and none before three have told.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import isnan, sqrt

import numpy as np
from optuna.trial import FrozenTrial

from storage.inputs import checks
from storage.inputs.errors import InputError
from study.sampler.acquisition import Model
from study.sampler.arrays import Floats, Mask, Whole
from study.sampler.between import Between
from study.sampler.calibration import (
    LARGEST_ERROR,
    LEAST_TOLD,
    LIMIT,
    Calibration,
    noise_of,
)
from study.sampler.history import OFF_TABLE, History, limit_names, placed, read_limits
from study.sampler.rows import Rows, once
from study.sampler.transforms import Points
from study.sampler.worlds import Worlds

DISAGREES = 0.5  # of 0.5 to 3 the best chances on made-up machines like their worlds
NEAR = (
    0.1  # of a trial, in the unit cube: a Gaussian's width, times the square root of d
)
LAPLACE = 2.0  # worlds that a prior is worth at most
# Broken limits that are as many as was said, by which unexpected ones are judged: with
# one of them a single fall took all candidates from robots that are allowed 5 %.
EXPECTED = 3.0
# The share of the rule of succession in what n trials tell of a limit is RULE / n^2: of
# the first ones the model was far too sure.
RULE = 4.0
# How far limits are kept together, 0: independently, 1: one of them tells of all; and of
# how many trials that is worth.
TOGETHER, TOGETHER_TRIALS = 0.5, 4.0

AllowedRisk = float | Mapping[str, float]
"""Chances above 0 and below 1: of each limit by its name, or of any limit one."""


def allowed_risk(field: str, value: object) -> AllowedRisk:
    """Check what a sampler is allowed to risk."""
    if isinstance(value, Mapping):
        names = checks.by_name(checks.anything)(field, value)
        return {name: _chance(f"{field}.{name}", each) for name, each in names.items()}
    return _chance(field, value)


def _chance(field: str, value: object) -> float:
    if not checks.is_number(value) or not 0.0 < value < 1.0:  # type: ignore[operator]
        raise InputError(field, value, "a chance above 0 and below 1")
    return float(value)  # type: ignore[arg-type]


class RiskError(InputError):
    """No candidate that is left has a risk as small as is allowed, or nothing tells of it.

    Attributes:
        limit: by name; "": any.
        least: risk of the candidate that comes nearest; NaN where it is unknown.
    """

    def __init__(self, limit: str, allowed: float, least: float) -> None:
        self.limit = limit
        self.least = least
        field = f"allowed_risk.{limit}" if limit else "allowed_risk"
        super().__init__(
            field, allowed, self.allowed_by("trials of your own (enqueue_trial)")
        )

    def allowed_by(self, trials: str) -> str:
        """What would do, in words; `trials` are those of the user's own."""
        if isnan(self.least):
            which = "it" if self.limit else "a limit"
            return f"{trials} first: neither worlds nor {LEAST_TOLD} trials tell of {which}"
        least = f"{self.least:.2g}" if self.least < 0.995 else "no risk below 1"
        return f"from {least} on, the least risk of a candidate that is left; or {trials} first"

    def __reduce__(self) -> tuple[type, tuple[str, object, float], dict[str, object]]:  # type: ignore[override]
        """As of any `InputError`."""
        return type(self), (self.limit, self.value, self.least), {"args": self.args}


@dataclass(frozen=True, eq=False)
class Places:
    """Where k candidates, or trials, are.

    Attributes:
        rows: of the table, [k]; OFF_TABLE off it.
        unit: in the unit cube, [k, e].
        centres: points that those off the table are near to, [c, e]; None: themselves.
    """

    rows: Whole
    unit: Floats
    centres: Floats | None = None


@dataclass(frozen=True)
class Prior:
    """A Beta distribution: of a row's chance to break a limit.

    Attributes:
        broken: worlds in which it breaks it, that the prior is worth.
        worlds: that it is worth in all.
    """

    broken: float
    worlds: float

    @classmethod
    def of(cls, worlds: Worlds) -> "Prior":
        """By the moments of what worlds tell of rows, of which one is known at least."""
        share = worlds.costs[worlds.known] @ worlds.weights
        count = _worth(worlds.weights) + 2.0
        broken = (count - 2.0) * share + 1.0
        once_broken = float(broken.mean()) / count
        twice = float((broken * (broken - 1.0)).mean()) / (count * (count - 1.0))
        # How alike two worlds are on a row: 1 / (1 + N).
        alike = (twice - once_broken**2) / (once_broken * (1.0 - once_broken))
        worth = min(1.0 / alike - 1.0, LAPLACE) if alike > 0.0 else LAPLACE
        return cls(once_broken * worth, worth)

    def chance(
        self, share: Floats, worth: Floats | float, broke: Floats, near: Floats
    ) -> Floats:
        """The chance to break a limit, [k].

        Args:
            share: of the worlds in which it is broken, [k].
            worth: how many alike ones these are, [k] or one number.
            broke: trials near that broke it, [k].
            near: trials near, [k].
        """
        known = self.broken + worth * share + broke
        return known / (self.worlds + worth + near)


def _worth(weights: Floats) -> float:
    """How many worlds of one weight tell as much as those of these weights."""
    return 1.0 / float((weights**2).sum())


class WorldLimit:
    """What worlds tell of one limit, moved by trials.

    Args:
        worlds: in which each row of the table breaks it: 1, or 0.
        rows: the table.
    """

    def __init__(self, worlds: Worlds, rows: Rows) -> None:
        self._worlds = worlds
        self._rows = rows
        self._between = Between(rows.unit)
        self._prior = Prior.of(worlds)

    def chance(self, places: Places, trials: Places, broke: Floats) -> Floats:
        """The chance of k candidates to break it, [k]; NaN of a row that has a gap.

        Args:
            places: of the candidates.
            trials: the t that have told of it, in their order.
            broke: which broke it: 1, or 0, [t].
        """
        own, told = self._broken(places), self._broken(trials)
        apart = DISAGREES * np.abs(told - broke[:, None])
        apart = np.where(np.isnan(apart), 0.0, apart)
        weights = self._weights(apart.sum(axis=0)[None])[0]
        near = _nearness(trials.unit, places.unit)  # [t, k]
        chance = self._prior.chance(
            own @ weights, _worth(weights), broke @ near, near.sum(axis=0)
        )
        odds = self._times_more(trials, told, broke, apart) * chance
        return odds / (1.0 - chance + odds)

    def _broken(self, places: Places) -> Floats:
        """The worlds in which places break it, [k, w]: off the table shares of rows near."""
        found = self._worlds.costs[places.rows]
        off = places.rows == OFF_TABLE
        if off.any():
            unit = places.unit[off]
            centres = unit if places.centres is None else places.centres
            own = self._worlds.costs[self._rows.numbers]
            found[off] = self._between.at(own, unit, centres)
        return found

    def _weights(self, apart: Floats) -> Floats:
        """The worlds' weights after disagreements [t, w], [t, w]."""
        weights = self._worlds.weights * np.exp(apart.min(axis=1)[:, None] - apart)
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))

    def _times_more(
        self, trials: Places, told: Floats, broke: Floats, apart: Floats
    ) -> float:
        """How many times more trials broke the limit than was said before each; at least 1."""
        if not broke.any():
            return 1.0
        weights = self._weights(apart.cumsum(axis=0) - apart)  # before each
        near = np.triu(_nearness(trials.unit, trials.unit), 1)
        said = self._prior.chance(
            (told * weights).sum(axis=1),
            1.0 / (weights**2).sum(axis=1),
            broke @ near,
            near.sum(axis=0),
        )
        more = (EXPECTED + float(broke.sum())) / (EXPECTED + float(np.nansum(said)))
        return max(more, 1.0)


def _nearness(trials: Floats, places: Floats) -> Floats:
    """How much of a world trials [t, e] are for places [k, e]: 1 where they are, [t, k]."""
    lengths = (trials**2).sum(axis=1)[:, None] + (places**2).sum(axis=1)
    squares = np.maximum(lengths - 2.0 * trials @ places.T, 0.0)
    width = NEAR * sqrt(max(places.shape[1], 1))
    return np.asarray(np.exp(-squares / (2.0 * width**2)))


def risks_of(
    rows: Rows,
    history: History,
    others: Sequence[FrozenTrial],
    places: Places,
    by_model: Callable[[Sequence[str]], Mapping[str, Floats]],
) -> dict[str, Floats]:
    """The chance of k candidates to break each limit, by its name, [k]; NaN where unknown.

    Args:
        rows: of the table, which may know of limits in worlds.
        history: of the study.
        others: trials of other studies whose limits count.
        places: of the candidates.
        by_model: the same by the trials alone, of the limits that they tell of.
    """
    done = history.done
    elsewhere = placed(rows, [trial.params for trial in others])
    numbers = np.append(elsewhere.rows, done.rows)
    unit = rows.space.unit(np.vstack([elsewhere.parameters, done.parameters]))
    told = [*others, *done.trials]
    names = limit_names(told)
    limits = dict(zip(names, read_limits(told).T, strict=True))
    found = dict[str, Floats]()
    for name, worlds in rows.limits.items():
        limit = limits.get(name, np.full(len(told), np.nan))
        known = ~np.isnan(limit)
        trials = Places(numbers[known], unit[known])
        own = once(rows, ("limit", name), partial(WorldLimit, worlds, rows))
        found[name] = own.chance(places, trials, np.where(limit[known] > 0.0, 1.0, 0.0))
    if limits.keys() - found.keys():
        return {**by_model(names), **found}
    return found


@dataclass(frozen=True, eq=False)
class Certificate:
    """What keeps the proposal of a trial to candidates of a small risk.

    Attributes:
        allowed: as given to the sampler.
        risks: of candidates at places, which are these points, by the limit, [k].
        left: rows that nobody has tried, of those that may be proposed, [m].
        rows: their risks, by the limit, [m].
        offered: rows that are left and within what is allowed, [n].
    """

    allowed: AllowedRisk
    risks: Callable[[Places, Points], Mapping[str, Floats]]
    left: Mask
    rows: Mapping[str, Floats]
    offered: Mask

    @classmethod
    def of(
        cls,
        allowed: AllowedRisk,
        risks: Callable[[Places, Points], Mapping[str, Floats]],
        places: Places,
        points: Points,
        offered: Mask,
    ) -> "Certificate":
        """Of rows that may be proposed, m at places; some of all are offered, [n]."""
        found, within = risks(places, points), np.zeros_like(offered)
        within[places.rows] = (_excess(found, allowed) <= 1.0).all(axis=0)
        left = offered[places.rows]
        return cls(allowed, risks, left, found, offered & within)

    def within(self, places: Places, points: Points) -> Mask:
        """Which of k candidates have no larger risk than is allowed, [k]."""
        excess = _excess(self.risks(places, points), self.allowed)
        return np.asarray((excess <= 1.0).all(axis=0))

    def refusal(self) -> RiskError:
        """What to say where no candidate is within."""
        excess = _excess(self.rows, self.allowed)
        if self.left.any():
            excess = np.where(self.left, excess, np.inf)
        best = int(excess.max(axis=0).argmin())
        worst = int(excess[:, best].argmax())
        limit, most = [*_limits(self.rows, self.allowed).items()][worst]
        is_known = np.isfinite(excess[worst, best])
        least = float(self.rows[limit][best]) if is_known else np.nan
        return RiskError(limit, most, least)


def _limits(risks: Mapping[str, Floats], allowed: AllowedRisk) -> Mapping[str, float]:
    """What is allowed of each limit, by its name; of those that are known, if it is one number."""
    if isinstance(allowed, Mapping):
        return allowed
    return dict.fromkeys(risks or [""], allowed)


def _excess(risks: Mapping[str, Floats], allowed: AllowedRisk) -> Floats:
    """Risks as shares of what is allowed, a line a limit, [c, k]; infinite where unknown."""
    limits = _limits(risks, allowed)
    size = max((len(risk) for risk in risks.values()), default=1)
    unknown = np.full(size, np.nan)
    shares = [risks.get(name, unknown) / most for name, most in limits.items()]
    return np.where(np.isnan(shares), np.inf, shares)


def by_trials(
    model: Model,
    points: Points,
    errors_of: Callable[[], Floats],
    names: Sequence[str],
) -> dict[str, Floats]:
    """The chance of k candidates to break each limit that trials told of, by its name, [k].

    It is Laplace's rule of succession, and with more and more trials the model, as its
    past errors [t, 2 + c] have it. Where all trials gave the same (a flag), nothing is known of a
    scale, and the rule alone counts. NaN while fewer than three have told, none of which
    broke it.
    """
    found, errors = dict[str, Floats](), errors_of()
    for column, posterior in model.limit_posteriors.items():
        limit = model.told_limits[:, column]
        told = limit[np.isfinite(limit)]
        n, kept = len(told), int((told <= 0.0).sum())
        if n < LEAST_TOLD and kept == n:
            found[names[column]] = np.full(len(points), np.nan)
            continue
        by_rule = (kept + 1.0) / (n + 2.0)
        trusted = _trusted(n)
        if not trusted or (told == told[0]).all():
            found[names[column]] = np.full(len(points), 1.0 - by_rule)
            continue
        mean, variance = posterior.predict(model.visible(points))
        calibration = Calibration.of(errors[:, 1 + column], LIMIT)
        by_model = calibration.chance_below(0.0, mean, variance + noise_of(posterior))
        found[names[column]] = 1.0 - trusted * by_model - (1.0 - trusted) * by_rule
    return found


def _trusted(n: int) -> float:
    """How far the model counts after n trials, and not the rule of succession."""
    return max(1.0 - RULE / n**2, 0.0)


def all_kept(
    risks: Mapping[str, Floats],
    by_worlds: Collection[str],
    trials: Sequence[FrozenTrial],
    errors: Floats,
) -> Floats:
    """The chance of k candidates to keep all limits, [k]; NaN where a risk is.

    To keep all is one event: where the rule of succession counts, of trials that tell of
    several limits, it is of the trials that kept them all. The product of two rules made
    11 % of what came in 60 % of the trials. By the model it lies between the product of
    the chances and the least of them, as far as the limits' errors go together.

    Args:
        risks: to break each limit, by its name, one at least, [k].
        by_worlds: names of the limits of which worlds tell.
        trials: of the study.
        errors: of past trials, each predicted before it was made, [t, 2 + c].
    """
    chances = {name: 1.0 - risk for name, risk in risks.items()}
    names = [name for name in chances if name not in by_worlds]
    others = [chances[name] for name in chances if name in by_worlds]
    own, by_others = (
        np.array([chances[name] for name in names]),
        np.prod(others, axis=0),
    )
    apart, every = np.prod(own, axis=0), limit_names(trials)
    columns = [every.index(name) for name in names]
    told = read_limits(trials)[:, columns]
    told = told[~np.isnan(told).any(axis=1)]
    if len(names) < 2 or not len(told):
        return np.asarray(apart * by_others)
    together = _together(errors[:, 1:][:, columns])
    by_model = together * own.min(axis=0) + (1.0 - together) * apart
    by_rule = ((told <= 0.0).all(axis=1).sum() + 1.0) / (len(told) + 2.0)
    trusted = _trusted(len(told))
    return np.asarray((trusted * by_model + (1.0 - trusted) * by_rule) * by_others)


def _together(errors: Floats) -> float:
    """How far limits go together, 0 to 1: the mean correlation of their errors [t, c]."""
    known = errors[~np.isnan(errors).any(axis=1)]
    z: Floats = np.clip(known, -LARGEST_ERROR, LARGEST_ERROR)
    z /= np.sqrt((z**2).sum(axis=0)) + 1e-12
    n, c = z.shape
    # The square of a sum of c vectors of length 1 has c of itself, and 2 of each pair.
    pairs = ((z.sum(axis=1) ** 2).sum() - c) / (c * (c - 1.0))
    together = TOGETHER * TOGETHER_TRIALS + n * pairs
    return max(float(together / (TOGETHER_TRIALS + n)), 0.0)
