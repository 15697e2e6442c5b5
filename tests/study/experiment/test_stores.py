"""The stores that arms read: read once, and again only when they changed."""

from dataclasses import replace
from pathlib import Path

import pytest

from study.experiment import stores
from study.experiment.arms import ARMS
from study.experiment.experiment import Experiment
from study.sampler.table import FeatureTable
from taichi_nmm.errors import InputError
from tests.study import fake_walker

ARM = ARMS["score-first-diverse"]


def candidates(experiment: Experiment) -> FeatureTable:
    return stores.candidates(experiment, ARM.store, ARM.features)


def test_a_store_is_read_once_and_anew_when_it_was_made_anew(
    toy: Experiment, tmp_path: Path
) -> None:
    before = candidates(toy)
    assert candidates(toy) is before
    folder = toy.stores[ARM.store]
    folder.rename(tmp_path / "before")
    fake_walker.write_store(folder, samples=100)
    assert len(before) != len(candidates(toy))


def test_a_store_that_is_gone_is_one_line(toy: Experiment, tmp_path: Path) -> None:
    nowhere = dict.fromkeys(toy.stores, tmp_path / "nowhere")
    with pytest.raises(InputError, match="nowhere") as caught:
        candidates(replace(toy, stores=nowhere))
    assert "\n" not in str(caught.value)
