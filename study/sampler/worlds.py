"""Simulated worlds as a prior of the cost, which trials move towards those a robot is like.

A table may have what each of its rows costs in each of w simulated worlds. How the
worlds differ tells which rows go together: their mean and covariance over the worlds
are a Gaussian process before any trial (Wang, Kim, Kaelbling 2018). Notation, costs
being those of `Ensemble.standard`, and p_w the weights of the worlds:

    m(r)     sum_w p_w y_w(r), the mean over the worlds
    d_w(r)   sqrt(p_w) (y_w(r) - m(r)), what world w adds to it
    y(r)     (1 + s) m(r) + b . d(r) + shift + what features tell + a function of the parameters
             + noise

with s ~ N(0, v) and b ~ N(0, a^2 I). Where no world is like the robot, the trials make
1 + s small. The shift is common to all rows: a robot may be worse than all worlds. A
point off the table has the m and d that rows near it let expect
(`study.sampler.between`), or that a simulator gives it (`study.sampler.asking`). Outcomes in other
units than the study's values (shares survived, scores) tell which rows are better, not
what they cost: there is no shift then.

Where costs are smooth functions of the parameters, and some trials are done, a trial's
cost counts by the logarithm of its excess over the best one (`Evidence.is_familiar`).
Where costs jump, m is all but the share of the worlds in which a row fails. What it costs if
it succeeds is then told by a second process, whose m and d are of the worlds where it does
(`Ensemble.with_successes`).
"""

from collections.abc import Callable, Collection, Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from storage.inputs import checks
from storage.inputs.errors import InputError
from study.sampler.arrays import Floats, Mask, Whole
from study.sampler.between import (
    BEST_ROWS,
    LEAST_TAUGHT,
    Guess,
    chosen_guess,
    error_of_guess,
    nearest_mean,
)
from study.sampler.covariance import FEW_WORLDS, GuessError
from study.sampler.goals import Goals
from study.sampler.transforms import (
    MOST,
    Columns,
    clip_infinities,
    new_columns,
    squarable,
    stand_ins,
    two_groups,
    without_infinities,
)

Outcomes = ArrayLike | Mapping[str, ArrayLike]
"""Costs [n, w] of rows in worlds, or by family of worlds."""
Better = Literal["lower", "higher"]

NEARNESS = 0.3  # s; of 0.03 to 1 the best compromise on tuning robots of five stores
FARTHEST = 1e6  # standard deviations: what is farther is taken for it: sums of squares stay finite
# Of the variance of all costs in all worlds, that between two groups, from which on they are
# two: 0.84 to 0.87 of walkers that walk or fall, 0.7 of one whose cost has no jump there.
LEAST_APART = 0.8
# Worlds at the mean of all successes, that are added to those where a row succeeds: one
# success of many tells little of the row.
EXPECTED_WORLDS = 2.0
# How far successes lie apart in the worlds, in standard deviations of all costs, from which
# on worlds tell at once what they cost. Walks lie 1.5 apart with the non-smooth cost, 1.2
# those of Ant (from four successes on 6:21 after 5 trials), 0.63 those of Walker2d (15:3
# after 30) and 0.73 landings of a drone (14:2 after 25); with the smooth cost, 0.18, steps
# from a first success lost to rows on a gentle ramp (5:43).
LEAST_UNIT = 0.5
NARROWEST = (
    0.1  # the same, where successes hardly differ in the worlds, or none is there
)
ROUNDING = 1e-9  # of costs in standard deviations
LEAST_SHARE = 1e-3  # of the least cost in the table: what is lower is taken for it


