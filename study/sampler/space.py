"""A search space as numbers: Optuna's values, rows of floats, and the unit cube.

| form | shape | a categorical | a logarithmic parameter |
|---|---|---|---|
| values | dict | one of its choices | as suggested |
| rows | [n, d] | the index of its choice | as suggested |
| unit cube | [n, e], e >= d | one column a choice, 1/sqrt(2) where taken | its logarithm |

Distances in the unit cube are what a Euclidean kernel sees: a parameter's whole range is 1, and two
different choices are 1 apart.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.trial import FrozenTrial

Floats = NDArray[np.float64]
Number = FloatDistribution | IntDistribution

STEP_TOLERANCE = 1e-8  # of a step: how far a value on the grid may be off, as for Optuna
CHOICE_LENGTH = np.sqrt(0.5)  # of a one-hot code: two of them are 1 apart


@dataclass(frozen=True, eq=False)
class Space:
    """Parameters by name, in a fixed order, with their distributions."""

    names: tuple[str, ...]
    distributions: tuple[BaseDistribution, ...]

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

    def holds(self, trial: FrozenTrial) -> bool:
        """Whether a trial has a value of the right kind for every parameter."""
        return all(
            type(trial.distributions.get(name)) is type(distribution)
            and (
                not isinstance(distribution, CategoricalDistribution)
                or trial.distributions[name] == distribution
            )
            for name, distribution in zip(self.names, self.distributions, strict=True)
        )

    def rows(self, trials: Iterable[Mapping[str, Any]]) -> Floats:
        """Values of trials as rows, [n, d]."""
        pairs = tuple(zip(self.names, self.distributions, strict=True))
        rows = [[_internal(d, values[name]) for name, d in pairs] for values in trials]
        return np.array(rows, dtype=np.float64).reshape(len(rows), len(self))

    def values(self, row: Floats) -> dict[str, Any]:
        """One row [d] as values, numbers of Python's own types."""
        pairs = zip(self.names, self.distributions, row.tolist(), strict=True)
        return {name: _external(distribution, value) for name, distribution, value in pairs}

    def unit(self, rows: Floats) -> Floats:
        """Rows [n, d] in the unit cube, [n, e]; values outside the ranges are moved to the edge."""
        parts = [
            _to_unit(distribution, rows[:, column])
            for column, distribution in enumerate(self.distributions)
        ]
        return np.hstack(parts) if parts else np.zeros((len(rows), 0))

    def from_fractions(self, fractions: Floats) -> Floats:
        """Rows [n, d] from numbers between 0 and 1, [n, d]: steps and integers are rounded."""
        rows = np.empty_like(fractions)
        for column, distribution in enumerate(self.distributions):
            rows[:, column] = _from_fraction(distribution, fractions[:, column])
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


def same_kind(first: BaseDistribution, second: BaseDistribution) -> bool:
    """Whether Optuna lets one parameter have both distributions."""
    if type(first) is not type(second):
        return False
    if isinstance(first, CategoricalDistribution):
        return bool(first == second)
    return bool(first.log == second.log)  # type: ignore[attr-defined]


def takes(distribution: BaseDistribution, value: Any) -> bool:
    """Whether a value, of the kind that a distribution has, lies in it and on its steps."""
    if isinstance(distribution, CategoricalDistribution):
        return value in distribution.choices
    assert isinstance(distribution, FloatDistribution | IntDistribution)
    if not distribution.low <= value <= distribution.high:
        return False
    if distribution.step is None:
        return True
    steps = (value - distribution.low) / distribution.step
    return bool(abs(steps - round(steps)) < STEP_TOLERANCE)


def _internal(distribution: BaseDistribution, value: Any) -> float:
    """A number for a value; a number outside its range is kept."""
    return float(distribution.to_internal_repr(value))


def _external(distribution: BaseDistribution, value: float) -> Any:
    """The value of a number, of Python's own type."""
    if isinstance(distribution, IntDistribution):
        return round(value)
    return distribution.to_external_repr(value)


def _to_unit(distribution: BaseDistribution, values: Floats) -> Floats:
    """One parameter in the unit cube, [n, 1] or, categorical, [n, choices]."""
    if isinstance(distribution, CategoricalDistribution):
        choices = np.arange(len(distribution.choices))
        return np.asarray(CHOICE_LENGTH * (values[:, None] == choices).astype(np.float64))
    assert isinstance(distribution, FloatDistribution | IntDistribution)
    low, high = _ends(distribution)
    if high <= low:
        return np.zeros((len(values), 1))
    values = np.clip(values, distribution.low, distribution.high)
    values = np.log(values) if distribution.log else values
    return np.clip((values - low) / (high - low), 0.0, 1.0)[:, None]


def _from_fraction(distribution: BaseDistribution, fractions: Floats) -> Floats:
    """One parameter [n] from numbers between 0 and 1, [n]."""
    if isinstance(distribution, CategoricalDistribution):
        last = len(distribution.choices) - 1
        return np.minimum(np.floor(fractions * len(distribution.choices)), last)
    assert isinstance(distribution, FloatDistribution | IntDistribution)
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
    return (float(np.log(low)), float(np.log(high))) if distribution.log else (low, high)
