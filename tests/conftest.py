"""Shared by all tests: what they need of the machine, whoever starts them.

Taichi's cache of compiled kernels lives in the project, not in the home. A shell ignores Ctrl-C for
what it starts in the background, and children inherit that: commands under test must hear it. Where
workers fill the cores, threads of linear algebra only wait for one another.
"""

import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

CACHE = Path(__file__).resolve().parent.parent / ".pytest_cache" / "taichi"
os.environ.setdefault("TI_OFFLINE_CACHE_FILE_PATH", str(CACHE))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
signal.signal(signal.SIGINT, signal.default_int_handler)

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
PATIENCE_MS = 30_000  # a busy machine draws slowly


def pytest_sessionstart(session: pytest.Session) -> None:
    """Before the workers of a parallel run are started, in the process that starts them."""
    if session.config.getoption("numprocesses", None):
        from tests.kernels import compile_kernels

        compile_kernels()


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A page of a browser without a window, which fails on errors of the page's scripts."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="no playwright: pip install 'taichi-nmm[test]'"
    )
    program = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip("no Chromium here: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=FLAGS, headless=True)
        page = browser.new_page(viewport={"width": 1200, "height": 1240})
        page.set_default_timeout(PATIENCE_MS)
        broken: list[str] = []
        page.on("pageerror", lambda error: broken.append(str(error)))
        yield page
        browser.close()
        assert not broken
