"""The tool that needs a GPU, without one."""

import subprocess
import sys

import pytest

from taichi_nmm import Settings
from taichi_nmm.walker_simulator import takes_gpu
from tests.processes import ROOT


def test_a_machine_without_a_gpu_is_refused_in_a_line() -> None:
    if takes_gpu(Settings()):
        pytest.skip("a GPU")
    tool = str(ROOT / "tools" / "check_gpu.py")
    done = subprocess.run([sys.executable, tool], capture_output=True, text=True)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "no GPU" in done.stderr
