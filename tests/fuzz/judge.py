"""One command on one folder, in this process, and whether it did what every command must do.

It ends with 0, or with 2, one line that names something, and the folder as it was. The simulator is
replaced by a door: whoever gets there has passed all checks of what he gave.
"""

import hashlib
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from study.cli import EXIT_BAD_INPUT, main

ACCEPTED, REFUSED = 0, EXIT_BAD_INPUT
LINE = re.compile(r"error: \S.*: .*\S", re.DOTALL)
OF_ARGPARSE = re.compile(r"error: (unrecognized arguments|the following arguments are required): ")
# Of optimum and compare, of which the end of the work looks at what the beginning could not.
PROGRESS = re.compile(r"^(dog: \d+ of \d+ trials|(\r[^\r\n]*trial/s[^\r\n]*)+)\n")
LONGEST_LINE = 2000  # characters; a path may have hundreds
PICTURES = {"png": b"\x89PNG IEND\xaeB`\x82", "svg": b"<svg></svg>"}

Content = dict[str, str]
"""What a file or a folder is, by its path."""


class Reached(BaseException):
    """The command got where the work begins."""


class Idle(Executor):
    """Does nothing of what it is asked for."""

    def __init__(self, _: int) -> None:
        pass

    def submit(self, *_: Any, **__: Any) -> Future[Any]:
        return Future()


@dataclass(frozen=True)
class Verdict:
    """What came of a command.

    Attributes:
        code: that it ended with; None where it did not say.
        wrong: what it must not have done; "": nothing.
        said: on standard error.
    """

    code: int | None
    wrong: str
    said: str


def judge(words: tuple[str, ...], folder: Path) -> Verdict:
    """Run `taichi-nmm` with these words from within the folder.

    Standard output and error of this process have to be files (see `files_for_output`).
    """
    before = content(folder)
    code, error = run(words, folder)
    said = take_output()
    if error:
        return Verdict(None, error, said)
    return Verdict(code, wrong(code, said, before, folder), said)


def run(words: tuple[str, ...], folder: Path) -> tuple[int | None, str]:
    """Exit code of a command; or what it raised, and where."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        with mock.patch.object(sys, "argv", []), warnings.catch_warnings():
            main(words)
    except SystemExit as end:
        return (end.code, "") if isinstance(end.code, int) else (int(bool(end.code)), "")
    except Reached:
        pass
    except BaseException as error:  # what the guard lets pass is what is looked for
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        return None, f"{type(error).__name__} in {where}: {error}"[:300]
    finally:
        os.chdir(before)
    return ACCEPTED, ""


def wrong(code: int | None, said: str, before: Content, folder: Path) -> str:
    """What is wrong with an exit code, what was said, and what is left in the folder."""
    if "Traceback" in said:
        return "a traceback"
    if code == ACCEPTED:
        return ""
    if code != REFUSED:
        return f"exit code {code}"
    line = PROGRESS.sub("", said).removesuffix("\n")
    if "\n" in line or not line.isprintable():
        return f"{len(said.splitlines())} lines, or one that is not printable"
    if not (LINE.fullmatch(line) or OF_ARGPARSE.match(line)) or len(line) > LONGEST_LINE:
        return f"a line that names nothing, or of {len(line)} characters"
    after = content(folder)
    changed = sorted(path for path in before.keys() | after if before.get(path) != after.get(path))
    return f"changed: {', '.join(changed)}" if changed else ""


def content(folder: Path) -> Content:
    """SHA-256 of every file below a folder; folders too."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        data = path.read_bytes() if path.is_file() and not path.is_symlink() else None
        found[name] = "no file" if data is None else hashlib.sha256(data).hexdigest()
    return found


@contextmanager
def doors() -> Iterator[None]:
    """Where the work would begin, `Reached` is raised; and what no input decides takes no time."""
    from alembic.script import ScriptDirectory
    from bokeh.document import Document
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    import taichi_nmm.simulator
    from storage import pool
    from study.commands import dashboard, explore

    def reached(*_: object, **__: object) -> None:
        raise Reached

    def fill(page: Callable[[Document], None], _: int) -> None:
        page(Document())
        raise Reached

    def savefig(_: object, path: Path, format: str, **__: object) -> None:
        Path(path).write_bytes(PICTURES[format])

    ask, known = ScriptDirectory.get_current_head, []

    def head(script: ScriptDirectory) -> str | None:
        if not known:
            known.append(ask(script))
        return known[0]

    for_nothing = [
        (Figure, "savefig", savefig),
        (Figure, "tight_layout", lambda _: None),
        (FigureCanvasAgg, "draw", lambda _: None),
        (os, "fsync", lambda _: None),
        # Optuna asks anew for the version of its own schema, from ten files, at every opening.
        (ScriptDirectory, "get_current_head", head),
    ]
    with ExitStack() as stack:
        for owner, name, instead in (
            (taichi_nmm.simulator, "_start", reached),
            (pool, "Processes", reached),
            (dashboard.Server, "serve_forever", reached),
            (explore, "Processes", Idle),
            (explore, "serve", fill),
            *for_nothing,
        ):
            stack.enter_context(mock.patch.object(owner, name, instead))
        yield


def files_for_output(folder: Path) -> None:
    """From now on standard output and error are files: C++ writes there too, past Python."""
    for number, name in ((1, "stdout"), (2, "stderr")):
        file = os.open(folder / name, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
        os.dup2(file, number)
        os.close(file)


def take_output() -> str:
    """What stands on standard error; both are emptied."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    said = os.pread(2, 1 << 20, 0).decode(errors="replace")
    for number in (1, 2):
        os.ftruncate(number, 0)
    return said
