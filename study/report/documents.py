"""The documents of a comparison's folder, found to be of the form that a report reads."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from study.comparison.folder import EXPERIMENT_NAME, RUN_NAME
from study.experiment.experiment import COST_FUNCTIONS
from taichi_nmm.errors import InputError
from taichi_nmm.reading import is_folder, json_document

LARGEST_NUMBER = 1e15  # of seconds or trials

Check = tuple[Callable[[Any], bool], str]
"""Whether a value can be used, and what can."""


def is_number(value: Any) -> bool:
    """Whether a JSON value is a finite number of a size that floats hold well."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= LARGEST_NUMBER and math.isfinite(value)


def _of_texts(value: Any) -> bool:
    return isinstance(value, dict) and all(isinstance(text, str) for text in value.values())


OBJECT: Check = lambda value: isinstance(value, dict), "an object"
OBJECTS: Check = (
    lambda value: isinstance(value, list) and all(isinstance(each, dict) for each in value),
    "a list of objects",
)
TEXTS: Check = (
    lambda value: isinstance(value, list) and all(isinstance(each, str) for each in value),
    "a list of texts",
)
TEXT_BY_NAME: Check = _of_texts, "an object of texts"
NUMBER: Check = is_number, f"a number up to {LARGEST_NUMBER:g}"
FLAG: Check = lambda value: isinstance(value, bool), "true or false"
COST: Check = lambda value: value in tuple(COST_FUNCTIONS), " or ".join(COST_FUNCTIONS)

FORM: dict[str, dict[str, Check]] = {
    EXPERIMENT_NAME: {
        "until_walker": FLAG, "objective": OBJECT, "simulation": OBJECT, "versions": OBJECT,
        "body": OBJECT, "terrain": OBJECT, "ground": OBJECT, "searched": TEXTS,
        "stores": TEXT_BY_NAME, "objective.cost": COST, "simulation.duration_s": NUMBER,
    },
    RUN_NAME: {"sessions": OBJECTS},
}  # fmt: skip
SESSION: dict[str, Check] = {
    "machine": OBJECT, "stores": TEXT_BY_NAME, "wall_s": NUMBER, "trials": NUMBER,
}  # fmt: skip


def read_document(path: Path) -> dict[str, Any]:
    """A JSON object; empty where there is no such file.

    Raises:
        InputError: it cannot be read, or is something else than an object.
    """
    if not path.exists():
        return {}
    return json_document(path.name, path, "a readable JSON object")


def read_facts(folder: Path) -> dict[str, Any]:
    """Both documents of the folder as one; empty where there are none.

    Raises:
        InputError: one cannot be read, or a part of it is of another form; naming it.
    """
    facts: dict[str, Any] = {}
    if not is_folder(folder):
        return facts
    for name, form in FORM.items():
        document = read_document(folder / name)
        _require(document, form, name)
        facts |= without_nulls(document)
    for number, session in enumerate(facts.get("sessions", [])):
        _require(session, SESSION, f"{RUN_NAME}: sessions[{number}]")
    return facts


def without_nulls(value: Any) -> Any:
    """A JSON value without what is null in its objects: it says as much as if it were not there."""
    if isinstance(value, dict):
        return {key: without_nulls(part) for key, part in value.items() if part is not None}
    return [without_nulls(part) for part in value] if isinstance(value, list) else value


def _require(document: dict[str, Any], form: dict[str, Check], name: str) -> None:
    """Refuse parts that are there and are of another form; a dot stands for a part of a part."""
    for key, (is_right, allowed) in form.items():
        part: Any = document
        for step in key.split("."):
            part = part.get(step) if part is not None else None
        if part is not None and not is_right(part):
            raise InputError(f"{name}: {key}", part, allowed)
