"""A fake simulator, a store made with it, and a table of synthetic rows."""

from pathlib import Path

import numpy as np
import optuna
import pytest

import taichi_nmm
from study import FeatureTable
from tests.study import fake_walker

optuna.logging.set_verbosity(optuna.logging.ERROR)


@pytest.fixture
def fake_simulator(monkeypatch: pytest.MonkeyPatch) -> None:
    # Not setattr: it would read the old value first, which loads Taichi.
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake_walker.simulate)


@pytest.fixture
def store(fake_simulator: None, tmp_path: Path) -> Path:
    path = tmp_path / "store"
    fake_walker.write_store(path)
    return path


@pytest.fixture
def table() -> FeatureTable:
    """60 rows of two parameters; the score says how good a row is."""
    rng = np.random.default_rng(0)
    a, b = rng.uniform(-1, 1, 60), rng.uniform(0, 5, 60)
    return FeatureTable.from_arrays({"a": a, "b": b}, np.abs(a), bounds={"a": (-1, 1), "b": (0, 5)})
