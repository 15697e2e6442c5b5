"""Shared by all tests: the environment, and kernels compiled once for all processes.

Taichi's cache of compiled kernels lies in the project, not in the home. A shell lets
processes in the background ignore Ctrl-C, and children inherit that: here they do not.
Where workers fill the cores, threads of linear algebra only wait for one another.

Taichi writes compiled kernels when a process ends. So on a fresh machine each worker of
a parallel run, and each command that a test starts, would compile the same kernel, half
a minute at a time.
"""

import os
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from taichi_nmm.kernel_cache import CACHE_VARIABLE, COMPILER
from tests.browser import opened_page
from tests.cases import ASSETS
from tests.processes import ROOT, python, read_schema_once

os.environ.setdefault(CACHE_VARIABLE, str(ROOT / ".pytest_cache" / COMPILER))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
signal.signal(signal.SIGINT, signal.default_int_handler)

read_schema_once()

SIMULATE = (
    "from taichi_nmm import PUBLISHED_GAINS, Settings, simulate; "
    "simulate(PUBLISHED_GAINS, duration_s=0.1, settings=Settings(arch='cpu', {}))"
)
MOST_TESTS = (
    "",
    "threads=1",
    "precision='float64'",
    "engine='mujoco'",
    "engine='mujoco', threads=1",
)


def compile_kernel(settings):
    """In a process of its own, which writes to the cache; errors show in the tests."""
    python("-c", SIMULATE.format(settings))


def pytest_sessionstart(session):
    """Compile kernels before the workers of a parallel run are started, unless some are there.

    Where tests are run, processes that they start find the checkout, and what they do
    first.
    """
    if not session.config.getoption("numprocesses", None):
        os.environ["PYTHONPATH"] = os.pathsep.join(
            (str(ROOT), str(ASSETS / "children"))
        )
        return
    cache = Path(os.environ[CACHE_VARIABLE])
    if not cache.is_dir() or not any(cache.iterdir()):
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            list(threads.map(compile_kernel, MOST_TESTS))


@pytest.fixture(scope="module")
def page():
    """A page of a browser without a window, which fails on errors of the page's scripts."""
    with opened_page(1200, 1240) as page:
        yield page
