"""What a configuration may say of body, ground and world, as controls and as its lines.

The lines are the truth: a control changes its own key, and a line that no control has
lasts. What cannot be used is refused beside them, and the last good ones stay. Without
a line a control shows what the page's menus say, such as the world of a study.
"""

import tomllib
from base64 import b64decode
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from bokeh.models import (
    Column,
    FileInput,
    RadioButtonGroup,
    Select,
    Slider,
    TextAreaInput,
)

from storage.inputs.config import Table, laid_over, to_toml
from storage.inputs.errors import InputError
from study.explore.server import Call, Message, flow
from study.explore.words import CHOICES, Tables, in_words
from taichi_nmm.body import FACTOR_NAMES, SIDES
from taichi_nmm.result import MUSCLES
from taichi_nmm.terrain import read_ground

LEAST_PX = 170  # of a control
STEPS = 200  # of a slider
WHOLE = {  # tables with all of their keys, or none: by the key that tells
    "world.prosthesis": "side",
    "world.push": "force_n",
    "world.slip": "duration_s",
}
EVERY = {  # names of sliders that are alike, by the table that they are in
    "world.muscles": [f"{muscle}_{side}" for muscle in MUSCLES for side in SIDES],
    "body.mass": FACTOR_NAMES,
    "body.inertia": FACTOR_NAMES,
}


def with_value(tables: Tables, path: list[str], value: Any) -> Tables:
    """The tables with another value at a path; None takes it away, and tables that it empties."""
    first, *rest = path
    inner = with_value(tables.get(first, {}), rest, value) if rest else value
    if inner is None or inner == {}:
        return {key: tables[key] for key in tables if key != first}
    return {**tables, first: inner}


def shown_at(tables: Tables, path: str) -> Any:
    """What a control shows of a path with dots: of a range the first end; None: nothing."""
    found: Any = tables
    for name in path.split("."):
        found = found.get(name) if isinstance(found, dict) else None
    return found[0] if isinstance(found, list) else found


def read_lines(text: str) -> Tables:
    """The tables of lines of TOML.

    Raises:
        InputError: the lines are no TOML.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        allowed = "lines of TOML, such as world.muscles.SOL_left = 0.5"
        raise InputError("what if", str(error), allowed) from None


def read_file(name: str, content: bytes) -> Tables:
    """A table `terrain` of a file's content, with its heights.

    Raises:
        InputError: no table of heights.
    """
    with TemporaryDirectory() as folder:
        file = Path(folder) / Path(name).name
        file.write_bytes(content)
        try:
            table = Table({"kind": "file", "file": file.name}, "terrain", file.parent)
            return {"kind": "file", **read_ground(table).options}
        except InputError as error:
            raise InputError("ground", name, error.allowed) from None


class WhatIf:
    """Controls in groups, and their lines.

    `changed` is called once `tables` are others, and refuses them with an `InputError`;
    `ground` with the name and the table of a ground of one's own.
    """

    def __init__(self, changed: Call, ground: Callable[[str, Tables], None]) -> None:
        self.tables: Tables = {}
        self._under: Tables = {}
        self._changed = changed
        self._ground = ground
        self._still = False  # while the page, not a person, moves the controls
        self._refusal = Message("what-if-message")
        self._controls: Tables = {}
        groups = {
            title: flow(*self._group(parts), least_px=LEAST_PX)
            for title, parts in CHOICES["what_if"].items()
        }
        self._file = FileInput(
            title="a ground of your own, lines x_m,height_m",
            accept=".csv,.txt,.gz",
            name="ground-file",
        )
        read = self._refusal.safely(self._read_file)
        # It comes last, and is empty once the file has been read.
        self._file.on_change("filename", lambda attr, old, new: new and read())
        self._lines = TextAreaInput(
            title="the same as lines of a configuration, which may be edited",
            rows=5,
            cols=60,
            name="lines",
        )
        self._refusal.watch(self._lines, "value", self._read_lines)
        undo = self._refusal.button("none of this", lambda: self.take({}), name="undo")
        which = RadioButtonGroup(labels=list(groups), active=0, name="what")
        shown = Column(*groups.values())
        which.on_change("active", lambda attr, old, new: turn(shown, new))
        turn(shown, 0)
        own = flow(self._file), self._lines, self._refusal.layout, flow(undo)
        self.layout = Column(which, shown, *own)

    def _group(self, parts: list[Tables]) -> list[Any]:
        """The controls of a group, of which some are alike."""
        found = []
        for part in parts:
            under = part["path"]
            paths = [f"{under}.{name}" for name in EVERY.get(under, ())] or [under]
            for path in paths:
                title = part.get("title") or in_words(path.rpartition(".")[2])[0]
                control = self._controls[path] = control_of(part, title, path)
                self._refusal.watch(control, "value", partial(self._set, path))
                found.append(control)
        return found

    def _set(self, path: str) -> None:
        if self._still:
            return
        control = self._controls[path]
        usual = shown_at(self._under, path)
        if usual is None:
            usual = control.tags[0]
        value = None if control.value == usual else control.value
        table = path.rpartition(".")[0]
        if table in WHOLE:
            path = table
            tells = self._controls[f"{table}.{WHOLE[table]}"]
            value = None
            if tells.value != tells.tags[0] or shown_at(self._under, table):
                value = {
                    each.removeprefix(f"{table}."): other.value
                    for each, other in self._controls.items()
                    if each.startswith(f"{table}.")
                }
        elif "pair" in control.tags and value is not None:
            value = [value, value]
        self.take(with_value(self.tables, path.split("."), value))

    def _read_lines(self) -> None:
        if not self._still:
            self.take(read_lines(self._lines.value))

    def _read_file(self) -> None:
        name, content = self._file.filename, b64decode(self._file.value)
        self._refusal.tell("")
        self._file.clear()  # so that the same file can be read again
        self._ground(name, read_file(name, content))

    def lie_on(self, under: Tables) -> None:
        """Show what the menus say of body and world where no line says anything else."""
        if under != self._under:
            self._under = under
            self._show(self._lines.value)

    def take(self, tables: Tables) -> None:
        """Take other tables, unless they are refused."""
        before, self.tables = self.tables, tables
        self._refusal.tell("")
        try:
            self._changed()
            self._show(to_toml(tables).strip())
        except InputError:
            self.tables = before
            self._show(self._lines.value)
            raise

    def _show(self, lines: str) -> None:
        """Move the controls to what the tables have, and what they lie on."""
        self._still = True
        tables = laid_over(self._under, self.tables)
        for path, control in self._controls.items():
            found = shown_at(tables, path)
            table, _, name = path.rpartition(".")
            if found is None and WHOLE.get(table, name) == name:
                found = control.tags[0]
            if found is not None:  # else a number of a table that is not there
                control.value = found
        self._lines.value = lines
        self._still = False


def control_of(part: Tables, title: str, path: str) -> Any:
    """A slider or a menu; its first tag is the value that stands for no line."""
    usual = part["usual"]
    if "options" in part:
        return Select(
            title=title, options=part["options"], value=usual, name=path, tags=[usual]
        )
    low, high = part["ends"]
    return Slider(
        title=title,
        start=low,
        end=high,
        step=(high - low) / STEPS,
        format="0[.]0[000]",
        value=usual,
        name=path,
        tags=[usual, "pair"] if part.get("pair") else [usual],
    )


def turn(shown: Column, active: int) -> None:
    """Show one group alone."""
    for place, group in enumerate(shown.children):
        group.visible = place == active
