import shutil
from pathlib import Path

import pytest

import taichi_nmm
from storage.precompute import precompute
from tests.storage import fake


@pytest.fixture(autouse=True)
def fake_simulator(monkeypatch):
    # Not setattr, which would look at the real one first and so load Taichi.
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake.simulate)


@pytest.fixture(scope="session")
def original(tmp_path_factory):
    """A store with the family robust, which no test changes."""
    path = tmp_path_factory.mktemp("original") / "store"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(vars(taichi_nmm), "simulate", fake.simulate)
        precompute(fake.specification(robust=True), path)
    return path


@pytest.fixture
def folder(original, tmp_path):
    """A copy of it."""
    return Path(shutil.copytree(original, tmp_path / "store"))
