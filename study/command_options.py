"""Options of commands: whole numbers within the bounds of configurations, configurations by name.

What is wrong with one is an `InputError`, which is one line, as for every other input. Words that
no command can do anything with are refused here, for all of them.
"""

import argparse
import ast
import os
import sys
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from storage.cluster.asked import Cluster
from study.shipped import config_path, shipped_configs
from taichi_nmm.errors import InputError, one_line, shortened

MOST_WORKERS = 1024  # processes; each takes hundreds of MB
LARGEST_SEED = 2**63 - 1  # as in configurations
LONGEST_NAME_BYTES = 255  # NAME_MAX of Linux and of macOS
LONGEST_PATH_BYTES = 1023  # PATH_MAX of macOS without its end; Linux has 4095
UNPRINTABLE = ("Cc", "Cs", "Zl", "Zp")  # Unicode's control characters, half characters, line ends


class Options(argparse.ArgumentParser):
    """The options of a command, that is described by the first line of its file's docstring.

    Args:
        file: of the command. `python -OO` forgets docstrings, so the file is read.
    """

    def __init__(self, file: str) -> None:
        super().__init__(description=summary(Path(file)))

    def parse_args(self) -> argparse.Namespace:  # type: ignore[override]
        """The options of this process.

        Raises:
            InputError: a word that is no text of one line, or a path that no file can have.
        """
        for word in sys.argv[1:]:
            flag, _, value = word.partition("=")
            if flag.startswith("--") and value == "--":  # argparse makes a list of it
                raise InputError(flag.removeprefix("--"), value, "a value")
        found = super().parse_args()
        for name, value in vars(found).items():
            for word in value if isinstance(value, list) else [value]:
                _check_word(name.replace("_", "-"), word)
        return found

    def error(self, message: str) -> NoReturn:
        """One line, as for all bad input."""
        self.exit(2, f"error: {one_line(shortened(message))}\n")

    def whole(self, flag: str, low: int, high: int, **options: Any) -> None:
        """A whole number from `low` to `high`; further options are argparse's."""
        options.setdefault("metavar", "N")
        self.add_argument(flag, action=_Whole, bounds=(low, high), **options)

    def workers(self, what: str = "processes; default: a core each, or 1 for a GPU") -> None:
        """How many processes of this machine."""
        self.whole("--workers", 1, MOST_WORKERS, help=what)

    def cluster(self) -> None:
        """A Dask cluster that does the work, in place of processes of this machine."""
        self.add_argument(
            "--cluster", metavar="ADDRESS|local:N",
            help="a Dask scheduler, or N processes of this machine, in place of --workers",
        )  # fmt: skip
        self.add_argument(
            "--mixed", action="store_true",
            help="let workers of a cluster differ in the bits that they compute",
        )  # fmt: skip

    def config(self, default: str | None = None, stores: bool = False) -> None:
        """A configuration, of an experiment or a store; and the list of those that ship.

        It is required where there is no default.
        """
        said = "a shipped configuration's name, or a TOML file"
        self.add_argument(
            "--config", type=config_path, metavar="NAME|FILE",
            required=default is None, default=default and config_path(default),
            help=said if default is None else f"{said}; default: {default}",
        )  # fmt: skip
        self.add_argument(
            "--list-configs", action=_ListConfigs, nargs=0, const=stores,
            help="list the shipped ones, and exit",
        )  # fmt: skip


def asked_cluster(options: argparse.Namespace) -> Cluster | None:
    """What `Options.cluster` has found.

    Raises:
        InputError: no address, no Dask, or --mixed without a cluster.
    """
    if options.cluster is not None:
        return Cluster(options.cluster, options.mixed)
    if options.mixed:
        raise InputError("mixed", True, "only beside --cluster")
    return None


def summary(file: Path) -> str:
    """The first line of the docstring of a Python file."""
    docstring = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8")))
    return (docstring or "").partition("\n")[0]


def _check_word(field: str, word: object) -> None:
    """Refuse a word of several lines, or of no encoding; and a path that is too long."""
    if not isinstance(word, str | Path):
        return
    if any(unicodedata.category(character) in UNPRINTABLE for character in str(word)):
        raise InputError(field, str(word), "text of one line, without control characters")
    if isinstance(word, Path):
        longest = max((len(os.fsencode(part)) for part in word.parts), default=0)
        if longest > LONGEST_NAME_BYTES or len(os.fsencode(word)) > LONGEST_PATH_BYTES:
            allowed = f"a path of at most {LONGEST_PATH_BYTES} bytes, {LONGEST_NAME_BYTES} a name"
            raise InputError(field, str(word), allowed)


class _Whole(argparse.Action):
    """A whole number within bounds."""

    def __init__(self, *args: Any, bounds: tuple[int, int], **options: Any) -> None:
        super().__init__(*args, **options)
        self._low, self._high = bounds

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> None:
        """Check and keep the number."""
        text = str(values)
        try:
            value = int(text)
        except ValueError:  # no number, or one of thousands of digits
            value = None
        if value is None or not self._low <= value <= self._high:
            field = self.dest.replace("_", "-")
            allowed = f"a whole number from {self._low} to {self._high}"
            raise InputError(field, text if value is None else value, allowed)
        setattr(namespace, self.dest, value)


class _ListConfigs(argparse.Action):
    """Prints the shipped configurations and leaves."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> NoReturn:
        """A line each."""
        listed = shipped_configs(self.const)
        width = max(map(len, listed))
        print(*(f"{name:<{width}}  {says}" for name, says in listed.items()), sep="\n")
        parser.exit()
