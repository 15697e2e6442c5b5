"""A search space as numbers: Optuna's values, rows of floats, and the unit cube.

| form | shape | a categorical | a logarithmic parameter |
|---|---|---|---|
| values | dict | one of its choices | as suggested |
| rows | [n, d] | the index of its choice | as suggested |
| unit cube | [n, e], e >= d | one column a choice, 1/sqrt(2) where taken | its logarithm |

A number stands for another one, of a row or at the end of a range, if it is that number
as printed with `PRINTED_DIGITS` digits or more, or is as near to it as rounding brings
two ways of computing a decimal grid: `GRID_TOLERANCE` of the distance to the next row.
Where several are that near, an equal one comes first, then the nearest.

Distances in the unit cube are what a Euclidean kernel sees: a parameter's whole range
is 1, and two different choices are 1 apart. New points are drawn anywhere, or near good
ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from numbers import Real
from typing import Any

import numpy as np
import scipy
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from study.sampler.arrays import Floats, Mask

Number = FloatDistribution | IntDistribution

PRINTED_DIGITS = 8  # significant ones, as of a bench's sheet
GRID_TOLERANCE = 1e-6  # np.arange(-100, 100, 0.001) is off by 7e-7 of its step
STEP_TOLERANCE = 1e-8  # of a step: a value on the grid may be so far off, as for Optuna
CHOICE_LENGTH = np.sqrt(0.5)  # of a one-hot code: two of them are 1 apart
# log10 of a step's standard deviation, in ranges: 0.3 % to 50 %.
STEP_DECADES = (-2.5, -0.3)
# Of a range: a point off the table that is nearer to a trial, in every parameter,
# repeats it. With two knobs half of the trials were such repeats; in 16 dimensions none
# is.
REPEAT = 0.01
SAME_DIGITS = 9  # of a coordinate in the unit cube: rounding changes later ones


@dataclass(frozen=True, eq=False)
class Space:
    """Parameters by name, in a fixed order, with their distributions.

    Attributes:
        names: of the d parameters.
        distributions: of each.
        pins: column and number of the values that all new points have.
    """

    names: tuple[str, ...]
    distributions: tuple[BaseDistribution, ...]
    pins: tuple[tuple[int, float], ...] = ()

    @classmethod
    def of(cls, distributions: Mapping[str, BaseDistribution]) -> "Space":
        """The space of a dict of distributions, in its order."""
        return cls(tuple(distributions), tuple(distributions.values()))

    def __len__(self) -> int:
        """Number of parameters, d."""
        return len(self.names)

    def as_dict(self) -> dict[str, BaseDistribution]:
        """Distributions by name, as Optuna has them."""
        return dict(zip(self.names, self.distributions, strict=True))

    def row(self, values: Mapping[str, Any]) -> Floats | None:
        """A trial's values as one row [d]; None where one is missing, or of no use here."""
        row = np.empty(len(self))
        for column, name in enumerate(self.names):
            number = self.number(column, values[name]) if name in values else None
            if number is None:
                return None
            row[column] = number
        return row

    def number(self, column: int, value: Any) -> float | None:
        """A value of one parameter as a row has it; None for a choice or a kind it has not."""
        distribution = self.distributions[column]
        if isinstance(distribution, CategoricalDistribution):
            place = _choice(distribution, value)
            return None if place is None else float(place)
        if not is_number(value):
            return None
        try:
            # A number outside of the range is one, too.
            number = float(distribution.to_internal_repr(value))
        except (TypeError, ValueError, OverflowError):
            return None
        is_other = isinstance(value, int) and int(number) != value  # beyond 2^53
        return None if is_other else number

    def pinned(self, values: Mapping[str, Any]) -> "Space":
        """The space, with these values of some parameters in all new points."""
        pins = []
        for column, name in enumerate(self.names):
            number = self.number(column, values[name]) if name in values else None
            if number is not None:
                pins.append((column, number))
        return replace(self, pins=tuple(pins))

    def values(self, row: Floats) -> dict[str, Any]:
        """One row [d] as values, numbers of Python's own types."""
        pairs = zip(self.names, self.distributions, row.tolist(), strict=True)
        return {
            name: _external(distribution, value) for name, distribution, value in pairs
        }

    def unit(self, rows: Floats) -> Floats:
        """Rows [n, d] in the unit cube, [n, e]; values outside the ranges are moved to the edge."""
        columns = zip(self.distributions, rows.T, strict=True)
        parts = [_to_unit(distribution, values) for distribution, values in columns]
        return np.hstack(parts) if parts else np.zeros((len(rows), 0))

    def from_fractions(self, fractions: Floats) -> Floats:
        """Rows [n, d] from numbers between 0 and 1, [n, d]: steps and integers are rounded."""
        rows = np.empty_like(fractions)
        for column, distribution in enumerate(self.distributions):
            rows[:, column] = _from_fraction(distribution, fractions[:, column])
        for column, number in self.pins:
            rows[:, column] = number
        return rows

    def fractions(self, rows: Floats) -> Floats:
        """The numbers between 0 and 1 that rows [n, d] come from, [n, d]."""
        fractions = np.empty_like(rows)
        for column, distribution in enumerate(self.distributions):
            values = rows[:, column]
            if isinstance(distribution, CategoricalDistribution):
                fractions[:, column] = (values + 0.5) / len(distribution.choices)
            else:
                fractions[:, column] = _to_unit(distribution, values)[:, 0]
        return fractions


