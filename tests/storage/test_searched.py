"""Stores whose points have low-level gains beside the 16 gains."""

from pathlib import Path

import numpy as np
import pytest

import taichi_nmm
from storage import merge, open_store
from storage.document import difference
from storage.points import sobol_points
from storage.precompute import precompute, score_shard
from taichi_nmm import walker_simulator
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import (
    GAIN_NAMES,
    GAINS,
    LOW_LEVEL_GAINS,
    LOW_LEVEL_NAMES,
)
from tests.storage import fake

THETA_REF = LOW_LEVEL_GAINS[-1]
POINT_3 = [
    5.53585406,
    1.44055244,
    1.84605681,
]  # of the sequence 7, row 16, before there were groups


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    precompute(fake.specification(searched=["theta_ref"], robust=True), tmp_path / "store")
    return tmp_path / "store"


def test_points_have_a_column_more(folder: Path) -> None:
    store = open_store(folder, verify=True)
    assert store.gain_names == (*GAIN_NAMES, "theta_ref")
    assert store.columns[:19] == ("row", *GAIN_NAMES, "theta_ref", "duration_s")
    points = store.gains()
    assert np.array_equal(points, sobol_points(7, 0, 50, (*GAINS, THETA_REF)))
    assert points.shape == (50, 17)
    angles = points[:, 16]
    assert THETA_REF.low <= angles.min() < 0 < np.deg2rad(25) < angles.max() <= THETA_REF.high
    merged = merge(folder, folder.with_name("merged.parquet"))
    assert np.array_equal(merged.gains(), points)


def test_points_of_plain_stores_are_what_they_were() -> None:
    np.testing.assert_allclose(sobol_points(7, 16, 1, GAINS)[0, :3], POINT_3, rtol=1e-8)
    plain = fake.specification()
    assert plain.simulator.parameters == GAINS
    assert fake.specification(searched=[]).hash == plain.hash


def test_the_document_says_what_is_searched_and_what_is_fixed() -> None:
    document = fake.specification(searched=["theta_ref"]).document
    assert list(document["gains"]) == [*GAIN_NAMES, "theta_ref"]
    assert document["gains"]["theta_ref"] == {"low": THETA_REF.low, "high": THETA_REF.high}
    assert list(document["low_level_gains"]) == list(LOW_LEVEL_NAMES[:-1])
    found = difference(fake.specification().document, document)
    assert found is not None and found[0] == "gains.theta_ref"


def test_order_in_the_configuration_does_not_matter() -> None:
    one = fake.specification(searched=["theta_ref", "k_oe"])
    assert one.hash == fake.specification(searched=["k_oe", "theta_ref"]).hash
    assert [parameter.name for parameter in one.simulator.searched] == ["k_oe", "theta_ref"]


def test_the_simulator_gets_each_walkers_low_level_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    specification = fake.specification(searched=["theta_ref"], robust=True)
    angles = []

    def spy(gains: np.ndarray, **options: object) -> object:
        assert gains.shape[1] == 16
        angles.append(options["low_level_gains"][:, 7])
        return fake.simulate(gains, **options)

    monkeypatch.setitem(vars(taichi_nmm), "simulate", spy)
    table, _ = score_shard(specification, 0, lambda _: None)
    expected, evaluated = (table[name].to_numpy() for name in ("theta_ref", "robust_evaluated"))
    assert np.array_equal(angles[0], expected)
    assert np.array_equal(angles[1], np.repeat(expected[evaluated], 6))


def test_other_bounds_of_a_searched_parameter_are_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = open_store(folder)
    store.require_bounds()
    monkeypatch.setattr(walker_simulator, "LOW_LEVEL_GAINS", LOW_LEVEL_GAINS[:-1])
    with pytest.raises(InputError) as caught:
        store.require_bounds()
    assert caught.value.field == "store.gains.theta_ref"
