"""Every tool explains itself from any folder, to a Python without docstrings."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from study.options import COMMANDS, documentation
from tests.taichi_nmm.test_kernel_cache import ODD
from tests.tools.running import ROOT, TOOLS

pytestmark = pytest.mark.slow

WALK = (ROOT / "tools" / "walk.py", "--duration", "2", "--movie-seconds", "0", "--json")
# Runs one line of words after the other, each with the paths of a process of its own; prints what
# each printed. That Python compiles all anew takes ten seconds, so there is one process for all.
RUN = """
import io, json, runpy, sys
from contextlib import redirect_stdout

paths, found = sys.path[1:], []
for sys.argv in json.load(sys.stdin):
    sys.path[:] = [sys.argv[0].rpartition("/")[0], *paths]
    sys.modules.pop("checkout", None)  # which prepares the paths
    with redirect_stdout(io.StringIO()) as said:
        try:
            runpy.run_path(sys.argv[0], run_name="__main__")
            code = 0
        except SystemExit as end:
            code = end.code or 0
    found.append((code, said.getvalue()))
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tools")


@pytest.fixture(scope="module")
def said(folder: Path) -> dict[str, tuple[int, str]]:
    """Exit codes and lines of a walk and of every tool's --help, in an odd environment."""
    words = [[*map(str, WALK), "--out", "out"]]
    words += [[str(ROOT / "tools" / f"{tool}.py"), "--help"] for tool in TOOLS]
    done = subprocess.run(
        [sys.executable, "-OO", "-c", RUN], input=json.dumps(words), cwd=folder,
        env=os.environ | ODD, capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    return dict(zip(("a walk", *TOOLS), json.loads(done.stdout), strict=True))


@pytest.mark.parametrize("tool", TOOLS)
def test_a_tool_explains_itself(tool: str, said: dict[str, tuple[int, str]], folder: Path) -> None:
    code, lines = said[tool]
    in_study = ROOT / "study" / "commands" / f"{tool}.py"
    text = documentation(in_study if tool in COMMANDS else ROOT / "tools" / f"{tool}.py")
    assert code == 0 and text and text in lines
    assert [path.name for path in folder.iterdir()] == ["out"]  # of the walk


def test_a_walk_is_the_same_in_an_odd_environment(
    said: dict[str, tuple[int, str]], folder: Path
) -> None:
    plain = subprocess.run(
        [sys.executable, *WALK, "--out", "out"], cwd=folder, capture_output=True, text=True
    )
    assert plain.returncode == 0, plain.stderr
    code, lines = said["a walk"]
    assert (code, lines) == (0, plain.stdout)