@dataclass(frozen=True, eq=False)
class Worlds:
    """Outcomes of n rows in w worlds.

    Attributes:
        names: of the w worlds: family and number.
        costs: [n, w], or [n, w, k] of k goals; NaN where unknown. Infinities are
            replaced already.
        weights: of the worlds, of sum 1, [w]: families count alike, and so do the
            worlds of a family.
        better: "lower" or "higher", of outcomes in units of their own; None: these are
            the study's.
        as_before: the costs as version 0.3.0 had them, where some are infinite: digests
            are of these. None: none is.
    """

    names: tuple[str, ...]
    costs: Floats
    weights: Floats
    better: Better | None = None
    as_before: Floats | None = None

    @classmethod
    def of(
        cls,
        outcomes: Outcomes,
        better: Better | None = None,
        field: str = "table.outcomes",
    ) -> "Worlds":
        """The worlds of outcomes [n, w] (or [n]: one world), or of such outcomes by family.

        [n, w, k] are those of k goals, in the units of the study's k values.

        Infinity is worse, or better, than all that is finite in any world. Refused are,
        by family: no numbers, other rows than the others', no row without gaps.
        """
        families = outcomes if isinstance(outcomes, Mapping) else {"world": outcomes}
        if not families:
            raise InputError(field, "none", "one family of worlds or more")
        names: list[str] = []
        parts: list[Floats] = []
        weights: list[Floats] = []
        for family, given in families.items():
            own = f"{field}.{family}" if outcomes is families else field
            part = matrix_of(own, given, "w")
            if parts and len(part) != len(parts[0]):
                raise InputError(
                    own, f"{len(part)} rows", f"{len(parts[0])}, as the others"
                )
            if part.ndim > 2 and better is not None:
                allowed = "[n, w], or [n, w, k] without better"
                raise InputError(f"{own}.shape", part.shape, allowed)
            if parts and part.shape[2:] != parts[0].shape[2:]:
                allowed = f"goals as the others: {parts[0].shape[2:]}"
                raise InputError(f"{own}.shape", part.shape, allowed)
            count = part.shape[1]
            names += [f"{family} {world}" for world in range(count)]
            parts.append(part)
            weights.append(np.full(count, 1.0 / len(families) / count))
        before = None
        if any(np.isinf(part).any() for part in parts):
            before = np.hstack([_each_goal(part, _clipped) for part in parts])
        costs = _each_goal(np.hstack(parts), _without_infinities)
        worlds = cls(
            names=tuple(names),
            costs=costs,
            weights=np.concatenate(weights),
            better=better,
            as_before=before,
        )
        if not worlds.known.any():
            allowed = "a row with its cost in all worlds"
            raise InputError(field, "gaps in all rows", allowed)
        return worlds

    @cached_property
    def known(self) -> Mask:
        """Rows with a cost in every world, [n]."""
        return np.asarray(
            ~np.isnan(self.costs.reshape(len(self.costs), -1)).any(axis=1)
        )

    @cached_property
    def ends(self) -> Floats:
        """The least and the largest outcome of each of k goals, [k, 2]."""
        columns = self.costs.reshape(-1, self.goals).T
        return np.array([[np.nanmin(column), np.nanmax(column)] for column in columns])

    @cached_property
    def _beyond(self) -> Floats:
        """What stands for minus infinity and for infinity, for each of k goals, [2, k]."""
        finite = self.costs if self.as_before is None else self.as_before
        return np.array(
            [stand_ins(goal) for goal in finite.reshape(-1, self.goals).T]
        ).T

    @property
    def goals(self) -> int:
        """k, 1 where outcomes have two axes."""
        return self.costs.shape[2] if self.costs.ndim > 2 else 1

    def of_numbers(self, numbers: Whole) -> "Worlds":
        """The same worlds, of some of the rows."""
        return replace(self, costs=self.costs[numbers], as_before=None)

    def without(self, names: Collection[str]) -> "Worlds":
        """The worlds but those of these names; a family keeps its weight while any is left."""
        left = np.array([name not in names for name in self.names])
        families = [name.rpartition(" ")[0] for name in self.names]
        weights = self.weights.copy()
        for family in set(families):
            own = np.array([name == family for name in families])
            if (own & left).any():
                weights[own] *= weights[own].sum() / weights[own & left].sum()
        return replace(
            self,
            names=tuple(name for name in self.names if name not in names),
            costs=self.costs[:, left],
            weights=weights[left] / weights[left].sum(),
            as_before=None,
        )

    def of_rows(self, rows: Whole, signs: Floats, goals: Goals | None) -> Floats:
        """Costs [m, w] of some rows; `signs` are -1 where values are maximised, [k]."""
        return self._as_costs(self.costs[rows], signs, goals)

    def of_outcomes(
        self, outcomes: Floats, signs: Floats, goals: Goals | None
    ) -> Floats:
        """The same of points that a user's function simulated, [m, w] or [m, w, k].

        Infinity counts as it does in the rows.

        Raises:
            InputError: outcomes in fewer or in more worlds, or of other goals.
        """
        expected = (len(outcomes), *self.costs.shape[1:])
        if outcomes.shape != expected:
            allowed = f"{expected}: a column a world of the table"
            raise InputError("outcomes(params).shape", outcomes.shape, allowed)
        found = outcomes.reshape(len(outcomes), -1, self.goals)
        finite = squarable(without_infinities(found, self._beyond))
        return self._as_costs(finite.reshape(expected), signs, goals)

    def _as_costs(self, outcomes: Floats, signs: Floats, goals: Goals | None) -> Floats:
        if goals is not None:
            return goals.cost(
                signs * outcomes.reshape(len(outcomes), len(self.names), -1)
            )
        sign = {"higher": -1.0, "lower": 1.0, None: float(signs[0])}[self.better]
        return sign * outcomes.reshape(len(outcomes), -1)


