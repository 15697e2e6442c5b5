"""Units of work for workers to do, which import this file."""

import os
import signal
import time
from pathlib import Path
from typing import Any

from storage import open_store
from storage.inputs.errors import InputError

KIND = {"canary": "0" * 64, "processor": "any", "taichi-nmm": "1"}


def own_kind(*_: object) -> dict[str, str]:
    """A kind that takes no time to find."""
    return KIND


def square(number: int) -> int:
    return number**2


def slow_square(number: int) -> tuple[int, int]:
    """And the process that computed it."""
    time.sleep(0.2)
    return number**2, os.getpid()


def asleep(seconds: float) -> str:
    time.sleep(seconds)
    return "awake"


def refuse(number: int) -> None:
    raise InputError("samples", number, "none")


def fail(number: int) -> None:
    raise ArithmeticError(f"of {number}")


def die(number: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def die_once(mark: Path) -> str:
    if not mark.exists():
        mark.touch()
        die(0)
    return "lives"


def rows_of(store: Path) -> tuple[int, bool]:
    """Of a store, and whether it is at a place of the session's own."""
    return len(open_store(store)), store.is_absolute()


def wait_for(mark: Path) -> Any:
    mark.with_suffix(".begun").touch()
    while not mark.exists():
        time.sleep(0.05)
