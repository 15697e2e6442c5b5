"""Tables of rows: from arrays, from stores, and refused."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from study import ScoreTable
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES, GAINS
from tests.study import fake_walker

TWO = {"a": [0.0, 1.0], "b": [5.0, 6.0]}


def test_arrays_make_rows_of_native_numbers() -> None:
    rows = ScoreTable.from_arrays(TWO, [1, 3]).rows
    assert rows.as_parameters(1) == {"a": 1.0, "b": 6.0}
    assert type(rows.as_parameters(1)["a"]) is float
    assert rows.standard_score.tolist() == [-1.0, 1.0]
    assert (rows.low.tolist(), rows.high.tolist()) == ([0.0, 5.0], [1.0, 6.0])


def test_rows_are_found_by_exact_values() -> None:
    rows = ScoreTable.from_arrays(TWO, [1, 3]).rows
    assert rows.find({"a": 1.0, "b": 6.0, "other": 2}) == 1
    assert rows.find({"a": 1.0, "b": np.nextafter(6.0, 7.0)}) is None
    assert rows.find({"a": 1.0}) is None


def test_a_constant_score_is_a_score() -> None:
    assert ScoreTable.from_arrays(TWO, [4, 4]).rows.standard_score.tolist() == [0.0, 0.0]


def test_a_store_gives_the_gains_and_a_score(store: Path) -> None:
    table = ScoreTable.from_store(store, score="phi_corrected")
    rows = table.rows
    assert len(table) == 200
    assert rows.names == GAIN_NAMES
    np.testing.assert_array_equal(rows.score, 50 * fake_walker.quality(rows.parameters))
    assert rows.low.tolist() == [gain.low for gain in GAINS]


def test_a_stored_table_pickles_without_its_rows(store: Path) -> None:
    table = ScoreTable.from_store(store)
    pickled = pickle.dumps(table)
    assert len(pickled) < 2000
    np.testing.assert_array_equal(pickle.loads(pickled).rows.parameters, table.rows.parameters)


def test_a_store_that_changed_since_is_refused(store: Path, tmp_path: Path) -> None:
    pickled = pickle.dumps(ScoreTable.from_store(store))
    store.rename(tmp_path / "old")
    fake_walker.write_store(store, points=100)
    with pytest.raises(InputError, match="the store this table was made from"):
        len(pickle.loads(pickled))


@pytest.mark.parametrize("score", ["phi", "K_GAS", "end_reason"])
def test_columns_that_are_no_score_are_refused(store: Path, score: str) -> None:
    with pytest.raises(InputError, match=score):
        ScoreTable.from_store(store, score=score)


@pytest.mark.parametrize(
    ("parameters", "score", "message"),
    [
        ({}, [1.0], "table.parameters"),
        ({"a": [0.0]}, [1.0, 2.0], "table.a.shape"),
        ({"a": [[0.0]]}, [1.0], "table.a.shape"),
        ({"a": []}, [], "table.a.shape"),
        ({"a": ["x"]}, [1.0], "table.a"),
        ({"a": [float("nan")]}, [1.0], r"table.a\[0\]"),
        ({"a": [0.0, 1.0]}, [1.0, float("inf")], r"table.score\[1\]"),
    ],
)
def test_bad_arrays_are_refused(
    parameters: dict[str, object], score: list[float], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        ScoreTable.from_arrays(parameters, score)


def test_rows_outside_the_bounds_are_refused() -> None:
    with pytest.raises(InputError, match=r"table.b\[1\]: 6.0 .* 0 to 5.5"):
        ScoreTable.from_arrays(TWO, [1, 3], bounds={"a": (0, 1), "b": (0, 5.5)})
    with pytest.raises(InputError, match=r"table.bounds"):
        ScoreTable.from_arrays(TWO, [1, 3], bounds={"a": (0, 1)})
