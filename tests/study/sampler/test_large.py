"""Tables larger than memory: what is in a file is what would be in memory."""

import errno
import mmap
import os
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest

from storage.precompute import precompute
from study import FeatureKernelSampler, FeatureTable
from study.sampler import transforms as large
from study.sampler.transforms import by_blocks, columns_of, new_matrix, rows_of, side_by_side
from taichi_nmm.errors import InputError
from tests.storage import fake

ROWS = 300


@pytest.fixture
def tiny_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large, "MOST_IN_MEMORY", 100)
    monkeypatch.setattr(large, "BLOCK", 64)


def in_a_file(matrix: Any) -> bool:
    while isinstance(matrix, np.ndarray):
        matrix = matrix.base
    return isinstance(matrix.obj if isinstance(matrix, memoryview) else matrix, mmap.mmap)


def test_matrices_in_files_are_matrices(tiny_memory: None) -> None:
    rng = np.random.default_rng(1)
    values, more = rng.uniform(size=(ROWS, 3)), rng.uniform(size=(ROWS, 2))
    matrix, other = new_matrix(ROWS, 3), new_matrix(ROWS, 2)
    for made, source in ((matrix, values), (other, more)):
        for column, content in zip(columns_of(made), source.T, strict=True):
            column[:] = content
    assert in_a_file(matrix) and not in_a_file(new_matrix(33, 3))
    assert np.array_equal(matrix, values)
    joined, doubled = side_by_side(matrix, other), by_blocks(lambda rows: 2.0 * rows, matrix)
    assert in_a_file(joined) and np.array_equal(joined, np.hstack([values, more]))
    assert in_a_file(doubled) and np.array_equal(doubled, 2.0 * values)
    for index in (np.array([5, 299, 5]), values[:, 0] > 0.5):
        assert np.array_equal(rows_of(matrix, index), values[index])


def proposals(table: FeatureTable, kernel: str) -> list[dict[str, Any]]:
    study = optuna.create_study(sampler=FeatureKernelSampler(table, seed=1, kernel=kernel))
    space = table.rows.space.as_dict()
    for _ in range(15):
        trial = study.ask(space)
        study.tell(trial, trial.params["a"] + trial.params["b"])
    return [trial.params for trial in study.trials]


def make() -> FeatureTable:
    rng = np.random.default_rng(2)
    a, b = rng.uniform(size=(2, ROWS))
    words = rng.choice(["x", "y"], ROWS)
    return FeatureTable.from_arrays({"a": a, "b": b, "c": words}, np.column_stack([a + b, a * b]))


@pytest.mark.parametrize("kernel", ["additive", "rbf"])
def test_a_large_table_is_proposed_from_like_a_small_one(
    kernel: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = make()
    expected, digest = proposals(small, kernel), small.rows.digest()
    monkeypatch.setattr(large, "MOST_IN_MEMORY", 100)
    table = make()
    assert in_a_file(table.rows.parameters) and not in_a_file(small.rows.parameters)
    assert proposals(table, kernel) == expected
    assert table.rows.digest() == digest
    assert table.rows.find(expected[3]) == small.rows.find(expected[3]) is not None


def test_a_store_is_read_file_by_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(vars(__import__("taichi_nmm")), "simulate", fake.simulate)
    precompute(fake.specification(), tmp_path / "store")

    def rows() -> Any:
        read = FeatureTable.from_parquet(tmp_path / "store", features=["phi_printed", "m1_mean"])
        return read.rows

    small = rows()
    monkeypatch.setattr(large, "MOST_IN_MEMORY", 100)
    assert in_a_file(rows().parameters) and rows().digest() == small.digest()


def test_no_space_for_a_large_table(tiny_memory: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(InputError, match=r"table: '300 rows' .* \(No space left on device\): TMPD"):
        make()
