"""The first import of a tool: from then on the packages of its checkout are found, uninstalled."""

import sys
from pathlib import Path

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import guarded_imports, main, run_command

__all__ = ["guarded_imports", "run", "run_command"]


def run(command: str) -> None:
    """Run a command on the words of this process, and leave with its exit code."""
    main([command, *sys.argv[1:]])
