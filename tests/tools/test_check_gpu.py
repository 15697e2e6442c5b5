"""The tool that needs a GPU, without one."""

import re

import pytest

from taichi_nmm import Settings
from taichi_nmm.walker_simulator import takes_gpu
from tests.tools.running import run_tool


def test_a_machine_without_a_gpu_is_refused_in_a_line(monkeypatch, capsys):
    if takes_gpu(Settings()):
        pytest.skip("a GPU")
    assert run_tool(monkeypatch, "check_gpu") == 2
    assert re.fullmatch("[^\n]*no GPU[^\n]*\n", capsys.readouterr().err)
