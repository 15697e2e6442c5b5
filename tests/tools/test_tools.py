"""Every tool explains itself."""

import runpy
import sys

import pytest

from study.options import COMMANDS, documentation
from tests.tools.running import ROOT, TOOLS


@pytest.mark.slow
@pytest.mark.parametrize("tool", TOOLS)
def test_a_tool_explains_itself(
    tool: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = ROOT / "tools" / f"{tool}.py"
    monkeypatch.setattr(sys, "argv", [str(file), "--help"])
    monkeypatch.setattr(sys, "path", [str(file.parent), *sys.path])
    with pytest.raises(SystemExit, check=lambda end: not end.code):
        runpy.run_path(str(file), run_name="__main__")
    text = documentation(ROOT / "study" / "commands" / file.name if tool in COMMANDS else file)
    assert text and text in capsys.readouterr().out
