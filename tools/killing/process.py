"""A command in a process that is killed: at a commit of its own, or after some time.

A commit is a file that gets its name, or a transaction of a database. Python's audit events and
SQLAlchemy's tell of them: the commands know nothing of this. Processes are forked from one that has
imported what commands import and has done nothing else: to import it takes longer than a command.
"""

import atexit
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from sqlalchemy import Engine, Pool, event

NAMING = ("os.rename", "os.link")  # the audit events of os.replace and its like
DATABASE = "a transaction"  # in place of a file's name


@dataclass(frozen=True)
class Death:
    """When a process is killed; by default never.

    Attributes:
        commit: of a file of this name, or `DATABASE`, which it dies at.
        number: of that commit among those of its name, from 1.
        after: when it is done, at whatever comes next; otherwise just before.
        delay_s: so long after it has begun, in place of a commit.
    """

    commit: str = ""
    number: int = 1
    after: bool = False
    delay_s: float | None = None


@dataclass(frozen=True)
class Ended:
    """How a process ended.

    Attributes:
        code: its exit code, or the signal that killed it as a negative number.
        commits: names of those that it did, or was about to do, in their order.
        wall_s: from its beginning.
    """

    code: int
    commits: tuple[str, ...]
    wall_s: float

    @property
    def killed(self) -> bool:
        """Whether it was, and had not ended before."""
        return self.code == -signal.SIGKILL


class Watch:
    """Counts the commits of this process, tells of each, and kills it at one."""

    def __init__(self, death: Death, tell: int) -> None:
        """Tell the descriptor `tell`."""
        self._death, self._tell = death, tell
        self._count = 0
        self._dying: tuple[str, int] | None = None  # kind of event and thread that is next to die

    def begin(self) -> None:
        """Watch from here on."""
        os.write(self._tell, b"\n")
        sys.addaudithook(self._on_audit)
        event.listen(Engine, "commit", lambda _: self._on_commit(DATABASE, "checkin"))
        event.listen(Pool, "checkin", lambda *_: self._on_next("checkin"))

    def _on_audit(self, name: str, arguments: tuple[Any, ...]) -> None:
        if name in NAMING:
            self._on_commit(Path(arguments[1]).name, "audit")
        elif self._dying is not None:
            self._on_next("audit")

    def _on_commit(self, name: str, next_kind: str) -> None:
        os.write(self._tell, f"{name}\n".encode())
        self._count += name == self._death.commit
        if name != self._death.commit or self._count != self._death.number:
            return
        if not self._death.after:
            _die()
        self._dying = next_kind, threading.get_ident()

    def _on_next(self, kind: str) -> None:
        if self._dying == (kind, threading.get_ident()):
            self._dying = None  # to kill is an event, too
            _die()


def run(work: Callable[[], None], folder: Path, log: Path, death: Death = Death()) -> Ended:
    """Do some work in a process of its own, in a folder, until it ends or is killed.

    Args:
        work: as a command's main, in the guard of commands.
        folder: that it works in.
        log: file for all that it prints.
        death: when it is killed.
    """
    ours, theirs = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(ours)
        _be(work, folder, log, Watch(death, theirs))
    os.close(theirs)
    with os.fdopen(ours, "rb", buffering=0) as pipe:
        commits, wall_s = _listen(pipe.fileno(), pid, death.delay_s)
    _, status = os.waitpid(pid, 0)
    return Ended(os.waitstatus_to_exitcode(status), commits, wall_s)


def _listen(pipe: int, pid: int, delay_s: float | None) -> tuple[tuple[str, ...], float]:
    """The commits and seconds until the process was gone; it is killed after the delay."""
    begun_s, words = time.monotonic(), b""
    while True:
        left_s = None
        if delay_s is not None and words:
            left_s = max(0.0, begun_s + delay_s - time.monotonic())
        if not select.select([pipe], [], [], left_s)[0]:
            os.kill(pid, signal.SIGKILL)
            delay_s = None
            continue
        word = os.read(pipe, 4096)
        if not word:
            return tuple(words.decode().split("\n")[1:-1]), time.monotonic() - begun_s
        begun_s = begun_s if words else time.monotonic()
        words += word


def _be(work: Callable[[], None], folder: Path, log: Path, watch: Watch) -> NoReturn:
    """The process: all that it prints goes to the log, and none of its parent's code is run."""
    code: Any = 1
    try:
        printed = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(printed, 1)
        os.dup2(printed, 2)
        os.chdir(folder)
        watch.begin()
        work()
        code = 0
    except SystemExit as leaving:
        code = leaving.code or 0
    finally:
        sys.stdout.flush()
        atexit._run_exitfuncs()
        os._exit(code)


def _die() -> NoReturn:
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError("alive")
