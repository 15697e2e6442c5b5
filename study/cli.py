"""The command line: `taichi-nmm COMMAND`, the guard that ends every command in one line, progress.

`main` finds the command, reads its options (`study/options.py`) and runs `main` of
`study/commands/COMMAND.py`, all inside the guard: a mistake of the user ends in one
line on standard error and an exit code. This file imports little at its top, where
nothing is guarded.

| exit code | meaning |
|---|---|
| 0 | done |
| 2 | bad input, a missing package, or a machine that refuses space or memory |
| 130 | interrupted by Ctrl-C: finished work is kept |
| 141 | the reader of standard output has left, as `head` does |
"""

import errno
import gc
import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.machinery import EXTENSION_SUFFIXES
from io import TextIOWrapper
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

from storage.inputs.errors import InputError

if TYPE_CHECKING:
    from tqdm import tqdm


STDOUT, STDERR = 1, 2  # files: they need no object that Ctrl-C may have found half made
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells have it
EXIT_NO_READER = 141  # 128 + SIGPIPE
INTERRUPTED = "interrupted: finished work is kept; the same command resumes"
OURS = ("study", "storage", "taichi_nmm")

# `study` on two cores takes 3.6e9; OpenBLAS waits for ever for 0.4e9
LEAST_ADDRESSES_B = 4 << 30

# Errors by which a machine may refuse resources at any place, and the remedy.
SPACE = "space for files and for what is printed"
MEMORY = "more memory, threads and processes (ulimit -v, -u)"
REFUSALS = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), SPACE),
    **dict.fromkeys(
        (errno.EMFILE, errno.ENFILE), "more open files at a time (ulimit -n)"
    ),
    **dict.fromkeys((errno.ENOMEM, errno.EAGAIN), MEMORY),
}


def main(words: Sequence[str] | None = None) -> None:
    """Run the command that the first word names, with the others as options; leave with its code.

    None: the words that this process was called with.
    """
    words = sys.argv[1:] if words is None else words
    with guarded_imports():
        from study.options import overview, parser_of

        if not words or words[0] in ("-h", "--help"):
            print(overview())
            return
        name, *rest = words
        options = parser_of(name).parse_args(rest)
        command = import_module(f"study.commands.{name.replace('-', '_')}")
    warnings.formatwarning = warning_line
    # `taichi_nmm.__main__` looks for no garbage while it imports: nothing of it is.
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
    run_command(lambda: command.main(options))


def warning_line(message: Warning | str, *_: Any, **__: Any) -> str:
    """A warning as commands print it: where in the code it arose helps nobody there."""
    return f"warning: {message}\n"


def run_command(work: Callable[[], None]) -> None:
    """Do the work of a command inside the guard; leave the process where it does not end well."""
    with _one_line():
        work()


@contextmanager
def guarded_imports() -> Iterator[None]:
    """Guard imports: as `run_command`, but Ctrl-C ends the process at once.

    Some packages swallow an exception that is raised during their import, or replace
    it. A handler of SIGINT that is not Python's own (in a shell's background, SIGINT is
    ignored) stays in place.
    """
    with _one_line():
        _require_posix()
        _require_addresses()
        if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            yield
            return
        signal.signal(signal.SIGINT, _end)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def _one_line() -> Iterator[None]:
    _open_closed()
    _escape_foreign()
    try:
        try:
            yield
        except SystemExit:
            sys.stdout.flush()  # here, where the reader's leaving is caught
            raise
        sys.stdout.flush()
    except BrokenPipeError:  # as with `| head`
        _silence(STDOUT)
        try:
            sys.stderr.flush()
        except (
            OSError
        ):  # `2>&1 | head`: Python would try again at its end, and exit with 120
            _silence(STDERR)
        sys.exit(EXIT_NO_READER)
    except InputError as error:
        lines = str(error).splitlines()  # one, or the mistakes of a file
        _leave("\n".join(f"error: {line}" for line in lines), EXIT_BAD_INPUT)
    except ImportError as error:
        missing = what_is_missing(error)
        if missing is None:
            raise  # a mistake of ours
        _leave(f"error: {missing}", EXIT_BAD_INPUT)
    except KeyboardInterrupt as stop:
        _leave(str(stop) or INTERRUPTED, EXIT_INTERRUPTED)
    except MemoryError:
        _leave_refused(os.strerror(errno.ENOMEM), MEMORY)
    except OSError as error:
        if error.errno == errno.EACCES and error.filename is not None:
            refused = InputError(
                "file", str(error.filename), "a file that this user may use"
            )
            _leave(f"error: {refused}", EXIT_BAD_INPUT)
        if error.errno not in REFUSALS:
            raise  # a mistake of ours
        try:
            sys.stdout.flush()
        except OSError:  # standard output is the file that failed
            _silence(STDOUT)
        _leave_refused(os.strerror(error.errno), REFUSALS[error.errno])


