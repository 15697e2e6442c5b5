"""The stores that arms read: opened once, and again only when they changed."""

from dataclasses import replace
from pathlib import Path

import pytest

from storage.store import Store, open_store
from study.experiment import stores
from study.experiment.arms import ARMS
from study.experiment.experiment import Experiment
from study.sampler.table import FeatureTable
from taichi_nmm.errors import InputError
from tests.study import fake_walker

ARM = ARMS["score-first-diverse"]


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Stores that were opened, one after the other."""
    paths: list[Path] = []

    def noting(path: Path) -> Store:
        paths.append(path)
        return open_store(path)

    monkeypatch.setattr(stores, "open_store", noting)
    return paths


def candidates(experiment: Experiment) -> FeatureTable:
    return stores.candidates(experiment, ARM.store, ARM.features)


def test_a_store_that_stands_is_opened_once(
    fake_simulator: None, tmp_path: Path, opened: list[Path]
) -> None:
    experiment = fake_walker.experiment(tmp_path)
    assert candidates(experiment) is candidates(experiment)
    assert len(opened) == 1


def test_a_store_made_anew_is_read_anew(
    fake_simulator: None, tmp_path: Path, opened: list[Path]
) -> None:
    experiment = fake_walker.experiment(tmp_path)
    before = candidates(experiment)
    folder = experiment.stores[ARM.store]
    folder.rename(tmp_path / "before")
    fake_walker.write_store(folder, samples=100)
    assert len(before) != len(candidates(experiment))
    assert len(opened) == 2


def test_a_store_that_is_gone_is_one_line(
    fake_simulator: None, tmp_path: Path, opened: list[Path]
) -> None:
    experiment = fake_walker.experiment(tmp_path)
    nowhere = dict.fromkeys(experiment.stores, tmp_path / "nowhere")
    with pytest.raises(InputError, match="nowhere") as caught:
        candidates(replace(experiment, stores=nowhere))
    assert "\n" not in str(caught.value)
