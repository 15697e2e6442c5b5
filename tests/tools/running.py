"""A command of tools/, run in this process, where tests can replace what it calls."""

import importlib.util
import runpy
import sys
from pathlib import Path
from types import ModuleType

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


def load_tool(tool: str) -> ModuleType:
    """tools/TOOL.py as a module, not run."""
    specification = importlib.util.spec_from_file_location(
        f"tools_{tool}", ROOT / "tools" / f"{tool}.py"
    )
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module
