"""Every tool as a process of its own: it starts from any folder and explains itself."""

import subprocess
import sys
from pathlib import Path

import pytest

from study.options import COMMANDS, documentation
from tests.tools.running import ROOT

PARTS = {"bench_worker", "checkout", "benchmark", "outside", "synthetic"}  # of other tools
TOOLS = {path.stem for path in (ROOT / "tools").glob("*.py")} - PARTS


@pytest.mark.slow
@pytest.mark.parametrize("tool", sorted(TOOLS))
def test_a_tool_explains_itself_to_a_python_without_docstrings(tool: str, tmp_path: Path) -> None:
    file = ROOT / "tools" / f"{tool}.py"
    done = subprocess.run(
        [sys.executable, "-OO", file, "--help"], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    of_command = ROOT / "study" / "commands" / f"{tool}.py"
    text = documentation(of_command if tool in COMMANDS else file)
    assert text and text in done.stdout
    assert list(tmp_path.iterdir()) == []