def limits_in_worlds(given: Mapping[str, Outcomes], count: int) -> dict[str, Worlds]:
    """In which worlds each row breaks a limit, 1 or 0, by its name.

    Args:
        given: what rows come to in worlds, [n, w], or by family; above 0 a limit is
            broken, as by `trial.set_constraint`.
        count: of the table's rows, n.
    """
    found = dict[str, Worlds]()
    for name, outcomes in given.items():
        field = f"table.limits.{name}"
        families = outcomes if isinstance(outcomes, Mapping) else {"world": outcomes}
        broken = dict[str, Floats]()
        for family, told in families.items():
            part = matrix_of(field, told, "w")
            if part.ndim > 2 or len(part) != count:
                allowed = f"({count}, w), as the table has rows"
                raise InputError(f"{field}.shape", part.shape, allowed)
            broken[family] = np.where(np.isnan(part), np.nan, part > 0.0)
        found[name] = Worlds.of(broken, field=field)
    return found


def _each_goal(outcomes: Floats, changed: Callable[[Floats], Floats]) -> Floats:
    """Outcomes [n, w] or [n, w, k], those of each goal changed on their own."""
    if outcomes.ndim == 2:
        return changed(outcomes)
    return np.stack([changed(goal) for goal in np.moveaxis(outcomes, -1, 0)], axis=-1)


def _without_infinities(goal: Floats) -> Floats:
    return squarable(without_infinities(goal, stand_ins(goal)))


def _clipped(goal: Floats) -> Floats:
    return squarable(clip_infinities(goal))


