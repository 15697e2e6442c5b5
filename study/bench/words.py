"""What a bench says to people, in a terminal and on its page; and names that can be typed.

A column of a bench is an option of the command (`--torque 81`), a field of the page and
a column of an export. So its name must not be one that these have already.
"""

import getpass
import os
import socket
from collections.abc import Collection, Iterator
from typing import Any

from storage.inputs.errors import InputError
from study.options import is_printable, parser_of

PROGRAM = ("taichi-nmm", "bench")
MOST_DIGITS = 9  # of the number of a trial, or of an entry, that somebody types
TIMES = {1: "once", 2: "twice"}
EXPORTED = (
    "trial",
    "number",
    "context",
    "value",
    "failed",
    "seconds",
    "operator",
    "time",
    "note",
    "why",
)
"""Columns that an export has, or may have, beside parameters and columns of the bench."""

OF_THE_SAMPLER = ("row",)  # what a trial notes beside them


def operator_here() -> str:
    """The user and the machine, or the user's number where the machine has no name for it."""
    try:
        user = getpass.getuser()
    except (
        KeyError,
        OSError,
        ImportError,
    ):  # no entry in the password file, as in a container
        user = f"uid-{os.getuid()}"
    return f"{user}@{socket.gethostname() or 'localhost'}"


def require_names(columns: Collection[str], parameters: Collection[str]) -> None:
    """Refuse names of a new bench under which a number could get into another place.

    Raises:
        InputError: naming the first of them, and what else has this name.
    """
    for field, name, why in clashes(columns, parameters):
        raise InputError(field, name, f"another name: {why}")


def clashes(
    columns: Collection[str], parameters: Collection[str]
) -> Iterator[tuple[str, str, str]]:
    """Names that something else has, or that nobody can type: field, name, and why.

    Names that differ in small and capital letters, dashes, underscores and spaces alone
    are one.
    """
    taken = {plain(name): f"an export has a column {name}" for name in EXPORTED}
    for name in parameters:
        if plain(name) in taken:
            yield "candidates.parameters", name, taken[plain(name)]
    taken |= {plain(name): f"a trial notes its {name}" for name in OF_THE_SAMPLER}
    taken |= {plain(name): f"--{name} is an option of `bench`" for name in _options()}
    taken |= {plain(name): f"{name} is a parameter" for name in parameters}
    for name in columns:
        has_a_letter_first = name.strip("- ") and name[0] not in "- "
        if not has_a_letter_first or "=" in name or not is_printable(name):
            how = "without = and with a letter first"
            yield "columns", name, f"one that can be typed as an option, {how}"
        elif plain(name) in taken:
            yield "columns", name, taken[plain(name)]
        taken[plain(name)] = f"{name} is another column"


def _options() -> list[str]:
    """Names of the options of `taichi-nmm bench`, without dashes."""
    return [flag.lstrip("-") for flag in parser_of("bench").flags]


def plain(name: str) -> str:
    """A name in the one way of writing it that capitals, dashes and spaces do not change."""
    return name.strip().casefold().replace("_", "-").replace(" ", "-")


def number_of(field: str, word: str) -> int:
    """The number of a trial, or of an entry, that somebody types.

    Raises:
        InputError: something else.
    """
    if not word.isdecimal() or len(word) > MOST_DIGITS:
        raise InputError(field, word, "a number")
    return int(word)


def times(count: int) -> str:
    """How often, in words."""
    return TIMES.get(count, f"{count} times")


def shown(value: Any) -> str:
    """A parameter as a sheet has it."""
    return f"{value:.8g}" if isinstance(value, float) else str(value)
