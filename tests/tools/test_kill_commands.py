"""Commands killed at commits and at random moments: resumed, they leave what they always do.

By the tool's own machinery, with the simulator replaced; in a process of its own, since it forks.
"""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.tools.running import ROOT

pytestmark = pytest.mark.campaign
pytest.importorskip("ribs")

PROGRAM = [sys.executable, str(ROOT / "tests" / "tools" / "fake_kill.py")]
EVERY = "precompute,study,compare,report,optimum,draw_store"


def test_all_commands_resume_bit_equal_after_two_kills_each() -> None:
    done = subprocess.run(
        [*PROGRAM, "--kills", "12", "--commands", EVERY], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    rows = re.findall(r"\| (\w+) \| (\d+) \| (\d+) \| (\d+) \| (\d+) \|", done.stdout)
    assert [row[0] for row in rows][:6] == EVERY.split(",")
    assert sum(int(row[1]) for row in rows) >= 12
    assert all(row[3] == row[4] for row in rows)


def test_what_differs_is_found(tmp_path: Path) -> None:
    """A command that forgets how it is called leaves another picture."""
    program = tmp_path / "forgetful.py"
    program.write_text(FORGETFUL.format(root=str(ROOT)))
    done = subprocess.run(
        [sys.executable, program, "--kills", "2", "--commands", "draw_store"],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "store.png" in done.stderr.splitlines()[-1]


FORGETFUL = """
import os, sys
sys.path.insert(0, {root!r})
import taichi_nmm
from study.commands import draw_store
from study.cli import run_command
from tests.study import fake_walker
from tools import kill_commands

vars(taichi_nmm)["simulate"] = fake_walker.simulate
draw, draw_store.draw_store = draw_store.draw_store, None

def drawn(store):
    figure = draw(store)
    figure.suptitle(str(os.getpid()))
    return figure

draw_store.draw_store = drawn
run_command(lambda: kill_commands.main(pictures=False))
"""
