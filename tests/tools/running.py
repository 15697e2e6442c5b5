"""A command of tools/, run in this process, where tests can replace what it calls."""

import runpy
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run_tool(patch: pytest.MonkeyPatch, tool: str, *arguments: object) -> int:
    """Exit code of tools/TOOL.py."""
    patch.setattr(sys, "argv", [f"{tool}.py", *map(str, arguments)])
    patch.setattr(sys, "path", list(sys.path))
    try:
        runpy.run_path(str(ROOT / "tools" / f"{tool}.py"), run_name="__main__")
    except SystemExit as end:
        return int(end.code or 0)
    return 0