def matrix_of(field: str, given: Any, count: str) -> Floats:
    """Numbers as [n, count], of [n] or [n, count]; NaN is a gap, infinity a value.

    With count "w" they may be of several goals, [n, w, k].
    """
    try:
        # NumPy would count nanoseconds, and drop parts.
        if np.asarray(given).dtype.kind in "mMc":
            raise TypeError
        matrix = np.array(checks.unmasked(given), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        where, value = checks.first_that_is_no_number(field, given)
        shown = type(given).__name__ if where == field else value
        raise InputError(where, shown, f"numbers, [n, {count}]") from None
    matrix = matrix[:, None] if matrix.ndim == 1 else matrix
    if matrix.ndim not in ((2, 3) if count == "w" else (2,)) or not matrix.size:
        allowed = f"[n, {count}], n and {count} at least 1"
        raise InputError(f"{field}.shape", matrix.shape, allowed)
    return matrix


class Ensemble:
    """The worlds' costs of m rows as a Gaussian process takes them."""

    def __init__(
        self,
        worlds: Worlds,
        costs: Floats,
        unit: Floats | None = None,
        as_costs: Callable[[Floats], Floats] = np.asarray,
    ) -> None:
        """Take the costs [m, w] of rows, as `Worlds.of_rows` has them.

        Args:
            worlds: whose costs they are.
            costs: see above.
            unit: the rows in the unit cube, [m, e], to guess points between them;
                None: of goals that were drawn for one trial, whose proposal would take
                longer for it.
            as_costs: the same of other points, by `Worlds.of_outcomes`.
        """
        self.names = worlds.names
        self._as_costs = as_costs
        self._places = unit
        # How many worlds of one weight tell as much, less one: of one world nothing is
        # known of how far others are from it.
        self.freedom = 1.0 / float((worlds.weights**2).sum()) - 1.0
        # What was computed of it, for whoever asks again.
        self.kept: dict[Any, Any] = {}
        # Whether outcomes and values have one unit.
        self.in_costs = worlds.better is None
        # Units of their own may have any zero: no logarithm.
        self._least = float(costs.min()) if self.in_costs else 0.0
        own = self._spread(costs)
        spread = float(own.std())
        self.varies = spread > 1e-12 * float(np.abs(own).max())
        self._middle, self._unit = float(own.mean()), spread if self.varies else 1.0
        own = self.standard(costs)
        self.mean = own @ worlds.weights  # m, [m]
        if self._is_from_best_row:
            # 1 + s multiplies what a row costs above zero. With zero at its best row, a fall
            # there says that all rows may be worse, not that the one world's order is wrong:
            # a line through three falls sent the model to the worst rows of the table.
            self._middle += self._unit * float(own.min())
            own = self.standard(costs)
            self.mean = own @ worlds.weights
        # The least and the largest cost of all rows in all worlds.
        self.ends = float(own.min()), float(own.max())
        self.parts = (own - self.mean[:, None]) * np.sqrt(worlds.weights)  # d, [m, w]
        # As `transforms.Columns` has them.
        shift, gap = np.ones(len(own)), np.zeros(len(own))
        self.columns = np.column_stack([self.parts, shift, self.mean, gap])
        self.weights = worlds.weights
        # What the same rows cost in the worlds where they succeed: `with_successes`.
        self.of_successes: Ensemble | None = None
        self.is_of_successes = False
        # Up to what standard cost a row succeeds.
        self.goal = np.inf
        # Whether the first success is enough: many worlds tell that others lie far apart.
        self.tells_successes = False

    def with_successes(self, success: float | None) -> "Ensemble":
        """The same worlds, which also tell what a row costs in those where it succeeds.

        Where costs jump, failures hide what successes cost: the mean over the worlds is
        the share of failures, and little else. So rows have the mean of their costs in
        the worlds where they succeed, and what each of these adds to it, in units of the
        successes of the whole table. Where no world has a success, both are 0.

        Args:
            success: cost up to which a trial has succeeded; None: nothing says it.

        Returns:
            Itself where costs do not jump, or goals were drawn.
        """
        if success is None or self.is_drawn or not self.in_costs or self.is_smooth:
            return self
        if success not in self.kept:
            self.kept[success] = self._with_successes(success)
        found: Ensemble = self.kept[success]
        return found

    def _with_successes(self, success: float) -> "Ensemble":
        successes = self._among_successes(success)
        both = copy(self)
        columns = [successes.parts, successes.mean, self.columns]
        # Points have one matrix, of which each process takes its own columns.
        both.columns = successes.columns = np.column_stack(columns)
        both.of_successes = successes
        both.kept = {}
        is_far = successes._unit >= LEAST_UNIT * self._unit
        both.tells_successes = is_far and not self._are_few
        return both

    def _among_successes(self, success: float) -> "Ensemble":
        told = self.told(self.columns)
        (goal,) = self.standard(np.array([success]))
        succeeds = told <= goal + ROUNDING
        middle, unit = goal, NARROWEST
        if succeeds.any():
            middle = told[succeeds].mean()
            unit = max(told[succeeds].std(), unit)

        found = copy(self)
        found.is_of_successes, found.goal, found.kept = True, goal, {}
        found.guess_error = None  # how far a guess is off here is not known
        found._middle += self._unit * middle
        found._unit *= unit
        found.mean, found.parts = self._over(succeeds, (told - middle) / unit)
        return found

    def _over(self, succeeds: Mask, own: Floats) -> tuple[Floats, Floats]:
        """Mean and parts of costs [m, w] over the worlds where points succeed, [m] and [m, w]."""
        share = np.where(succeeds, self.weights, 0.0)
        expected = EXPECTED_WORLDS / len(self.names)
        mean = (share * own).sum(axis=1) / (share.sum(axis=1) + expected)
        away = np.where(succeeds, own - mean[:, None], 0.0)
        return mean, away * np.sqrt(self.weights)

    def columns_of(self, outcomes: Floats) -> Floats:
        """The `columns` of other points, which came to these outcomes in the worlds, [m, w]."""
        costs = self._as_costs(outcomes)
        own = self.standard(costs)
        mean = own @ self.weights
        parts = (own - mean[:, None]) * np.sqrt(self.weights)
        found = [parts, np.ones(len(own)), mean, np.zeros(len(own))]
        theirs = self.of_successes
        if theirs is not None:
            succeeds = own <= theirs.goal + ROUNDING
            mean, parts = self._over(succeeds, theirs.standard(costs))
            found = [parts, mean, *found]
        return np.column_stack(found)

    def layout(self, features: int, coordinates: int) -> Columns:
        """The columns of points that have `columns` between features and coordinates."""
        found = new_columns(
            features,
            coordinates,
            len(self.names),
            has_successes=self.is_of_successes or self.of_successes is not None,
        )
        return found.of_successes if self.is_of_successes else found

    def reaches(self, cost: float) -> bool:
        """Whether some row costs no more than this in some world."""
        return bool(self.standard(np.array([cost]))[0] >= self.ends[0])

    def all_reach(self, cost: float) -> bool:
        """Whether no row costs more than this in any world."""
        return bool(self.standard(np.array([cost]))[0] >= self.ends[1])

    @cached_property
    def parting(self) -> float | None:
        """The cost between what works and what fails; None where costs do not jump, or not so.

        It takes the place of a success where nobody says what one is.
        """
        if self.is_drawn or not self.varies:
            return None
        middle, apart = two_groups(self.told(self.columns).ravel())
        # To ask whether costs are smooth takes long.
        if apart < LEAST_APART or not self.jumps:
            return None
        return float(self.costs(np.array([middle]))[0])

    @property
    def jumps(self) -> bool:
        """Whether costs jump from one point to the next; few rows do not tell."""
        if not self.in_costs or len(self.mean) < LEAST_TAUGHT:
            return False
        return not self.is_smooth

    def told(self, features: Floats) -> Floats:
        """What each world costs, [t, w], where points have these features, [t, k]."""
        worlds, mean = len(self.names), features[:, -2]
        parts = features[:, -3 - worlds : -3]
        return np.asarray(mean[:, None] + parts / np.sqrt(self.weights))

    @property
    def floor(self) -> float:
        """What no cost is below: of positive ones a small share of the table's least."""
        return LEAST_SHARE * self._least if self._least > 0.0 else -np.inf

    @property
    def is_drawn(self) -> bool:
        """Whether its costs are of goals that were drawn for one trial."""
        return self._places is None

    @cached_property
    def guess(self) -> Guess:
        """What the rows tell of points between them; learned once."""
        if self._places is None:
            return nearest_mean
        return chosen_guess(self._places, self.mean)

    @cached_property
    def guess_error(self) -> GuessError | None:
        """What `guess` may be off by; None where it tells something, or none is asked."""
        if self._places is None or not self.in_costs:
            return None
        # One world falls for reasons of its own: the robot need not be as jagged there.
        if len(self.names) == 1:
            return None
        error = error_of_guess(self._places, self.mean)
        # To ask whether costs are smooth takes long.
        return None if error is None or self.is_smooth else error

    @property
    def tells_little(self) -> bool:
        """Whether it is soon doubted: few worlds or rows, or rows that tell of no other point."""
        return self._are_few or self.guess_error is not None

    @property
    def _are_few(self) -> bool:
        return len(self.names) < FEW_WORLDS or len(self.mean) < BEST_ROWS

    @property
    def _is_from_best_row(self) -> bool:
        """Whether costs are from the best row, not from the table's mean: see `standard`."""
        is_alone = self.in_costs and len(self.names) == 1 and not self.is_drawn
        return is_alone and self.varies and not self.is_smooth

    @property
    def is_smooth(self) -> bool:
        """Whether the mean cost is a smooth function of the parameters near the best rows."""
        return self.guess is not nearest_mean

    def standard(self, costs: Floats) -> Floats:
        """Costs in the model's units, standard deviations over the table from its mean.

        Of positive ones that is after y = log(1 + (c - c_0) / s c_0), with c_0 the
        least cost in the table: a logarithm under which costs near the least do not
        look alike. Below c_0, y = log(c / c_0). Where one world's costs jump, its best row
        takes the place of the mean.
        """
        standard = (self._spread(costs) - self._middle) / self._unit
        return np.clip(standard, -FARTHEST, FARTHEST)

    def costs(self, y: Floats) -> Floats:
        """The costs of which these are the standard ones, [m]."""
        own = self._middle + self._unit * y
        if self._least <= 0.0:
            return own
        above = 1.0 + NEARNESS * np.expm1(np.maximum(own, 0.0))
        return np.asarray(self._least * np.where(own < 0.0, np.exp(own), above))

    def _spread(self, costs: Floats) -> Floats:
        if self._least <= 0.0:
            return costs
        with np.errstate(over="ignore"):
            ratio = np.minimum(costs / self._least, MOST)
        below = np.log(np.clip(ratio, LEAST_SHARE, 1.0))
        return np.asarray(np.log1p(np.maximum(ratio - 1.0, 0.0) / NEARNESS) + below)
