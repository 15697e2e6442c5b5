"""Limits of a trial's other numbers, falls, and what a proposal may risk of either.

A column of a bench has limits; a trial that was entered as failed has fallen. What a
proposal may risk is a chance by the name of the column, or "fall". Worlds tell of both:
a row of a file falls in a world where it costs no less than a failure at the end, a row
of a store where its run ended early; and a column names what the worlds say of it.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from storage.inputs.config import Table
from storage.inputs.errors import InputError, listed

Floats = NDArray[np.float64]

ByFamily = dict[str, Floats]
"""Numbers of rows in the worlds of each family, [n, w]."""

FALL = "fall"


@dataclass(frozen=True)
class Column:
    """Another number of a trial, and the limits that it must keep.

    Attributes:
        unit: of the number, in words.
        least: that is allowed, in this unit; minus infinity: there is no such limit.
        most: that is allowed; infinity: there is no such limit.
        worlds: columns of the candidates that have it in simulated worlds, or patterns,
            each a family; none: worlds do not tell of it.
    """

    unit: str
    least: float
    most: float
    worlds: tuple[str, ...]

    def limits(self, name: str, value: Floats | float) -> dict[str, Floats | float]:
        """What is above zero where a limit is broken, by name."""
        found = dict[str, Floats | float]()
        if self.least > -math.inf:
            found[f"{name} at least"] = self.least - value
        if self.most < math.inf:
            found[f"{name} at most"] = value - self.most
        return found


def read_column(table: Table) -> Column:
    """A column of a bench's file."""
    column = Column(
        unit=table.text("unit", ""),
        least=table.number("least") if table.has("least") else -math.inf,
        most=table.number("most") if table.has("most") else math.inf,
        worlds=table.texts("worlds"),
    )
    table.done()
    return column


def require_limits(columns: Mapping[str, Column]) -> None:
    """Refuse limits that no number keeps."""
    for name, column in columns.items():
        if column.least > column.most:
            allowed = f"a number up to columns.{name}.most, {column.most:g}"
            raise InputError(f"columns.{name}.least", column.least, allowed)


def read_allowed(
    table: Table, columns: Mapping[str, Column], *, knows_falls: bool
) -> dict[str, float]:
    """What a proposal may risk, by the name of a column or "fall".

    Args:
        table: [limit] of a bench's file.
        columns: of the bench.
        knows_falls: whether the file says what failures are worth.

    Raises:
        InputError: a chance of 0 or 1, a name without a limit, or falls where nothing
            says what a fall is.
    """
    limited = [name for name, column in columns.items() if column.limits("", 0.0)]
    found = dict[str, float]()
    for name in table.unread:
        field = table.path(name)
        risk = table.number(name)
        if not 0.0 < risk < 1.0:
            raise InputError(field, risk, "a chance above 0 and below 1")
        if name == FALL and name in columns:
            raise InputError(field, risk, "none beside a column of this name")
        if name == FALL and not knows_falls:
            allowed = (
                "none without failed_at_once, failed_at_end and duration_s in [goal]"
            )
            raise InputError(field, risk, f"{allowed}: they say what a fall is")
        if name not in (FALL, *limited):
            known = listed([FALL, *limited], name)
            raise InputError(
                field, risk, f"the chance of {known}: no other column has a limit"
            )
        found[name] = risk
    return found


def by_limit(
    allowed: Mapping[str, float], columns: Mapping[str, Column]
) -> dict[str, float]:
    """The same by the limits of the trials: a column's two limits share its chance."""
    found = dict[str, float]()
    for name, risk in allowed.items():
        limits = [FALL] if name == FALL else columns[name].limits(name, 0.0)
        found |= {limit: risk / len(limits) for limit in limits}
    return found


def named(limit: str) -> str:
    """The column of a limit, or "fall"."""
    return limit.removesuffix(" at least").removesuffix(" at most")


def in_worlds(
    columns: Mapping[str, Column], told: Callable[[str, tuple[str, ...]], ByFamily]
) -> dict[str, ByFamily]:
    """What is above zero where a row breaks a limit in a world, by its name.

    Args:
        columns: of the bench.
        told: what worlds tell of a column, by the key that names it and what it names.
    """
    found = dict[str, ByFamily]()
    for name, column in columns.items():
        if not column.worlds:
            continue
        families = told(f"columns.{name}.worlds", column.worlds)
        for limit in column.limits(name, 0.0):
            found[limit] = {
                family: np.asarray(column.limits(name, values)[limit])
                for family, values in families.items()
            }
    return found
