"""The options of every command, in a file that is quick to load: `taichi-nmm COMMAND --help`.

`options.toml` has them, and all of a command's description but its first line, which is
that of the docstring of its file in `study/commands`. Whole numbers are checked against
the bounds of configurations. An option that cannot be used is an `InputError`: one
line, as for all other input.
"""

import argparse
import ast
import os
import re
import sys
import tomllib
import unicodedata
from collections.abc import Collection, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from storage.inputs import typed
from storage.inputs.errors import InputError, listed, one_line, shortened
from taichi_nmm.settings import ENGINES

PROGRAM = "taichi-nmm"
HERE = Path(__file__).resolve().parent
INSTALLED = HERE / "configs"  # the place of the configurations in a wheel
CONFIGS = INSTALLED if INSTALLED.is_dir() else HERE.parent / "configs"

MOST_WORKERS = 1024  # processes; each takes hundreds of MB
LARGEST_SEED = 2**63 - 1  # as in configurations
LONGEST_NAME_BYTES = 255  # NAME_MAX of Linux and of macOS
LONGEST_PATH_BYTES = 1023  # PATH_MAX of macOS without its end; Linux has 4095
# The begin of a number, which is no option; also of -1e5, -0,5 and -inf.
NEGATIVE = re.compile(r"-([.,]?\d|inf|nan)")
# As argparse begins a line, with all names.
ARGUMENT = re.compile(r"\Aargument --([\w-]+)\S*: ")
# Unicode's control characters, half characters, line ends.
UNPRINTABLE = ("Cc", "Cs", "Zl", "Zp")
OTHERS = "--COLUMN"  # stands for options of names that a file gives
BOTH_ENGINES = "both"
WALKED_ENGINES = (*ENGINES, BOTH_ENGINES)

Declared = Mapping[str, Any]
"""An option, or a command, as `options.toml` has it."""

DECLARED = tomllib.loads(HERE.joinpath("options.toml").read_text(encoding="utf-8"))
COMMANDS: dict[str, Declared] = DECLARED["commands"]


