"""A store written by version 0.1.0 must open in every later one.

It was made by tools/precompute.py from samples = 20, shard_rows = 12, seed = 1, on one CPU.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest

from storage import merge, open_store
from storage.precompute import precompute
from storage.specification import read_specification
from taichi_nmm.config import Table
from taichi_nmm.errors import InputError

OLD_STORE = Path(__file__).parents[1] / "assets" / "store-v1"
COMPLETED_POINTS = 2
PHI_PRINTED_SUM = 88.49891221523285


def test_the_old_folder_opens_and_is_undamaged() -> None:
    store = open_store(OLD_STORE, verify=True)
    rows = store.numpy()
    assert rows["row"].tolist() == list(range(20))
    assert store.specification["code_version"] == "0.1.0"
    assert [footer["rows"] for footer in store.footers] == [12, 8]
    assert {footer["engine"] for footer in store.footers} == {"taichi"}


def test_the_old_numbers_are_what_they_were() -> None:
    rows = open_store(OLD_STORE).numpy()
    assert rows["end_reason"].tolist().count("completed") == COMPLETED_POINTS
    assert rows["phi_printed"].sum() == pytest.approx(PHI_PRINTED_SUM, rel=1e-12)
    bounds = open_store(OLD_STORE).specification["gains"]
    for name, bound in bounds.items():
        assert np.all((bound["low"] <= rows[name]) & (rows[name] <= bound["high"]))


def test_an_old_shard_and_a_merged_file_of_it_open(tmp_path: Path) -> None:
    assert len(open_store(OLD_STORE / "part-00001.parquet", verify=True)) == 8
    merged = merge(OLD_STORE, tmp_path / "merged.parquet")
    assert merged.table().equals(open_store(OLD_STORE).table().combine_chunks())


def test_a_store_of_another_version_is_not_resumed(tmp_path: Path) -> None:
    """It is still read, but the numbers of two simulators do not mix."""
    folder = shutil.copytree(OLD_STORE, tmp_path / "store")
    request = read_specification(Table({"samples": 20, "shard_rows": 12, "seed": 1}))
    with pytest.raises(InputError, match=r"code_version.*0\.1\.0") as caught:
        precompute(request, folder, fresh=False)
    assert "\n" not in str(caught.value)
    assert open_store(folder).table().equals(open_store(OLD_STORE).table())
