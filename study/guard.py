"""What every command runs in: one line and an exit code for whatever a user can get wrong.

Little is imported here, since nothing guards what is imported before.
"""

import errno
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.machinery import EXTENSION_SUFFIXES
from types import FrameType
from typing import NoReturn

from taichi_nmm.errors import InputError
from taichi_nmm.neighbours import HiddenPackageError

STDIN, STDOUT, STDERR = 0, 1, 2  # files: they need no object that Ctrl-C may have found half made
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells have it
EXIT_NO_READER = 141  # 128 + SIGPIPE
INTERRUPTED = "interrupted: finished work is kept; the same command resumes"
OURS = ("study", "storage", "taichi_nmm")

LEAST_ADDRESSES_B = 3 << 30  # a walk on two cores takes 2.3e9; OpenBLAS waits for ever for 0.4e9

# What a machine may refuse at any place, and what it would have to allow.
SPACE = "space for files and for what is printed"
MEMORY = "more memory, threads and processes (ulimit -v, -u)"
REFUSALS = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), SPACE),
    **dict.fromkeys((errno.EMFILE, errno.ENFILE), "more open files at a time (ulimit -n)"),
    **dict.fromkeys((errno.ENOMEM, errno.EAGAIN), MEMORY),
}


def run(name: str) -> None:
    """Run the command of `study/commands/NAME.py`, and leave the process with its exit code."""
    with guarded_imports():
        command = import_module(f"study.commands.{name}")
    run_command(command.main)


def run_command(main: Callable[[], None]) -> None:
    """Run a command's `main` and leave the process with its exit code.

    Bad input, and a package that is missing or hidden, print one line on standard error and exit
    with 2; Ctrl-C exits with 130 and says that what was finished is kept. Where nobody reads on
    what is printed, it ends without a word.
    """
    with _one_line():
        main()


@contextmanager
def guarded_imports() -> Iterator[None]:
    """For what a command imports: as in `run_command`, but Ctrl-C ends the process at once.

    Some packages swallow an exception while they are imported, or make another of it. Where
    something else listens to Ctrl-C, or nothing (as in a shell's background), it stays so.
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
    try:
        with _all_printed():
            yield
    except BrokenPipeError:  # of `| head`
        _silence(STDOUT)
        sys.exit(EXIT_NO_READER)
    except (InputError, HiddenPackageError) as error:
        _leave(f"error: {error}", EXIT_BAD_INPUT)
    except ImportError as error:
        missing = what_is_missing(error)
        if missing is None:
            raise  # a mistake of ours
        _leave(f"error: {missing}", EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        _leave(INTERRUPTED, EXIT_INTERRUPTED)
    except MemoryError:
        _leave_refused(os.strerror(errno.ENOMEM), MEMORY)
    except OSError as error:
        if error.errno not in REFUSALS:
            raise  # a mistake of ours
        try:
            sys.stdout.flush()
        except OSError:  # it was this file
            _silence(STDOUT)
        _leave_refused(os.strerror(error.errno), REFUSALS[error.errno])


def what_is_missing(error: ImportError) -> str | None:
    """The package that is not installed, or the library of the machine that one is linked with.

    None where neither is so: a mistake of ours.
    """
    name = (error.name or "").partition(".")[0]
    if not name or name in OURS:
        return None
    if isinstance(error, ModuleNotFoundError):
        return f"package: {name!r} is not installed; allowed: an environment that has it"
    if error.path is None or not error.path.endswith(tuple(EXTENSION_SUFFIXES)):
        return None
    allowed = f"a machine with the libraries that {name} needs (README.md)"
    return str(InputError(name, str(error), allowed))


@contextmanager
def _all_printed() -> Iterator[None]:
    """Print what is left where the work ends well or with an exit code."""
    try:
        yield
    except SystemExit:
        sys.stdout.flush()
        raise
    sys.stdout.flush()


def _open_closed() -> None:
    """Open closed standard files: the next file that is opened would get what is printed."""
    for number, name, mode in (
        (STDIN, "stdin", "r"),
        (STDOUT, "stdout", "w"),
        (STDERR, "stderr", "w"),
    ):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest free number
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


def _require_posix() -> None:
    """Refuse a system that locks files otherwise, as Windows does."""
    try:
        import_module("fcntl")
    except ImportError:
        raise InputError("machine", sys.platform, "Linux; on Windows, its WSL") from None


def _require_addresses() -> None:
    """Refuse a limit in which libraries end in ways of their own, or do not end at all."""
    import resource  # of POSIX alone

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < LEAST_ADDRESSES_B:
        allowed = f"{LEAST_ADDRESSES_B >> 10} or more, or unlimited"
        raise InputError("ulimit -v", limit >> 10, allowed)


def _silence(file: int) -> None:
    """Have nothing come of what is still to be flushed."""
    with suppress(OSError):  # no file more may be opened
        os.dup2(os.open(os.devnull, os.O_WRONLY), file)


def _end(_number: int, _frame: FrameType | None) -> NoReturn:
    os.write(STDERR, f"{INTERRUPTED}\n".encode())
    os._exit(EXIT_INTERRUPTED)


def _leave_refused(refusal: str, allowed: str) -> NoReturn:
    _leave(f"error: machine: {refusal!r} cannot be used; allowed: {allowed}", EXIT_BAD_INPUT)


def _leave(line: str, code: int) -> NoReturn:
    try:
        print(line, file=sys.stderr, flush=True)
    except OSError:  # nowhere to say it
        _silence(STDERR)
    sys.exit(code)