def looked_up(place: str) -> Any:
    """The value of "module:NAME"."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


class _Once(argparse.Namespace):
    """Options of which each is given once: of two numbers that are typed, none may vanish."""

    def __setattr__(self, name: str, value: Any) -> None:
        before = getattr(self, name, None)
        if before is not None:
            _refuse_second(name.replace("_", "-"), value, before)
        super().__setattr__(name, value)


class Options(argparse.ArgumentParser):
    """The parser of the command in a file, which is called `prog`; by default, as this process was.

    The file's docstring is the description, and `more` follows. It is read from the
    source, since `python -OO` drops docstrings.
    """

    def __init__(
        self, file: str | Path, prog: str | None = None, more: str = ""
    ) -> None:
        raw = argparse.RawDescriptionHelpFormatter
        about = f"{documentation(Path(file))}\n\n{more}".strip()
        super().__init__(prog, description=about, formatter_class=raw)
        self.bounds: dict[str, tuple[int, int | str]] = {}  # of whole numbers
        self.takes_others = False  # options of names that a file gives, as `others`
        self._negative_number_matcher = NEGATIVE

    def parse_args(self, words: Sequence[str] | None = None) -> argparse.Namespace:  # type: ignore[override]
        """The options of a command line; by default that of this process.

        `given` of them has those that may be missing and are not: `require_used`
        refuses some.

        Raises:
            InputError: a number out of its bounds, a word that is not text of one line,
                a path that no file can have, or an option that is given twice where it
                must not be.
        """
        words = list(sys.argv[1:] if words is None else words)
        others = dict[str, str]()
        if self.takes_others:
            words, others = self._others(words)
        for word in words:
            flag, _, value = word.partition("=")
            if flag.startswith("--") and value == "--":  # argparse makes a list of it
                raise InputError(flag.removeprefix("--"), value, "a value")
        # Options of a file's names enter numbers; of others the last one counts, as in
        # shells.
        kind = _Once if self.takes_others else argparse.Namespace
        nothing = kind(**dict.fromkeys(action.dest for action in self._actions))
        given = {
            name: self._checked(name, value)
            for name, value in vars(
                super().parse_intermixed_args(words, nothing)
            ).items()
            if value is not None
        }
        found = argparse.Namespace(others=others, given={})
        for action in self._actions:
            name, default = action.dest, action.default
            if isinstance(default, str):
                default = self._get_value(action, default)
            setattr(found, name, given.get(name, default))
            if name in given and action.type is config_path:
                _check_config(name, given[name])
            if name in given and not action.required:
                found.given[name] = given[name]
        return found

    def _checked(self, name: str, value: Any) -> Any:
        """What was given for an option; text is of one line, a whole number within bounds."""
        field = name.replace("_", "-")
        for word in value if isinstance(value, list) else [value]:
            _check_word(field, word)
        if name in self.bounds:
            return _whole(field, value, *self.bounds[name])
        return value

    def _others(self, words: Sequence[str]) -> tuple[list[str], dict[str, str]]:
        """A command line without the options of other names; and their values by name.

        A value is the word that follows, or what stands behind an equals sign.
        """
        rest = []
        found = dict[str, str]()
        remaining = iter(words)
        for word in remaining:
            flag, equals, after = word.partition("=")
            name = flag.removeprefix("--")
            is_other = flag.startswith("--") and name and flag not in self.flags
            value = after if equals or not is_other else next(remaining, None)
            if not is_other or value is None:
                rest.append(word)
                continue
            if name in found:
                _refuse_second(name, value, found[name])
            found[name] = value
        return rest, found

    @property
    def flags(self) -> Collection[str]:
        """All ways to write an option: --help, -h, ..."""
        return self._option_string_actions

    def error(self, message: str) -> NoReturn:
        """One line, as for all bad input; one of ours names the option as all fields are named."""
        if "cannot be used; allowed: " in message:
            message = ARGUMENT.sub(r"\1: ", message)
        self.exit(2, f"error: {one_line(shortened(message))}\n")

    def whole(self, flag: str, low: int, high: int | str, **options: Any) -> None:
        """A whole number from `low` to `high`, or "module:NAME" for it; others are argparse's."""
        added = self.add_argument(flag, **({"metavar": "N"} | options))
        self.bounds[added.dest] = low, high

    def path(self, name: str, help: str, metavar: str = "DIR", **options: Any) -> None:
        """A folder or a file; further options are argparse's."""
        self.add_argument(name, metavar=metavar, help=help, type=Path, **options)

    def declare(self, option: Declared) -> None:
        """Add an option, or options, as the file declares them."""
        words = dict(option)
        if "like" in words:
            for each in DECLARED["shared"][words.pop("like")]:
                self.declare(each | words)
            return
        flags = words.pop("flags")
        stores = words.pop("stores", False)
        if "whole" in words:
            self.whole(*flags, *words.pop("whole"), **words)
            return
        if "choices" in words:
            words["choices"] = looked_up(words["choices"])
        kind = words.get("type")
        if kind is not None:
            words["type"] = TYPES[kind]
        self.add_argument(*flags, **words)
        if kind == "config":
            what = "list the shipped configurations and exit"
            self.add_argument(
                "--list-configs", action=_ListConfigs, nargs=0, const=stores, help=what
            )


def parser_of(name: str) -> Options:
    """The parser of a command; `parser_of(name).format_help()` is its help.

    Raises:
        InputError: no such command; the line lists all.
    """
    if name not in COMMANDS:
        raise InputError("command", name, listed(COMMANDS, name))
    command = COMMANDS[name]
    parser = Options(file_of(name), f"{PROGRAM} {name}", command["about"])
    parser.takes_others = command.get("others", False)
    for option in command["options"]:
        parser.declare(option)
    return parser


def require_used(args: argparse.Namespace, used: Sequence[str], by: str) -> None:
    """Refuse options that were given and that nothing would come of.

    Args:
        args: of `Options.parse_args`.
        used: the options that count, as a person writes them: `--seconds`; `WHAT` for
            one without a name; `--COLUMN` for those of names that a file gives.
        by: what uses these, such as an action of the command.

    Raises:
        InputError: naming the first option that is not among them.
    """
    given = {name.replace("_", "-"): value for name, value in args.given.items()}
    known = {each.lstrip("-").lower() for each in used}
    if OTHERS in used:
        known |= args.others.keys()
    for name, value in (given | args.others).items():
        if name not in known:
            shown = str(value) if isinstance(value, Path) else value
            raise InputError(
                name, shown, f"{by} takes {' '.join(used) or 'no options'}"
            )


def _refuse_second(name: str, value: object, before: object) -> NoReturn:
    raise InputError(name, str(value), f"one value; {str(before)!r} was given before")


