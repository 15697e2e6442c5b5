"""A store of gaits as a table: its parameters and bounds are known; what changed is refused."""

import pickle
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from optuna.distributions import FloatDistribution

import taichi_nmm
from storage import open_store
from storage.precompute import precompute
from study import FeatureTable
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, GAINS, LOW_LEVEL_GAINS
from tests.storage import fake
from tests.study import fake_walker


def test_a_store_gives_its_parameters_and_bounds(store: Path) -> None:
    table = FeatureTable.from_parquet(store, features=["phi_corrected", "mean_speed_mps"])
    rows = table.rows
    assert len(table) == 200
    assert rows.names == GAIN_NAMES
    quality = fake_walker.quality(rows.parameters)
    assert_allclose(rows.features, np.column_stack([np.round(50 * quality), 1.3 * quality]))
    assert rows.space.distributions == tuple(FloatDistribution(g.low, g.high) for g in GAINS)


def test_a_store_of_more_parameters_gives_them_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake.simulate)
    up = fake.family(settings=2, kind="ramp")
    precompute(fake.specification(searched=["theta_ref"], families={"up": up}), tmp_path / "store")
    table = FeatureTable.from_parquet(
        tmp_path / "store", features=["up_survived_fraction_mean", "phi_printed"]
    )
    rows = table.rows
    theta_ref = LOW_LEVEL_GAINS[-1]
    assert rows.names == (*GAIN_NAMES, "theta_ref")
    assert rows.space.distributions[-1] == FloatDistribution(theta_ref.low, theta_ref.high)
    assert np.array_equal(rows.parameters, open_store(tmp_path / "store").gains())
    assert rows.find(rows.as_parameters(11)) == 11
    assert rows.as_parameters(11)["theta_ref"] == rows.parameters[11, 16]
    with pytest.raises(InputError, match="theta_ref"):
        FeatureTable.from_parquet(tmp_path / "store", features=["theta_ref"])


def test_a_stored_table_pickles_without_its_rows(store: Path) -> None:
    table = FeatureTable.from_parquet(store, features=["phi_printed"])
    pickled = pickle.dumps(table)
    assert len(pickled) < 2000
    np.testing.assert_array_equal(pickle.loads(pickled).rows.parameters, table.rows.parameters)


def test_a_store_that_changed_since_is_refused(store: Path, tmp_path: Path) -> None:
    pickled = pickle.dumps(FeatureTable.from_parquet(store, features=["phi_printed"]))
    store.rename(tmp_path / "old")
    fake_walker.write_plain_store(store, samples=100)
    with pytest.raises(InputError, match="the store this table was made from"):
        len(pickle.loads(pickled))


@pytest.mark.parametrize("feature", ["phi", "K_GAS", "end_reason"])
def test_columns_that_are_no_feature_are_refused(store: Path, feature: str) -> None:
    with pytest.raises(InputError, match=feature):
        FeatureTable.from_parquet(store, features=[feature])


def test_parameters_that_are_named_need_no_store(tmp_path: Path) -> None:
    path = tmp_path / "table.parquet"
    pd.DataFrame({"rate": [0.1, 0.2], "p": [1.0, 2.0]}).to_parquet(path)
    table = FeatureTable.from_parquet(path, parameters=["rate"], features=["p"])
    assert isinstance(table, FeatureTable) and isinstance(table, FeatureTable)
    again = pickle.loads(pickle.dumps(table))
    assert type(again) is FeatureTable
    assert again.rows.as_parameters(1) == {"rate": 0.2}


def test_arrays_make_a_table_of_this_kind() -> None:
    assert type(FeatureTable.from_arrays({"a": [0.0, 1.0]}, [1, 2])) is FeatureTable


@pytest.mark.parametrize("parameters", [None, ["K_GAS"]])
def test_a_table_of_no_features_is_refused(store: Path, parameters: list[str] | None) -> None:
    with pytest.raises(InputError, match="features: 'none'"):
        FeatureTable.from_parquet(store, features=[], parameters=parameters)
