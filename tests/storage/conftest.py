import pytest

import taichi_nmm
from tests.storage import fake


@pytest.fixture(autouse=True)
def fake_simulator(monkeypatch: pytest.MonkeyPatch) -> None:
    # Not setattr, which would look at the real one first and so load Taichi.
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake.simulate)
