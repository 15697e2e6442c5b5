"""What commands share: how many processes they take where nobody says."""

import pytest

from storage.pool import cores
from study import command
from study.command import default_workers
from taichi_nmm.settings import Settings


@pytest.mark.parametrize("settings", [Settings(arch="cpu"), Settings(engine="mujoco")])
def test_a_core_each_where_no_gpu_computes(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MuJoCo computes on the processor, whatever else the machine has."""
    monkeypatch.setattr(command, "find_library", lambda name: "libcuda.so")
    monkeypatch.setattr(command, "_started_arch", lambda settings: "cuda")
    assert default_workers(settings) == cores()


def test_one_where_a_gpu_computes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "find_library", lambda name: "libcuda.so")
    monkeypatch.setattr(command, "_started_arch", lambda settings: "cuda")
    assert default_workers(Settings()) == 1
