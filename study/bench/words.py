"""What a bench says to people, in a terminal and on its page; and names that can be typed.

A column of a bench is an option of the command (`--torque 81`), a field of the page and
a column of an export. So its name must not be one that these have already.
"""

import getpass
import json
import os
import shlex
import socket
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from storage.inputs.errors import InputError
from study.bench.journal import Trial
from study.options import COMMANDS, DECLARED, is_printable

PROGRAM = ("taichi-nmm", "bench")
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
        if (
            not name.strip("- ")
            or "=" in name
            or name[0] in "- "
            or not is_printable(name)
        ):
            why = (
                "one that can be typed as an option, without = and with a letter first"
            )
            yield "columns", name, why
        elif plain(name) in taken:
            yield "columns", name, taken[plain(name)]
        taken[plain(name)] = f"{name} is another column"


def _options() -> list[str]:
    """Names of the options of `taichi-nmm bench`, without dashes."""
    declared = [
        each
        for option in COMMANDS["bench"]["options"]
        for each in (
            DECLARED["shared"][option["like"]] if "like" in option else [option]
        )
    ]
    return [flag.lstrip("-") for option in declared for flag in option["flags"]] + [
        "help",
        "h",
    ]


def plain(name: str) -> str:
    """A name in the one way of writing it that capitals, dashes and spaces do not change."""
    return name.strip().casefold().replace("_", "-").replace(" ", "-")


def sheet(
    trial: Trial,
    *,
    name: str,
    columns: Collection[str],
    parameters: Collection[str],
    remark: str = "",
    file: Path | None = None,
) -> str:
    """A trial to run, for paper, with the command line that enters its result.

    Args:
        trial: that runs next.
        name: of the bench.
        columns: names of its other numbers.
        parameters: names of its parameters.
        remark: what else is to be known about the trial; "": nothing.
        file: of the bench, if the command line must name it.
    """
    head = " | ".join(filter(None, [f"trial {trial.number}", name, trial.context]))
    if trial.aborted:
        head += f" (again: broken off {times(trial.aborted)})"
    width = max(map(len, trial.params))
    values = [
        f"  {name:<{width}}  {shown(value)}" for name, value in trial.params.items()
    ]
    untyped = {
        name for field, name, _ in clashes(columns, parameters) if field == "columns"
    }
    words = [*PROGRAM, "record", str(trial.number)]
    if file is not None:
        words += ["--bench", str(file)]
    enter = shlex.join(words)
    for option in ("value", *(name for name in columns if name not in untyped)):
        enter += f" {shlex.quote(f'--{option}')} ..."
    lines = [head, *values, trial.why, remark, f"enter: {enter}"]
    if untyped:
        # A bench of 0.3.0: its options of these names are something else.
        lines.append(
            f"on the page of `bench serve` alone: {', '.join(sorted(untyped))}"
        )
    return "\n".join([*filter(None, lines), ""])


def times(count: int) -> str:
    """How often, in words."""
    return TIMES.get(count, f"{count} times")


def shown(value: Any) -> str:
    """A parameter as a sheet has it."""
    return f"{value:.8g}" if isinstance(value, float) else str(value)


def horizon(runs_s: Collection[float], duration_s: float) -> str:
    """A sentence on runs of a store that last no trial, whose costs are known of; "": all do.

    Args:
        runs_s: lengths of the runs.
        duration_s: of a whole trial; infinite where it has no end.
    """
    others = sorted({length for length in runs_s if length != duration_s})
    if not others:
        return ""
    said = " and ".join(f"{length:g}" for length in others)
    trial = f", a trial {duration_s:g} s" if duration_s < float("inf") else ""
    return f"Simulated runs last {said} s{trial}: what is simulated is the cost of such a run."


def json_line(document: Any, encoding: str | None) -> str:
    """A document as JSON in one line, with the letters that a terminal's encoding has."""
    text = json.dumps(document, ensure_ascii=False)
    try:
        text.encode(encoding or "ascii")
    except UnicodeEncodeError:
        return json.dumps(document)
    return text
