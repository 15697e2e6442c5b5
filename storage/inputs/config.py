"""Configurations: TOML read strictly, so that no misspelt key is ever ignored."""

import json
import math
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

from storage.inputs import checks
from storage.inputs.checks import R
from storage.inputs.errors import InputError, listed
from storage.inputs.reading import is_file, toml_document

REQUIRED = object()
READABLE = "a readable TOML file"
MOST_MISTAKES = 20  # of a file, that are shown at once


class Table:
    """One table of a configuration; every read names the key, and `done` refuses other keys."""

    def __init__(
        self,
        data: dict[str, Any],
        name: str = "",
        folder: Path = Path(),
        mistakes: Collection[str] = (),
    ) -> None:
        self.folder = folder  # that names of files start from
        # fields whose values were taken out: see `read_whole`
        self._mistakes = mistakes
        self._data = dict(data)
        self._name = name
        # Keys in the order in which they were asked for, each once.
        self._known: dict[str, None] = {}
        # else a mistaken word, such as a kind, tells which there are
        self._has_all_keys = True
        self._tables: dict[str, Table] = {}

    def path(self, key: str) -> str:
        """The key with the tables it lies in, as errors name it."""
        return f"{self._name}.{key}" if self._name else key

    def has(self, key: str) -> bool:
        """Whether a key that may be missing is there, and not read yet; errors name it then."""
        self._known[key] = None
        return key in self._data

    def number(
        self,
        key: str,
        default: Any = REQUIRED,
        low: float = -math.inf,
        high: float = math.inf,
    ) -> float:
        """A finite number within [low, high]."""
        check = checks.number(low, high, f"a number from {low:g} to {high:g}")
        return float(self._read(key, default, check, min(max(1.0, low), high)))

    def range(
        self, key: str, default: tuple[float, float], low: float, high: float
    ) -> tuple[float, float]:
        """Two finite numbers within [low, high], the second no less than the first."""
        value = self._take(key, default)
        try:
            lowest, highest = checks.interval(low, high)(self.path(key), value)
        except InputError:
            allowed = (
                f"[lowest, highest], two numbers from {low:g} to {high:g} in this order"
            )
            raise InputError(self.path(key), value, allowed) from None
        return float(lowest), float(highest)

    def integer(
        self, key: str, default: Any = REQUIRED, low: int = 0, high: int = 2**63 - 1
    ) -> int:
        """A whole number within [low, high]."""
        return int(
            self._read(key, default, checks.whole(low, high), min(max(1, low), high))
        )

    def text(
        self, key: str, default: Any = REQUIRED, choices: tuple[str, ...] = ()
    ) -> str:
        """A string, one of `choices` where they are given."""
        check = checks.word(*choices) if choices else checks.text
        self._has_all_keys &= not (choices and self.mistaken(key))
        return str(self._read(key, default, check, choices[0] if choices else ""))

    def boolean(self, key: str, default: Any = REQUIRED) -> bool:
        """true or false."""
        true_or_false = checks.that(
            lambda value: isinstance(value, bool), "true or false"
        )
        return bool(self._read(key, default, true_or_false))

    def texts(self, key: str, choices: tuple[str, ...] = ()) -> tuple[str, ...]:
        """An array of strings, each once, of `choices` where they are given; empty if missing."""
        values = self._take(key, [])
        allowed = f"a list of {', '.join(choices) or 'names'}, each once"
        if not isinstance(values, list) or len({str(value) for value in values}) != len(
            values
        ):
            raise InputError(self.path(key), values, allowed)
        for value in values:
            if not isinstance(value, str) or (choices and value not in choices):
                raise InputError(self.path(key), value, allowed)
        return tuple(values)

    def table(self, key: str) -> "Table":
        """A sub-table, the same one at every call; empty where it is missing."""
        if key not in self._tables:
            is_table = checks.that(lambda value: isinstance(value, dict), "a table")
            value = self._read(key, {}, is_table)
            self._tables[key] = Table(
                value, self.path(key), self.folder, self._mistakes
            )
        return self._tables[key]

    @property
    def unread(self) -> dict[str, Any]:
        """The values that nothing has read yet, by key, as they are written."""
        return dict(self._data)

    def done(self) -> None:
        """Refuse keys that nothing has read."""
        for key, value in self._data.items() if self._has_all_keys else ():
            raise InputError(
                self.path(key), value, f"only the keys {listed(self._known, key)}"
            )

    def mistaken(self, key: str = "") -> bool:
        """Whether a mistake was found at a key or below it; "": anywhere in this table."""
        here = self.path(key) if key else self._name
        return any(f"{field}.".startswith(f"{here}.") for field in self._mistakes)

    def _read(
        self, key: str, default: Any, check: checks.Check, stand_in: Any = False
    ) -> Any:
        """A value that passes; `stand_in` for a required one that was taken out."""
        if default is REQUIRED and self.path(key) in self._mistakes:
            default = stand_in
        return check(self.path(key), self._take(key, default))

    def _take(self, key: str, default: Any) -> Any:
        self._known[key] = None
        if key in self._data:
            return self._data.pop(key)
        if default is REQUIRED:
            raise InputError(self.path(key), "missing", "a value: the key is required")
        return default


