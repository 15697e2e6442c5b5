"""A measured number beside what it must be, and a page of them."""

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date


@dataclass(frozen=True)
class Figure:
    """One measured number.

    Attributes:
        what: was measured.
        value: that was found.
        low: least that it must be; None: as little as it likes.
        high: most that it must be; both None: the number is only reported.
        unit: of the three.
    """

    what: str
    value: float
    low: float | None = None
    high: float | None = None
    unit: str = ""

    @property
    def holds(self) -> bool:
        """Whether the number lies within its bar."""
        enough = self.low is None or self.value >= self.low
        return enough and (self.high is None or self.value <= self.high)

    def row(self) -> str:
        """A row of a Markdown table."""
        value = f"| {self.what} | {self.value:.4g} {self.unit} "
        if self.low is None and self.high is None:
            return f"{value}| | |"
        low = "" if self.low is None else f"{self.low:g}"
        high = "" if self.high is None else f" to {self.high:g}"
        return f"{value}| {low}{high} | {'yes' if self.holds else '**no**'} |"


def page(figures: Sequence[Figure], how: str) -> str:
    """The figures as Markdown, after a line that says how, when and on what they were measured."""
    machine = f"{date.today()}, {platform.machine()}, Python {platform.python_version()}"
    lines = [f"{how}; {machine}.", "", "| what | measured | bar | holds |", "|---|---|---|---|"]
    return "\n".join([*lines, *(figure.row() for figure in figures)])
