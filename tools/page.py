"""The page of a measurement: text that people write, and below it the figures of a tool."""

import os
import platform
import re
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from storage.commit import commit_text

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("numpy", "scipy", "scikit-learn", "optuna", "cmaes", "torch", "greenlet")


def write_page(
    path: Path,
    title: str,
    figures: list[str],
    guide: str = "docs/sampler-benchmarks.md",
) -> None:
    """Write a page, and print its figures.

    A page that is there keeps its text above the figures, of which the first line is
    the same at all times; but the line 'Written by' is new.

    Raises:
        InputError: the page cannot be written.
    """
    how = f"`{guide}` says how to read the figures."
    fresh = f"# {title}\n\n{how}\n\nWritten by\n"
    said = path.read_text(encoding="utf-8") if path.exists() else fresh
    above = said.partition(f"\n{figures[0]}\n")[0].rstrip()
    above = re.sub("^Written by.*", lambda _: made_by(), above, flags=re.MULTILINE)
    commit_text(path, "\n".join([above, "", *figures, ""]))
    print("\n".join(figures))


def made_by() -> str:
    """The line of a page: command, day, machine and versions that made it."""
    command = " ".join(["python", f"tools/{Path(sys.argv[0]).name}", *sys.argv[1:]])
    machine = f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}"
    day = time.strftime("%Y-%m-%d")
    return f"Written by `{command}` on {day}: {machine}; {versions(*PACKAGES)}."


def versions(*packages: str) -> str:
    """Versions of Python and of packages."""
    found = [
        f"{name} {installed(name)}" if installed(name) else f"no {name}"
        for name in packages
    ]
    return ", ".join([f"Python {platform.python_version()}", *found])


def installed(package: str) -> str:
    """The version of an installed package; "" where it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
