"""A headless Chromium, for tests of what a person sees."""

import os
import shutil
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.cases import ASSETS

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",  # as if the network were cut
)
PATIENCE_MS = 30_000  # a busy machine draws slowly
SCREENSHOTS = "NMM_SCREENSHOTS"  # names the folder where they are kept, if it is set


@contextmanager
def opened_page(width, height):
    """A page of a browser without a window, which fails on errors of the page's scripts."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="no playwright: pip install 'taichi-nmm[test]'"
    )
    program = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip("no Chromium here: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=program, args=FLAGS, headless=True
        )
        page = browser.new_page(viewport={"width": width, "height": height})
        page.set_default_timeout(PATIENCE_MS)
        page.add_init_script(path=ASSETS / "hands.js")
        broken = []
        page.on("pageerror", lambda error: broken.append(str(error)))
        yield page
        browser.close()
        assert broken == []


def save(page, name):
    """Keep a screenshot, where one is wanted."""
    if os.environ.get(SCREENSHOTS):
        page.screenshot(path=Path(os.environ[SCREENSHOTS]) / f"{name}.png")
