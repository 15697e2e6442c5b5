"""Every tool explains itself; and what one of them counts."""

import runpy
import sys

import pytest

from study.options import COMMANDS, documentation
from tests.tools.running import ROOT, TOOLS, load_tool

MOST = 10  # files, and classes, of a proposal; 34 and 26 in 0.2.0


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


def test_a_proposal_passes_few_files_and_classes() -> None:
    """It is followed on a few screens."""
    tool = load_tool("trace_proposal")
    calls = tool.calls_of_a_proposal()
    files, classes = tool.files_and_classes(calls)
    assert calls["study/sampler/sampler.py", "FeatureKernelSampler.sample_relative"]
    assert len(files) <= MOST and len(classes) <= MOST, (files, classes)
