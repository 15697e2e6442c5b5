"""The options of every command, in a file that is quick to load: `taichi-nmm COMMAND --help`.

`COMMANDS` has a function for each command that adds the command's options to its parser. The
docstring of the command's file in `study/commands` is its description. Whole numbers are checked
against the bounds of configurations. An option that cannot be used is an `InputError`: one line, as
for all other input.
"""

import argparse
import ast
import os
import sys
import tomllib
import unicodedata
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from taichi_nmm.errors import InputError, one_line, shortened
from taichi_nmm.settings import ARCHITECTURES, ENGINES

PROGRAM = "taichi-nmm"
HERE = Path(__file__).resolve().parent
INSTALLED = HERE / "configs"  # the place of the configurations in a wheel
CONFIGS = INSTALLED if INSTALLED.is_dir() else HERE.parent / "configs"

MOST_WORKERS = 1024  # processes; each takes hundreds of MB
LARGEST_SEED = 2**63 - 1  # as in configurations
LARGEST_PORT = 65535
LONGEST_NAME_BYTES = 255  # NAME_MAX of Linux and of macOS
LONGEST_PATH_BYTES = 1023  # PATH_MAX of macOS without its end; Linux has 4095
UNPRINTABLE = ("Cc", "Cs", "Zl", "Zp")  # Unicode's control characters, half characters, line ends
BOTH_ENGINES = "both"
FROM_CONFIG = "default: the configuration's"

Bound = int | Callable[[], int]


def later(module: str, name: str) -> Callable[[], int]:
    """A bound that is looked up when a number is given: its module is slow to load."""
    return lambda: int(getattr(import_module(module), name))


MOST_RUNS = later("study.experiment.experiment", "MOST_RUNS")
MOST_TRIALS = later("study.experiment.experiment", "MOST_TRIALS")
LARGEST_SEQUENCE = later("storage.points", "LARGEST_SEQUENCE")


class Options(argparse.ArgumentParser):
    """The parser of the command in a file, which is called `prog`; by default, as this process was.

    The file's docstring is the description. It is read from the source, since `python -OO` drops
    docstrings.
    """

    def __init__(self, file: str | Path, prog: str | None = None) -> None:
        raw = argparse.RawDescriptionHelpFormatter
        super().__init__(prog, description=documentation(Path(file)), formatter_class=raw)
        self.bounds: dict[str, tuple[int, Bound]] = {}  # of whole numbers
        self.takes_others = False  # options of names that a file gives, as `others`

    def parse_args(self, words: Sequence[str] | None = None) -> argparse.Namespace:  # type: ignore[override]
        """The options of a command line; by default that of this process.

        Raises:
            InputError: a number out of its bounds, a word that is not text of one line, or a path
                that no file can have.
        """
        words = list(sys.argv[1:] if words is None else words)
        others = self._others(words) if self.takes_others else {}
        for word in words:
            flag, _, value = word.partition("=")
            if flag.startswith("--") and value == "--":  # argparse makes a list of it
                raise InputError(flag.removeprefix("--"), value, "a value")
        found = super().parse_args(words)
        for name, value in vars(found).items():
            field = name.replace("_", "-")
            for word in value if isinstance(value, list) else [value]:
                _check_word(field, word)
            if name in self.bounds and isinstance(value, str):
                setattr(found, name, _whole(field, value, *self.bounds[name]))
        if self.takes_others:
            found.others = others
        return found

    def _others(self, words: list[str]) -> dict[str, str]:
        """Take options of other names, with the words that follow them, out of a command line."""
        found = {}
        for flag in [word for word in words if word.startswith("--") and "=" not in word]:
            place = words.index(flag)
            if flag not in self._option_string_actions and place + 1 < len(words):
                found[flag.removeprefix("--")] = words[place + 1]
                del words[place : place + 2]
        return found

    def error(self, message: str) -> NoReturn:
        """One line, as for all bad input."""
        self.exit(2, f"error: {one_line(shortened(message))}\n")

    def whole(self, flag: str, low: int, high: Bound, **options: Any) -> None:
        """A whole number from `low` to `high`; further options are argparse's."""
        added = self.add_argument(flag, **({"metavar": "N"} | options))
        self.bounds[added.dest] = low, high

    def text(self, name: str, metavar: str, help: str, **options: Any) -> None:
        """A text, or of another type; further options are argparse's."""
        self.add_argument(name, metavar=metavar, help=help, **options)

    def path(self, name: str, help: str, metavar: str = "DIR", **options: Any) -> None:
        """A folder or a file; further options are argparse's."""
        self.text(name, metavar, help, type=Path, **options)

    def out(self, default: str, metavar: str = "DIR") -> None:
        """The folder or file to write."""
        self.path("--out", f"default: {default}", metavar)

    def flag(self, name: str, help: str) -> None:
        """A switch."""
        self.add_argument(name, action="store_true", help=help)

    def seed(self, purpose: str = "replaces the configuration's") -> None:
        """The seed of an experiment."""
        self.whole("--seed", 0, LARGEST_SEED, help=purpose)

    def run(self, purpose: str) -> None:
        """A run of an experiment, which checks it."""
        self.text("--run", "N", f"{purpose} (%(default)s)", type=int, default=0)

    def port(self, default: int) -> None:
        """The port of a page."""
        self.whole("--port", 0, LARGEST_PORT, default=default, help="%(default)s; 0: any free port")

    def arch(self) -> None:
        """The Taichi backend."""
        what = "Taichi backend; overrides the configuration's"
        self.add_argument("--arch", choices=ARCHITECTURES, help=what)

    def json(self, what: str = "the result") -> None:
        """Output for programs."""
        self.flag("--json", f"print {what} as one JSON object")

    def workers(self) -> None:
        """How many processes of this machine do the work, or which Dask cluster."""
        default = "processes; default: one a core, or 1 on a GPU"
        self.whole("--workers", 1, MOST_WORKERS, help=default)
        what = "a Dask scheduler, or N processes of this machine, instead of --workers"
        self.text("--cluster", "ADDRESS|local:N", what)
        self.flag("--mixed", "allow workers of a cluster whose results differ in their last bits")

    def config(self, default: str | None = None, stores: bool = False) -> None:
        """A configuration of an experiment or a store, and the list of those that ship.

        It is required where there is no default.
        """
        what = "a shipped configuration's name, or a TOML file"
        what += "" if default is None else f"; default: {default}"
        self.text(
            "--config", "NAME|FILE", what, type=config_path, required=default is None,
            default=default and config_path(default),
        )  # fmt: skip
        what = "list the shipped configurations and exit"
        self.add_argument("--list-configs", action=_ListConfigs, nargs=0, const=stores, help=what)


