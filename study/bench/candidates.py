"""The candidates of a bench in a file: which columns they are, of what type, within which bounds.

The values of a column suggest what a parameter is, and that is a guess. What the
bench's file declares (type, bounds, step, log) wins. A row that does not keep to it is
refused by name; nothing outside of it is ever proposed.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from storage.inputs.config import Table
from storage.inputs.errors import InputError, listed
from study.bench.limits import ByFamily
from study.sampler.rows import Rows
from study.sampler.table import FeatureTable
from study.sampler.worlds import Better

if TYPE_CHECKING:
    from storage.foreign_tables import ForeignTable

Told = Callable[[str, tuple[str, ...]], ByFamily]
"""What columns of a file tell, by the key that names them and their names or patterns."""

KINDS = ("float", "whole", "choice")
FARTHEST = 1e300  # of a bound, so that differences of two are finite
LEAST_STEP = 1e-300
OFF_STEP = 1e-8  # of a step: how far a value may be off, as for Optuna


@dataclass(frozen=True)
class Declared:
    """What a bench's file says of a parameter; None: nothing.

    Attributes:
        kind: "float", "whole" or "choice".
        bounds: the least and the largest value.
        step: between two values, from the least on.
        log: whether it is on a logarithmic scale.
    """

    kind: str | None = None
    bounds: tuple[float, float] | None = None
    step: float | None = None
    log: bool = False

    def distribution(self, name: str, table: "ForeignTable") -> BaseDistribution:
        """The distribution of the parameter that a column of a table has.

        Raises:
            InputError: a column or a declaration that this kind of parameter cannot
                have.
        """
        if self.kind == "choice":
            return self._choice(name, table)
        numbers = table.numbers(name)
        known = numbers[np.isfinite(numbers)]
        if not len(known):
            raise InputError(f"candidates.{name}", "no number", "a column of numbers")
        low, high = self.bounds or (float(known.min()), float(known.max()))
        if self.log and low <= 0.0:
            allowed = f"a column above 0; its least value is {low}"
            raise InputError("candidates.log", name, allowed)
        if self.log and self.step is not None:
            allowed = "none on a logarithmic scale"
            raise InputError(f"candidates.step.{name}", self.step, allowed)
        if self.step is not None:
            _require_steps(name, numbers, low, self.step)
        if self._is_whole(table.values(name)):
            return self._whole_numbers(name, low, high)
        return FloatDistribution(low, high, log=self.log, step=self.step)

    def _choice(self, name: str, table: "ForeignTable") -> CategoricalDistribution:
        for key, given in (("bounds", self.bounds), ("step", self.step)):
            if given is not None:
                raise InputError(f"candidates.{key}.{name}", given, "none of a choice")
        if self.log:
            raise InputError("candidates.log", name, "parameters that are no choices")
        values = table.values(name).tolist()
        choices = [None if value != value else value for value in values]  # of NaN
        return CategoricalDistribution(tuple(dict.fromkeys(choices)))

    def _is_whole(self, values: NDArray[Any]) -> bool:
        """Whether the parameter has whole numbers: as declared, or as the column suggests."""
        if self.kind is not None:
            return self.kind == "whole"
        declared = (*(self.bounds or ()), self.step or 1.0)
        return values.dtype.kind in "iu" and all(map(float.is_integer, declared))

    def _whole_numbers(self, name: str, low: float, high: float) -> IntDistribution:
        if self.step is not None and not self.step.is_integer():
            allowed = "a whole number, as its type"
            raise InputError(f"candidates.step.{name}", self.step, allowed)
        least, most = math.ceil(low), math.floor(high)
        if least > most:
            allowed = "bounds with a whole number between them, as its type"
            raise InputError(f"candidates.bounds.{name}", [low, high], allowed)
        return IntDistribution(least, most, log=self.log, step=int(self.step or 1))


def _require_steps(
    name: str, values: NDArray[np.float64], low: float, step: float
) -> None:
    """Refuse a value that lies between two steps."""
    steps = (values - low) / step
    is_between = np.abs(steps - np.round(steps)) > OFF_STEP
    if is_between.any():
        row = int(is_between.argmax())
        allowed = f"steps of {step:g} from {low:g} on"
        raise InputError(f"candidates.{name}[{row}]", float(values[row]), allowed)


def better_of(table: Table) -> Better | None:
    """Which outcomes are good, where they are in units of their own."""
    given = table.text("better", "costs", ("lower", "higher", "costs"))
    return None if given == "costs" else cast(Better, given)


def choices_of(distribution: BaseDistribution) -> dict[str, Any]:
    """The choices of a parameter by what a file has for them; none where it is a number."""
    if not isinstance(distribution, CategoricalDistribution):
        return {}
    choices = distribution.choices
    return {"" if each is None else str(each): each for each in choices}


def beyond_bounds(
    candidates: Table, begun: Mapping[str, BaseDistribution]
) -> Iterator[str]:
    """Parameters of a bench that go beyond the bounds which its file declares, a line each.

    Until version 0.3.0 bounds of whole numbers were made whole, downwards.
    """
    for name, (low, high) in candidates.unread.get("bounds", {}).items():
        own = begun.get(name)
        if isinstance(own, IntDistribution) and (own.low < low or own.high > high):
            yield (
                f"candidates.bounds.{name}: the bench was begun with {own.low} to {own.high}, "
                f"beyond {low:g} to {high:g}; in a new bench, which takes an `export` of this one, "
                "the bounds hold"
            )


def repeated(rows: Rows) -> Iterator[str]:
    """A line, if rows are passed over though they tell something else than an earlier one."""
    costs = [] if rows.worlds is None else [rows.worlds.costs]
    known = np.nan_to_num(np.hstack([rows.features, *costs]))
    _, first, place = np.unique(
        rows.parameters, axis=0, return_index=True, return_inverse=True
    )
    before = first[place.ravel()]
    others = np.flatnonzero((known != known[before]).any(axis=1))
    for row in others[:1]:
        yield (
            f"candidates: row {row} has the parameters of row {before[row]} and other numbers: "
            f"the earlier one counts (such rows: {len(others)})"
        )


def of_file(
    table: Table,
    begun: Mapping[str, BaseDistribution] | None,
    limits: Callable[[ByFamily, Told], Mapping[str, ByFamily]],
) -> FeatureTable:
    """The rows of a file, whose columns the table [candidates] names.

    Args:
        table: of the bench's file.
        limits: in worlds, by what rows cost in these (nothing, in other units than the
            value) and by what the file's columns tell.
        begun: the parameters of a bench that was begun, perhaps by an earlier version,
            which took other guesses: they hold. None: it begins now.

    Raises:
        InputError: naming the key of the file, or the column and row.
    """
    from storage.foreign_tables import ForeignTable  # PyArrow is slow to load

    path = table.folder / table.text("file")
    names = table.texts("parameters")
    features = table.texts("features")
    patterns = table.texts("outcomes")
    better = better_of(table)
    declared = _declared(table, names)
    if not features and not patterns:
        table.done()  # a key may be misspelled
        allowed = "what tells of candidates: these, or features, or both"
        raise InputError("candidates.outcomes", "none", allowed)
    found = ForeignTable.read("candidates.file", path, of_columns="candidates")
    if begun is None:
        space = {
            name: each.distribution(name, found) for name, each in declared.items()
        }
    else:
        space = dict(begun)
    taken = set(names)
    outcomes = ByFamily()  # each pattern is a family
    for pattern in patterns:
        named = _named(found, pattern)
        twice = [name for name in named if name in taken]
        if not named or (twice and begun is None):
            allowed = f"some of {listed(found.names, pattern)}"
            if twice:
                allowed = (
                    f"each column once: {twice[0]} is a parameter or in another pattern"
                )
            raise InputError("candidates.outcomes", pattern, allowed)
        taken.update(named)
        outcomes[pattern] = _columns(found, named)
        is_empty = np.isnan(outcomes[pattern])
        if is_empty.any() and begun is None:
            row, column = np.argwhere(is_empty)[0].tolist()
            allowed = "what the trial costs in this world (inf: worse than all); or no such row"
            raise InputError(f"candidates.{named[column]}[{row}]", "nothing", allowed)
    if (
        patterns
        and begun is None
        and not np.isfinite(np.hstack([*outcomes.values()])).any()
    ):
        raise InputError(
            "candidates.outcomes", "infinite in all rows", "a finite number"
        )

    def told(field: str, patterns: tuple[str, ...]) -> ByFamily:
        families = {pattern: _named(found, pattern) for pattern in patterns}
        for pattern, named in families.items():
            if not named:
                allowed = f"some of {listed(found.names, pattern)}"
                raise InputError(field, pattern, allowed)
        return {family: _columns(found, named) for family, named in families.items()}

    return FeatureTable.from_arrays(
        {name: found.values(name) for name in names},
        _columns(found, features) if features else None,
        features or None,
        outcomes=outcomes or None,
        better=better,
        limits=limits({} if better else outcomes, told),
        space=space,
    )


def _named(table: "ForeignTable", pattern: str) -> list[str]:
    """The columns of a table by a name or a pattern."""
    if pattern in table.names:  # a name may look like a pattern: cost [J]
        return [pattern]
    return [name for name in table.names if fnmatch(name, pattern)]


def _columns(table: "ForeignTable", names: Iterable[str]) -> NDArray[np.float64]:
    """Columns of numbers, one at least, [n, k]."""
    return np.column_stack([table.numbers(name) for name in names])


def _declared(table: Table, names: tuple[str, ...]) -> dict[str, Declared]:
    """What the file says of parameters, by the name of each of which it says something."""
    logarithmic = table.texts("log")
    kinds = table.table("type")
    bounds = table.table("bounds")
    steps = table.table("step")
    said = {
        "log": logarithmic,
        "type": kinds.unread,
        "bounds": bounds.unread,
        "step": steps.unread,
    }
    for key, named in said.items():
        for name in named:
            if name not in names:
                allowed = f"one of the parameters {listed(names, name) or '(none)'}"
                raise InputError(f"candidates.{key}", name, allowed)
    found = {}
    for name in names:
        declared: dict[str, Any] = {"log": name in logarithmic}
        if name in bounds.unread:
            declared["bounds"] = bounds.range(name, (0, 0), -FARTHEST, FARTHEST)
        if name in kinds.unread:
            declared["kind"] = kinds.text(name, choices=KINDS)
        if name in steps.unread:
            declared["step"] = steps.number(name, low=LEAST_STEP, high=FARTHEST)
        if any(declared.values()):
            found[name] = Declared(**declared)
    return found