def anywhere(space: Space, count: int, rng: np.random.Generator) -> Floats:
    """Points uniform over the space, logarithmic parameters over their logarithms, [count, d]."""
    return space.from_fractions(rng.random((count, len(space))))


def nearby(
    space: Space, centres: Floats, count: int, rng: np.random.Generator
) -> Floats:
    """Points near some of the centres [c, d], each at its own distance, [count, d].

    Each moves a random part of its coordinates (at least one) by normal steps of one
    size, drawn evenly over decades; at an edge it is reflected. A categorical that
    moves takes any choice.
    """
    start = space.fractions(centres[rng.integers(len(centres), size=count)])
    size = 10.0 ** rng.uniform(*STEP_DECADES, (count, 1))
    moved = rng.random(start.shape) < rng.random((count, 1))
    moved[np.arange(count), rng.integers(len(space), size=count)] = True
    steps = size * rng.standard_normal(start.shape)
    target = reflected(start + steps)
    chosen = rng.random(start.shape)
    free = [isinstance(each, CategoricalDistribution) for each in space.distributions]
    target = np.where(free, chosen, target)
    return space.from_fractions(np.where(moved, target, start))


def reflected(fractions: Floats) -> Floats:
    """Numbers that may lie beyond 0 or 1, reflected there; at the edge if still beyond."""
    inside = np.abs(fractions)
    return np.clip(np.where(inside > 1.0, 2.0 - inside, inside), 0.0, 1.0)


def not_among(points: Floats, taken: Floats) -> Mask:
    """Which points of the unit cube [m, e] are none of the taken ones [t, e], [m].

    All, if that leaves none. What differs by rounding is the same: 0.1, and the step of
    0.1 that comes out as 0.10000000000000009.
    """
    known = set(keys(taken))
    new = np.array([key not in known for key in keys(points)], dtype=bool)
    return new if new.any() else np.ones(len(points), dtype=bool)


def keys(unit: Floats) -> list[bytes]:
    """By which points of the unit cube [m, e] are known, whatever rounding made of them, [m]."""
    rounded = unit.round(SAME_DIGITS) + 0.0  # 0 in place of -0
    return [row.tobytes() for row in np.ascontiguousarray(rounded)]


def not_near(points: Floats, taken: Floats) -> Mask:
    """Which points of the unit cube [m, e] are `REPEAT` or more from all taken ones [t, e], [m].

    In one parameter at least: it is the largest of the distances.
    """
    away = scipy.spatial.distance.cdist(points, taken, "chebyshev")
    return np.asarray(away.min(axis=1, initial=np.inf) >= REPEAT)


def as_suggested(distribution: BaseDistribution, value: Any) -> Any:
    """A value in the form of a distribution: of its type, or the equal one of its choices.

    It is a ValueError if the distribution does not have it.
    """
    if isinstance(distribution, CategoricalDistribution):
        place = _choice(distribution, value)
        if place is None:
            raise ValueError(f"{value!r} is not in {distribution}")
        return distribution.choices[place]
    assert isinstance(distribution, Number)
    if not is_number(value) or not bool(_taken(distribution, _column_of(value))[0]):
        raise ValueError(f"{value!r} is not in {distribution}")
    if isinstance(distribution, IntDistribution):
        return round(value)
    return min(max(float(value), distribution.low), distribution.high)


def printed_tolerance(value: float) -> float:
    """How far a number may be from one that is printed like it, with eight digits or more."""
    if not value:
        return 0.0
    shown = Decimal(repr(value)).normalize()
    digits = max(len(shown.as_tuple().digits), PRINTED_DIGITS)
    return 0.5 * (1.0 + 1e-6) * 10.0 ** (shown.adjusted() + 1 - digits)


def standing_for(
    distribution: Number, column: Floats, value: float
) -> tuple[Mask, Floats]:
    """Which numbers [n] of a column a value may stand for, and how far each is, in ranges.

    Whole numbers are printed whole.
    """
    away = np.abs(column - value)
    whole = isinstance(distribution, IntDistribution)
    printed = 0.0 if whole else printed_tolerance(value)
    span = float(distribution.high - distribution.low) or 1.0
    nearest = float(column[away.argmin()])
    near = printed
    if abs(nearest - value) <= max(printed, GRID_TOLERANCE * span):
        gap = np.abs(column[column != nearest] - nearest).min(initial=span)
        # Else the least of 1e-9 to 1 would be all that is below 1e-6.
        if distribution.log:
            gap = min(gap, abs(nearest))
        near = max(printed, GRID_TOLERANCE * gap)
    return away <= near, away / span


