"""The picture of a store: dots by origin, a panel a family, and a line where there is none."""

from pathlib import Path

import numpy as np
import pytest

import taichi_nmm
from storage import open_store
from storage.precompute import precompute
from study.commands.draw_store import dots, draw_store
from taichi_nmm.errors import InputError
from tests.storage import fake


@pytest.fixture(autouse=True)
def fake_simulator(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake.simulate)


def test_a_panel_a_family_and_a_dot_a_row_that_was_run(tmp_path: Path) -> None:
    families = {"up": fake.family(settings=2, kind="ramp")}
    precompute(fake.specification(robust=True, families=families), tmp_path / "store")
    store = open_store(tmp_path / "store")
    ((origin, speed, survived),) = dots(store, "up")
    run = store.numpy(["up_evaluated"])["up_evaluated"]
    assert origin == "sobol" and len(speed) == len(survived) == np.count_nonzero(run) > 0
    panels = [axes for axes in draw_store(store).axes if axes.axison]
    assert [axes.get_title() for axes in panels] == ["robust", "up"]
    precompute(fake.specification(), tmp_path / "plain")
    with pytest.raises(InputError, match="families"):
        draw_store(open_store(tmp_path / "plain"))