def read_whole(table: Table, reader: Callable[[Table], R]) -> R:
    """What a reader makes of a whole configuration.

    After an error it reads again, without the value that the error names. This ends
    when nothing is left to refuse, or when an error comes again.

    Raises:
        InputError: the mistakes, a line each.
    """
    errors, data = dict[str, InputError](), table.unread
    while len(errors) < MOST_MISTAKES:
        try:
            found = reader(Table(data, folder=table.folder, mistakes=errors))
        except InputError as error:
            if errors.setdefault(error.field, error) is not error:
                break
            data = _without(data, error.field.split("."))
        else:
            if not errors:
                return found
            break
    # An error of a table of which a value was taken out follows from that.
    shown = [
        e
        for e in errors.values()
        if not any(f.startswith(f"{e.field}.") for f in errors)
    ]
    shown[0].args = ("\n".join(map(str, shown)),)
    raise shown[0]


def _without(data: dict[str, Any], path: list[str]) -> dict[str, Any]:
    """Tables less the value at a path, where it is there."""
    first, *rest = path
    if rest and isinstance(data.get(first), dict):
        return data | {first: _without(data[first], rest)}
    return data if rest else {key: value for key, value in data.items() if key != first}


def read_toml(path: str | Path, over: Mapping[str, Any] | None = None) -> Table:
    """The top table of a TOML file, or of a variant of it; tables `over` lie over that.

    FILE-VARIANT.toml, if there is no such file, is FILE.toml with its table
    [variants.VARIANT] laid over it (`laid_over`); `about` in that table is a line for
    readers, and `name` is followed by the variant's. A file with `only_variants = true`
    is used as one of its variants. A table with `like = "other"` is laid over the table
    `other` beside it.

    Raises:
        InputError: no such file, one that cannot be read, or no such variant.
    """
    file, name = _file_and_variant(Path(path))
    data = completed(toml_document("config", file, READABLE))
    variants = data.pop("variants", {})
    if not isinstance(variants, dict) or not all(
        isinstance(v, dict) for v in variants.values()
    ):
        raise InputError("variants", variants, "tables by name")
    allowed = f"a variant of {file}: {listed(variants, name)}"
    if data.pop("only_variants", False) and not name:
        raise InputError("config", str(path), allowed)
    if name and name not in variants:
        if not variants:
            toml_document("config", path, READABLE)  # raises: no such file
        raise InputError("config", str(path), allowed)
    if name:
        data = laid_over(data, variants[name])
        data.pop("about", None)
        if isinstance(data.get("name"), str):
            data["name"] += f"-{name}"
    return Table(laid_over(data, dict(over or {})), folder=file.parent)


def to_toml(tables: dict[str, Any], name: str = "") -> str:
    """Plain values as TOML, in which they look as in JSON; tables come last."""
    lines, inner = [], []
    for key, value in tables.items():
        if isinstance(value, dict):
            inner.append(to_toml(value, f"{name}.{key}".lstrip(".")))
        else:
            lines.append(f"{key} = {json.dumps(value)}\n")
    if name and lines:
        lines.insert(0, f"[{name}]\n")
    return "\n".join(filter(None, ["".join(lines), *inner]))


def completed(data: dict[str, Any]) -> dict[str, Any]:
    """The tables, each laid over the one that it is `like`."""
    done: dict[str, Any] = {}

    def complete(key: str, asked_by: tuple[str, ...]) -> Any:
        if key in done or not isinstance(data[key], dict):
            return done.setdefault(key, data[key])
        table = dict(data[key])
        if "like" in table:
            other, beside = (
                table.pop("like"),
                [name for name in data if name not in asked_by],
            )
            if other not in beside or not isinstance(data[other], dict):
                raise InputError(
                    f"{key}.like", other, "a table beside it that is not like it"
                )
            table = laid_over(complete(other, (*asked_by, other)), table)
        done[key] = completed(table)
        return done[key]

    return {key: complete(key, (key,)) for key in data}


def laid_over(under: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """The keys of `over`, and those of `under` that it leaves out; of tables in both, likewise.

    A table of another `kind` (a ramp over stairs) takes nothing from `under`.
    """
    if "kind" in over and over["kind"] != under.get("kind"):
        return over
    merged = under | over
    for key in under.keys() & over.keys():
        if isinstance(under[key], dict) and isinstance(over[key], dict):
            merged[key] = laid_over(under[key], over[key])
    return merged


def _file_and_variant(path: Path) -> tuple[Path, str]:
    """The file that is there, and the name of its variant; "" for the file itself."""
    if not is_file(path):
        for cut in reversed(range(1, len(path.stem))):
            # of any text: it may be ".."
            base = path.parent / (path.stem[:cut] + path.suffix)
            if path.stem[cut] == "-" and is_file(base):
                return base, path.stem[cut + 1 :]
    return path, ""