def _column_of(value: Any) -> Floats:
    """A number as a column; a ValueError if it is none that a float can hold."""
    try:
        return np.array([float(value)])
    except OverflowError as error:
        raise ValueError(str(error)) from None


def _choice(distribution: CategoricalDistribution, value: Any) -> int | None:
    """The place of a choice that a value is or, of floats, stands for; None without any."""
    try:
        return int(distribution.to_internal_repr(value))
    except (TypeError, ValueError):
        pass
    choices: Sequence[Any] = distribution.choices
    numbers = [
        (place, choice)
        for place, choice in enumerate(choices)
        if isinstance(choice, float)
    ]
    if not numbers or not is_number(value):
        return None
    column = np.array([float(choice) for _, choice in numbers])
    ends = FloatDistribution(column.min(), column.max())
    near, away = standing_for(ends, column, float(value))
    return (
        numbers[int(np.where(near, away, np.inf).argmin())][0] if near.any() else None
    )


def first_not_taken(
    own: BaseDistribution, values: Floats, suggested: BaseDistribution
) -> int | None:
    """The first of the values [n] of one parameter that another distribution does not hold.

    Values are as rows of their own distribution have them.
    """
    if isinstance(own, Number) and isinstance(suggested, Number):
        outside = np.flatnonzero(~_taken(suggested, values))
        return int(outside[0]) if len(outside) else None
    for place in np.sort(np.unique(values, return_index=True)[1]).tolist():
        try:
            as_suggested(suggested, _external(own, float(values[place])))
        except ValueError:
            return int(place)
    return None


def _taken(distribution: Number, values: Floats) -> Mask:
    """Which numbers [n] lie in a distribution, or stand for an end of it, and are on its steps."""
    low, high = float(distribution.low), float(distribution.high)
    if isinstance(distribution, FloatDistribution):
        low -= max(printed_tolerance(low), STEP_TOLERANCE * (high - low))
        high += max(printed_tolerance(high), STEP_TOLERANCE * (high - low))
    inside = (low <= values) & (values <= high)
    if isinstance(distribution, FloatDistribution):
        # An end of 17 digits, as a sheet has it with eight, may lie beyond the end
        # itself.
        beyond = np.maximum(distribution.low - values, values - distribution.high)
        widest = 10.0 ** (1 - PRINTED_DIGITS) * np.abs(values)
        for place in np.flatnonzero(~inside & (beyond <= widest)).tolist():
            inside[place] = beyond[place] <= printed_tolerance(float(values[place]))
    if distribution.step is None:
        return np.asarray(inside)
    steps = (values - distribution.low) / distribution.step
    return np.asarray(inside & (np.abs(steps - np.round(steps)) < STEP_TOLERANCE))


def is_number(value: Any) -> bool:
    """Whether it is a number, and not a flag that counts as one."""
    return isinstance(value, Real | Decimal) and not isinstance(value, bool)


def _external(distribution: BaseDistribution, value: float) -> Any:
    """The value of a number, of Python's own type."""
    if isinstance(distribution, IntDistribution):
        return round(value)
    return distribution.to_external_repr(value)


def _to_unit(distribution: BaseDistribution, values: Floats) -> Floats:
    """One parameter in the unit cube, [n, 1] or, categorical, [n, choices]."""
    if isinstance(distribution, CategoricalDistribution):
        choices = np.arange(len(distribution.choices))
        return np.asarray(
            CHOICE_LENGTH * (values[:, None] == choices).astype(np.float64)
        )
    assert isinstance(distribution, Number)
    low, high = _ends(distribution)
    if high <= low:  # a range of one value
        return np.zeros((len(values), 1))
    values = np.clip(values, distribution.low, distribution.high)
    values = np.log(values) if distribution.log else values
    return np.clip((values - low) / (high - low), 0.0, 1.0)[:, None]


def _from_fraction(distribution: BaseDistribution, fractions: Floats) -> Floats:
    """One parameter [n] from numbers between 0 and 1, [n]."""
    if isinstance(distribution, CategoricalDistribution):
        last = len(distribution.choices) - 1
        return np.minimum(np.floor(fractions * len(distribution.choices)), last)
    assert isinstance(distribution, Number)
    low, high = _ends(distribution)
    values = low + fractions * (high - low)
    values = np.exp(values) if distribution.log else values
    if distribution.step is not None and not distribution.log:
        steps = np.round((values - distribution.low) / distribution.step)
        values = distribution.low + steps * distribution.step
    if isinstance(distribution, IntDistribution):
        values = np.round(values)
    return np.clip(values, distribution.low, distribution.high)


def _ends(distribution: Number) -> tuple[float, float]:
    """Where the unit interval begins and ends: half a step outside, for steps and integers."""
    half = 0.5 * (distribution.step or 0.0)
    low, high = distribution.low - half, distribution.high + half
    if distribution.log:
        return float(np.log(low)), float(np.log(high))
    return low, high