def overview() -> str:
    """A line for each command."""
    width = max(map(len, COMMANDS))
    abouts = {name: documentation(file_of(name)).splitlines()[0] for name in COMMANDS}
    lines = [f"  {name:<{width}}  {about}" for name, about in abouts.items()]
    usage = f"usage: {PROGRAM} COMMAND [OPTION ...]   ({PROGRAM} COMMAND --help)"
    return "\n".join([usage, "", *lines])


def file_of(command: str) -> Path:
    """The file of a command."""
    return HERE / "commands" / f"{command.replace('-', '_')}.py"


def documentation(file: Path) -> str:
    """The docstring of a Python file, which is not imported."""
    return ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""


def config_path(name: str | Path) -> Path:
    """The shipped configuration of this name; or else the file itself.

    A name is a word, such as rough8; anything with a folder or a suffix is a file. The
    name of a variant, such as ramp-up-gentle, stands for a file that
    `storage.inputs.config.read_toml` finds in ramp-up.toml.
    """
    word = str(name)
    # no file is looked up by a name that was given
    for shipped in CONFIGS.glob("*.toml"):
        if word == shipped.stem:
            return shipped
        if word.startswith(f"{shipped.stem}-") and word in _described(shipped):
            return shipped.with_stem(word)
    return Path(name)


def _check_config(field: str, path: Path) -> None:
    """Refuse a word that is no name of a shipped configuration, where no file has it either."""
    if path.suffix or len(path.parts) > 1 or path.exists():
        return
    names = listed([*shipped_configs(True), *shipped_configs(False)], path)
    raise InputError(field, str(path), f"one of {names}; or a TOML file")


def _number(word: str) -> float:
    """The number that was typed, with a decimal point or a comma."""
    try:
        return typed.number("", word)
    except InputError as error:
        refused = f"{word!r} cannot be used; allowed: {error.allowed}"
        raise argparse.ArgumentTypeError(refused) from None


TYPES = {"int": int, "float": _number, "path": Path, "config": config_path}


def shipped_configs(stores: bool) -> dict[str, str]:
    """A line on every shipped configuration of stores, or of experiments, by its name."""
    found: dict[str, str] = {}
    for file in sorted(CONFIGS.glob("*.toml")):
        if ("samples" in tomllib.loads(file.read_text(encoding="utf-8"))) == stores:
            found |= _described(file)
    return found


def _described(file: Path) -> dict[str, str]:
    """A line on a shipped configuration and on each of its variants, by name."""
    text = file.read_text(encoding="utf-8")
    tables = tomllib.loads(text)
    first = text.partition("\n")[0].lstrip("# ")
    variants = {
        f"{file.stem}-{name}": table["about"]
        for name, table in tables.get("variants", {}).items()
    }
    return variants if tables.get("only_variants") else {file.stem: first} | variants


def _check_word(field: str, word: object) -> None:
    """Refuse a word of several lines, or of no encoding; and a path that is too long."""
    if not isinstance(word, str | Path):
        return
    if not is_printable(str(word)):
        raise InputError(
            field, str(word), "text of one line, without control characters"
        )
    if isinstance(word, Path):
        longest = max((len(os.fsencode(part)) for part in word.parts), default=0)
        if longest > LONGEST_NAME_BYTES or len(os.fsencode(word)) > LONGEST_PATH_BYTES:
            allowed = f"a path of at most {LONGEST_PATH_BYTES} bytes, {LONGEST_NAME_BYTES} a name"
            raise InputError(field, str(word), allowed)


def is_printable(text: str) -> bool:
    """Whether a text is of one line, without control characters."""
    return not any(unicodedata.category(character) in UNPRINTABLE for character in text)


def _whole(field: str, text: str, low: int, high: int | str) -> int:
    """The whole number within bounds that a text is."""
    most: int = looked_up(high) if isinstance(high, str) else high
    try:
        value = int(text)
    except ValueError:  # no number, or one of thousands of digits
        value = None
    if value is None or not low <= value <= most:
        allowed = f"a whole number from {low} to {most}"
        raise InputError(field, text if value is None else value, allowed)
    return value


class _ListConfigs(argparse.Action):
    """Prints the shipped configurations and leaves."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """A line each."""
        listed = shipped_configs(self.const)
        width = max(map(len, listed))
        print(*(f"{name:<{width}}  {line}" for name, line in listed.items()), sep="\n")
        parser.exit()
