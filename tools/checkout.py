"""Runs a command of `taichi-nmm` from a checkout, where nothing has to be installed."""

import sys
from pathlib import Path

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import main


def run(command: str) -> None:
    """Run a command on the words of this process, and leave with its exit code."""
    main([command, *sys.argv[1:]])
