"""Shared by all tests: what they need of the machine, whoever starts them.

Taichi's cache of compiled kernels lives in the project, not in the home. A shell ignores Ctrl-C for
what it starts in the background, and children inherit that: commands under test must hear it. Where
workers fill the cores, threads of linear algebra only wait for one another.
"""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser import opened_page

CACHE = Path(__file__).resolve().parent.parent / ".pytest_cache" / "taichi"
os.environ.setdefault("TI_OFFLINE_CACHE_FILE_PATH", str(CACHE))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Before the workers of a parallel run are started, in the process that starts them."""
    if session.config.getoption("numprocesses", None):
        from tests.kernels import compile_kernels

        compile_kernels()


@pytest.fixture(scope="module")
def page() -> Iterator[Any]:
    """A page of a browser without a window, which fails on errors of the page's scripts."""
    with opened_page(1200, 1240) as page:
        yield page
