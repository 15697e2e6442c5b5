"""Preloaded by workers of this machine: Ctrl-C, which all of a terminal hear, is not for them."""

import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Called by Dask in the worker's process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
