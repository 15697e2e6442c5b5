"""What every command runs in: one line and an exit code for whatever a user can get wrong.

Little is imported here, since nothing guards what is imported before.
"""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from types import FrameType
from typing import NoReturn

from taichi_nmm.errors import InputError
from taichi_nmm.neighbours import HiddenPackageError

STDOUT, STDERR = 1, 2  # the files, which need no object that Ctrl-C may have found half made
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells have it
EXIT_NO_READER = 141  # 128 + SIGPIPE
INTERRUPTED = "interrupted: finished work is kept; the same command resumes"
OURS = ("study", "storage", "taichi_nmm")


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
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:  # of `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), STDOUT)  # what is flushed at the end
        sys.exit(EXIT_NO_READER)
    except (InputError, HiddenPackageError) as error:
        _leave(f"error: {error}", EXIT_BAD_INPUT)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if not package or package in OURS:
            raise  # a mistake of ours
        line = f"error: package: {package!r} is not installed; allowed: an environment that has it"
        _leave(line, EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        _leave(INTERRUPTED, EXIT_INTERRUPTED)


def _end(_number: int, _frame: FrameType | None) -> NoReturn:
    os.write(STDERR, f"{INTERRUPTED}\n".encode())
    os._exit(EXIT_INTERRUPTED)


def _leave(line: str, code: int) -> NoReturn:
    print(line, file=sys.stderr)
    sys.exit(code)
