"""A trial that nobody proposed, as an operator enters it."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from datetime import datetime
from typing import Any

from storage.inputs import checks
from study.options import is_printable

LINE = checks.that(
    lambda word: isinstance(word, str) and is_printable(word),
    "text of one line, without control characters",
)
WORDS = checks.optional(LINE)
COLUMNS = checks.by_name(checks.number())


def _is_time(word: Any) -> bool:
    with suppress(TypeError, ValueError):
        return not word or bool(datetime.fromisoformat(word))
    return False


@dataclass(frozen=True)
class Own:
    """A trial that nobody proposed.

    Attributes:
        params: its parameters, by name.
        value: in the unit of the goal.
        columns: other numbers, by the names of the bench's columns, in their units.
        note: of whoever enters it.
        failed: whether it failed.
        context: in which it was tried; None: the present one.
        operator: who tried it; None: who enters it.
        time: of the trial, ISO 8601; None: of the entry.
    """

    params: Mapping[str, Any]
    value: float
    columns: Mapping[str, float] = field(default_factory=dict)
    note: str = ""
    failed: bool = False
    context: str | None = None
    operator: str | None = None
    time: str | None = None

    def __post_init__(self) -> None:
        checks.check_fields(
            self,
            "",
            value=checks.number(),
            columns=COLUMNS,
            note=LINE,
            failed=checks.flag,
            context=WORDS,
            operator=WORDS,
            time=checks.that(_is_time, "a time such as 2026-05-04T16:30, ISO 8601"),
        )


a_trial = checks.that(
    lambda row: (
        isinstance(row, Own)
        or (
            isinstance(row, tuple)
            and 2 <= len(row) <= len(fields(Own))
            and isinstance(row[0], Mapping)
        )
    ),
    "a trial: (parameters by name, value), or an Own",
)
