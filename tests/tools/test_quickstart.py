"""The front door, with the simulator and the painters replaced."""

import json
import runpy
import sys
from pathlib import Path
from typing import Any

import pytest

import taichi_nmm
from study import pictures
from taichi_nmm.parameters import GAIN_NAMES
from tests.study import fake_walker

QUICKSTART = Path(__file__).parents[2] / "tools" / "quickstart.py"


def paint(path: Path, *_: Any) -> Path:
    path.write_bytes(b"picture")
    return path


def test_it_ends_with_what_was_found_and_where(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)
    monkeypatch.setattr(taichi_nmm, "load_gains", lambda _: taichi_nmm.K_T)
    monkeypatch.setattr(pictures, "write_strip", paint)
    monkeypatch.setattr(pictures, "write_gait_cycle", paint)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(sys, "argv", ["quickstart.py", "--out", str(tmp_path)])
    for _ in range(2):  # the second time everything is there
        runpy.run_path(str(QUICKSTART), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1].endswith(f"optuna-dashboard sqlite:///{tmp_path / 'studies.db'}")
    assert lines[-6].startswith("rough8/dog: ")
    assert lines[-5].startswith("rough8/random: ")
    assert sum("30/30" in line for line in lines) == 2  # no trial was run again
    assert tuple(json.loads((tmp_path / "found.json").read_text())) == GAIN_NAMES
    assert {path.name for path in tmp_path.glob("*.png")} == {
        f"{name}_{kind}.png" for name in ("found", "reference") for kind in ("strip", "gait_cycle")
    }