def what_is_missing(error: ImportError) -> str | None:
    """One line that names the missing package, or the system library that a package fails to load.

    None for any other import error: a mistake of this project.
    """
    name = (error.name or "").partition(".")[0]
    if not name or name in OURS:
        return None
    if isinstance(error, ModuleNotFoundError):
        return (
            f"package: {name!r} is not installed; allowed: an environment that has it"
        )
    if error.path is None or not error.path.endswith(tuple(EXTENSION_SUFFIXES)):
        return None
    allowed = f"a machine with the libraries that {name} needs (README.md)"
    return str(InputError(name, str(error), allowed))


def _open_closed() -> None:
    """Open closed standard files; otherwise the next opened file gets the output."""
    for number, (name, mode) in enumerate(
        (("stdin", "r"), ("stdout", "w"), ("stderr", "w"))
    ):
        try:
            os.fstat(number)
        except OSError:
            # the lowest free number
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


def _escape_foreign() -> None:
    """Print characters that the terminal's encoding lacks as escapes: nothing fails over a name."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _require_posix() -> None:
    """Refuse a system without POSIX file locks, such as Windows."""
    try:
        import_module("fcntl")
    except ImportError:
        raise InputError(
            "machine", sys.platform, "Linux; on Windows, its WSL"
        ) from None


def _require_addresses() -> None:
    """Refuse a memory limit under which libraries crash or hang instead of reporting an error."""
    import resource  # of POSIX alone

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < LEAST_ADDRESSES_B:
        allowed = f"{LEAST_ADDRESSES_B >> 10} or more, or unlimited"
        raise InputError("ulimit -v", limit >> 10, allowed)


def _silence(file: int) -> None:
    """Discard output that is not flushed yet."""
    with suppress(OSError):  # no file more may be opened
        os.dup2(os.open(os.devnull, os.O_WRONLY), file)


def _end(_number: int, _frame: FrameType | None) -> NoReturn:
    os.write(STDERR, f"{INTERRUPTED}\n".encode())
    os._exit(EXIT_INTERRUPTED)


def _leave_refused(refusal: str, allowed: str) -> NoReturn:
    _leave(
        f"error: machine: {refusal!r} cannot be used; allowed: {allowed}",
        EXIT_BAD_INPUT,
    )


def _leave(line: str, code: int) -> NoReturn:
    try:
        print(line, file=sys.stderr, flush=True)
    except OSError:  # standard error cannot be written either
        _silence(STDERR)
    sys.exit(code)


class ProgressBar:
    """A bar on standard error: units a second, and the time left.

    It is shown from the first step on, which tells how much earlier runs have done:
    that is no part of the rate.
    """

    def __init__(self) -> None:
        self._bar: tqdm[None] | None = None

    def move(self, unit: str, done: float, total: int, note: str = "") -> None:
        """Show `done` of `total`; another unit gets a line of its own."""
        from tqdm import tqdm

        if self._bar is not None and self._bar.unit != unit:
            self.close()
        if self._bar is None:
            self._bar = tqdm(total=total, initial=int(done), unit=unit, smoothing=0.05)
        self._bar.set_postfix_str(note, refresh=False)
        self._bar.update(int(done) - self._bar.n)

    def close(self) -> None:
        """Leave the line."""
        if self._bar is not None:
            self._bar.close()
        self._bar = None