def bench(options: Options) -> None:
    """Options of `bench`."""
    options.takes_others = True
    options.text("action", "ACTION", "one of those above")
    options.text("what", "WHAT", "a trial, an entry, a name, a file", nargs="?")
    options.path("--bench", "default: the only bench among the *.toml of this folder", "FILE")
    options.add_argument("--cost", "--value", type=float, metavar="X", help="of a trial: its value")
    options.text("--seconds", "S", "after which a trial failed", type=float)
    options.text("--note", "TEXT", "kept with the entry", default="")
    options.path("--log", "CSV with columns time (s) and position (m), of a walk", "FILE")
    options.path("--gains", "JSON of parameters by name", "FILE")
    options.whole("--batch", 1, 1000, default=1, help="trials to run side by side (%(default)s)")
    options.text("--repeat", "N", "a trial to run once more", type=int)
    options.path("--json", "write the next trials' parameters there too", "FILE")
    options.text("--operator", "NAME", "default: the user and the machine")
    what = "of the page of `serve`, for others too, by the link that is printed; default: loopback"
    options.text("--listen", "ADDRESS", what)
    options.text(
        "--simulator", "FILE:NAME", "films candidates of a simulator of your own on that page"
    )
    options.port(8090)


def compare(options: Options) -> None:
    """Options of `compare`."""
    options.config()
    options.text("--arms", "A,B,C", FROM_CONFIG)
    options.whole("--runs", 1, MOST_RUNS, help=FROM_CONFIG)
    options.whole("--trials", 1, MOST_TRIALS, help=f"of a run, in total; {FROM_CONFIG}")
    options.seed("other bodies, grounds and samplers than the configuration's, to tune on")
    options.out("out/compare/NAME or NAME-seed-N")
    options.text("--storage", "URL", "default: sqlite:///DIR/studies.db")
    options.path("--store", f"store of scores, if the arms read one; {FROM_CONFIG}")
    options.workers()
    options.arch()
    options.json()


def dashboard(options: Options) -> None:
    """Options of `dashboard`."""
    options.path("folder", "folder of an experiment; default: the newest in out/compare", nargs="?")
    options.text("--storage", "URL", "default: sqlite:///DIR/studies.db")
    options.path("--artifacts", "default: DIR/artifacts")
    options.port(8080)


def explore(options: Options) -> None:
    """Options of `explore`."""
    options.path("folder", "folder or file of a store")
    options.text("--simulator", "FILE:NAME", "films rows of a store of your own simulator")
    options.port(5006)
    options.flag("--no-browser", "only print the address")


def precompute(options: Options) -> None:
    """Options of `precompute`."""
    options.config("store", stores=True)
    options.whole("--samples", 1, LARGEST_SEQUENCE, help=f"points; {FROM_CONFIG}")
    options.out("out/NAME of the configuration")
    options.arch()
    options.workers()
    options.flag("--fresh", "delete the store and start over")
    options.json("the summary")


def quickstart(options: Options) -> None:
    """Options of `quickstart`."""
    options.path("--out", "%(default)s", default=Path("out/quickstart"))


