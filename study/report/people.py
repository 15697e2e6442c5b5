"""What a gait is beside people: its numbers, theirs, and a plain word where they are far apart.

`people.toml` has the numbers that are shown. People are those of natural-cadence
walking on level ground: whoever walks slowly, up a ramp or with a weak muscle differs
from them.
"""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taichi_nmm.result import COLUMNS

FAR_SD = 2.0  # standard deviations from people's mean: one of 22 people is as far
STEP_RATE = "step_rate_pmin"
UNKNOWN = "-"

Known = Mapping[str, float | int | None]
"""Numbers of a walk by column, as `known_numbers` gives them; None: unknown."""


@dataclass(frozen=True)
class Quantity:
    """A number of a gait.

    Attributes:
        column: of a row of results; or `STEP_RATE`.
        label: with the unit, for readers.
        form: of the number, as Python formats it.
        people: their mean and standard deviation, in the column's unit; None: there is
            no table of them.
        low: what a gait does whose number is far below people's; "" without a table.
        high: what one does whose number is far above.
    """

    column: str
    label: str
    form: str
    people: tuple[float, float] | None = None
    low: str = ""
    high: str = ""

    def value(self, known: Known) -> float | None:
        """The number of a walk, in the column's unit."""
        if self.column != STEP_RATE:
            return known[self.column]
        duration_s = known["step_duration_mean_s"]
        return 60.0 / duration_s if duration_s else None

    def text(self, value: float | None) -> str:
        """A number for readers: an angle in degrees, a fraction in percent."""
        if value is None:
            return UNKNOWN
        if self.column.endswith("_rad"):
            value = math.degrees(value)
        if self.column.endswith("_fraction"):
            value *= 100.0
        return f"{value:{self.form}}"

    @property
    def range_text(self) -> str:
        """People's numbers, two standard deviations to both sides."""
        if self.people is None:
            return UNKNOWN
        mean, sd = self.people
        ends = mean - FAR_SD * sd, mean + FAR_SD * sd
        return " to ".join(map(self.text, ends))

    def far(self, value: float | None) -> str:
        """What is not human about a number; "": nothing, or nothing is known."""
        if value is None or self.people is None:
            return ""
        mean, sd = self.people
        if abs(value - mean) <= FAR_SD * sd:
            return ""
        return self.low if value < mean else self.high


def _read(column: str, told: Mapping[str, Any]) -> Quantity:
    people = told.get("people", COLUMNS["human"].get(column))
    return Quantity(column, **{**told, "people": people and tuple(people)})


def _table(name: str) -> dict[str, Any]:
    return tomllib.loads(Path(__file__).with_name(name).read_text(encoding="utf-8"))


QUANTITIES = tuple(
    _read(column, told) for column, told in _table("people.toml").items()
)
FURTHER = tuple(
    Quantity(column, label, form)
    for label, told in _table("walk.toml").items()
    for column, _, form in [told.partition(":")]
)
"""What is shown of a walk besides, without people; "mass_kg" is no column, but the body's."""


def not_human(known: Known) -> list[str]:
    """What no person's gait does, in words; a walk without a scored step is not judged."""
    if not known["step_count"]:
        return []
    found = []
    for each in QUANTITIES:
        value = each.value(known)
        if words := each.far(value):
            found.append(f"{words} ({each.text(value)}; people {each.range_text})")
    return found