def report(options: Options) -> None:
    """Options of `report`."""
    options.path("folders", "folder of a comparison", nargs="+")
    options.path("--out", "folder for the overview of several comparisons")


def study(options: Options) -> None:
    """Options of `study`."""
    options.config()
    what = "worlds, dog, random or another one; an unknown name lists all"
    options.text("--arm", "ARM", what, required=True)
    options.run("number of the body and the ground")
    options.whole("--trials", 1, MOST_TRIALS, help=f"in total; {FROM_CONFIG}")
    options.seed()
    options.text("--storage", "URL", "sqlite:///FILE, or one of PostgreSQL", required=True)
    options.path("--store", f"store of scores, if the arm reads one; {FROM_CONFIG}")
    options.out("out/NAME, for the best gains")
    options.arch()
    options.json()


def validate(options: Options) -> None:
    """Options of `validate`."""
    most = 1_000_000  # at once in memory, unlike those of a store
    options.whole("--samples", 100, most, default=20_000, help="points (%(default)s)")
    options.whole("--draws", 1, MOST_RUNS, default=4, help="bodies and rough grounds (%(default)s)")
    options.whole("--seed", 0, LARGEST_SEED, default=2016, help="of points and draws (%(default)s)")
    options.json("the figures")


def walk(options: Options) -> None:
    """Options of `walk`."""
    options.text("--gains", "NAME|FILE", "reference (default), published, FILE.json")
    options.text("--row", "N", "a row of --store", type=int)
    what = "the row of --store that walks at this speed with the least energy"
    options.text("--speed", "MPS", what, type=float)
    options.path("--store", "a store, for --row or --speed")
    options.text("--trial", "STUDY/NUMBER", "a finished trial of --storage")
    options.text("--storage", "URL|DIR", "a study database, or a comparison's folder")
    options.config("flat")
    options.run("number of the body and the ground")
    options.seed()
    options.text("--duration", "S", f"seconds; {FROM_CONFIG}", type=float)
    options.out("out/walk/NAME, for the pictures")
    what = "length of the film (%(default)s); 0: none"
    options.text("--movie-seconds", "S", what, type=float, default=8.0)
    engines = (*ENGINES, BOTH_ENGINES)
    options.add_argument("--engine", choices=engines, help="overrides the configuration's")
    options.path("--mjcf", "write MuJoCo's model there too", "FILE")
    what = "write all samples there too: .csv, or OpenSim's .mot (coordinates), .sto (states)"
    options.path("--trajectory", what, "FILE", action="append", default=[])
    options.path("--opensim", "write OpenSim's model, motion, states and loads there")
    options.arch()
    options.json()


COMMANDS: dict[str, Callable[[Options], None]] = {
    "bench": bench, "compare": compare, "dashboard": dashboard, "explore": explore,
    "precompute": precompute, "quickstart": quickstart, "report": report, "study": study,
    "validate": validate, "walk": walk,
}  # fmt: skip

# Commands of version 0.2.0 that are gone, and what to use instead.
REMOVED = {
    "draw-store": "explore STORE",
    "optimum": "compare --config optimum-smooth --arms cmaes-cold --trials 10000",
}


def parser_of(name: str) -> Options:
    """The parser of a command; `parser_of(name).format_help()` is its help.

    Raises:
        InputError: no such command; the line lists all, or says what replaces one that is gone.
    """
    if name in REMOVED:
        instead = f"{PROGRAM} {REMOVED[name]}; {name} is gone, version 0.2.0 was the last with it"
        raise InputError("command", name, instead)
    if name not in COMMANDS:
        raise InputError("command", name, ", ".join(COMMANDS))
    parser = Options(file_of(name), f"{PROGRAM} {name}")
    COMMANDS[name](parser)
    return parser


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

    A name is a word, such as rough8; anything with a folder or a suffix is a file. The name of a
    variant, such as ramp-up-gentle, stands for a file that `taichi_nmm.config.read_toml` finds in
    ramp-up.toml.
    """
    word = str(name)
    for shipped in CONFIGS.glob("*.toml"):  # no file is looked up by a name that was given
        if word == shipped.stem:
            return shipped
        if word.startswith(f"{shipped.stem}-") and word in _described(shipped):
            return shipped.with_stem(word)
    return Path(name)


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
        f"{file.stem}-{name}": table["about"] for name, table in tables.get("variants", {}).items()
    }
    return variants if tables.get("only_variants") else {file.stem: first} | variants


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


def _whole(field: str, text: str, low: int, high: Bound) -> int:
    """The whole number within bounds that a text is."""
    high = high() if callable(high) else high
    try:
        value = int(text)
    except ValueError:  # no number, or one of thousands of digits
        value = None
    if value is None or not low <= value <= high:
        allowed = f"a whole number from {low} to {high}"
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
