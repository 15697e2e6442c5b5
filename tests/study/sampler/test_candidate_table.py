"""Tables of rows: from arrays, frames and Parquet; imperfect ones, and refused ones."""

import pickle
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from study.sampler.table import FeatureTable
from taichi_nmm.errors import InputError

TWO = {"a": [0.0, 1.0], "b": [5.0, 6.0]}
MIXED = {"rate": [0.1, 0.01, 1.0], "units": [3, 1, 2], "kind": ["relu", "tanh", "relu"]}


def test_arrays_make_rows_of_native_values() -> None:
    rows = FeatureTable.from_arrays(MIXED, np.arange(6.0).reshape(3, 2), ["p", "q"]).rows
    assert rows.as_parameters(1) == {"rate": 0.01, "units": 1, "kind": "tanh"}
    assert [type(v) for v in rows.as_parameters(1).values()] == [float, int, str]
    assert rows.space.distributions == (
        FloatDistribution(0.01, 1.0),
        IntDistribution(1, 3),
        CategoricalDistribution(("relu", "tanh")),
    )
    assert rows.feature_names == ("p", "q")
    for by_order in (False, True):
        standard = rows.scale(by_order=by_order).standard(rows.features)
        assert_allclose(standard.mean(axis=0), 0.0, atol=1e-12)
        assert_allclose(standard.std(axis=0), 1.0)


def test_one_feature_may_be_a_column() -> None:
    rows = FeatureTable.from_arrays(TWO, [1, 3]).rows
    assert rows.feature_names == ("feature_0",)
    assert rows.standard.standard(rows.features).tolist() == [[-1.0], [1.0]]


def test_a_space_says_what_columns_cannot() -> None:
    given = {"rate": FloatDistribution(1e-3, 1.0, log=True), "units": FloatDistribution(0.0, 4.0)}
    rows = FeatureTable.from_arrays(MIXED, [1, 2, 3], space=given).rows
    assert rows.space.distributions[:2] == tuple(given.values())
    assert type(rows.as_parameters(0)["units"]) is float


def test_rows_are_found_by_exact_values() -> None:
    rows = FeatureTable.from_arrays(MIXED, [1, 3, 4]).rows
    assert rows.find({"rate": 1.0, "units": 2, "kind": "relu", "other": 2}) == 2
    assert rows.find({"rate": np.nextafter(1.0, 2.0), "units": 2, "kind": "relu"}) is None
    assert rows.find({"rate": 1.0, "units": 2, "kind": "gelu"}) is None
    assert rows.find({"rate": 1.0}) is None


def test_a_data_frame_gives_named_columns() -> None:
    frame = pd.DataFrame(MIXED | {"p": [1, 2, 4], "q": [0.5, np.nan, 1.5]})
    table = FeatureTable.from_dataframe(frame, parameters=list(MIXED), features=["p", "q"])
    assert table.rows.feature_names == ("p", "q")
    assert_allclose(table.rows.features, [[1.0, 0.5], [2.0, np.nan], [4.0, 1.5]])
    with pytest.raises(InputError, match="column: 'z'"):
        FeatureTable.from_dataframe(frame, parameters=["rate"], features=["z"])


def test_any_parquet_file_or_folder_will_do(tmp_path: Path) -> None:
    frame = pd.DataFrame(MIXED | {"p": [1.0, 2.0, 4.0]})
    for part in range(2):
        frame.assign(units=frame.units + 3 * part).to_parquet(tmp_path / f"part-{part}.parquet")
    whole = FeatureTable.from_parquet(tmp_path, features=["p"], parameters=list(MIXED))
    assert whole.rows.parameters[:, 1].tolist() == [3, 1, 2, 6, 4, 5]
    one = FeatureTable.from_parquet(
        tmp_path / "part-0.parquet", features=["p"], parameters=["rate"], bounds={"rate": (0, 2)}
    )
    assert one.rows.space.as_dict() == {"rate": FloatDistribution(0, 2)}
    assert len(pickle.dumps(whole)) < 2000
    assert pickle.loads(pickle.dumps(whole)).rows.as_parameters(4)["kind"] == "tanh"


@pytest.mark.parametrize(
    ("file", "parameters", "message"),
    [
        ("missing.parquet", ["rate"], "store: .*missing.parquet"),
        ("text.parquet", ["rate"], "store: .*a Parquet file"),
        ("good.parquet", ["speed"], "column: 'speed' .*rate"),
    ],
)
def test_bad_parquet_is_refused(
    tmp_path: Path, file: str, parameters: list[str], message: str
) -> None:
    (tmp_path / "text.parquet").write_text("no")
    pd.DataFrame(MIXED | {"p": [1.0, 2.0, 4.0]}).to_parquet(tmp_path / "good.parquet")
    with pytest.raises(InputError, match=message):
        FeatureTable.from_parquet(tmp_path / file, features=["p"], parameters=parameters)


def test_a_table_of_arrays_pickles_with_its_arrays_alone() -> None:
    column = np.arange(500.0)
    table = FeatureTable.from_arrays({"a": column, "b": column}, column)
    before = len(pickle.dumps(table))
    assert table.rows.offered.all() and table.rows.find({"a": 3.0, "b": 3.0}) == 3
    assert table.rows.unit.shape == (500, 2)
    assert len(pickle.dumps(table)) == before < 3 * column.nbytes + 2000
    assert pickle.loads(pickle.dumps(table)).rows.find({"a": 3.0, "b": 3.0}) == 3


def test_a_feature_without_information_weighs_nothing() -> None:
    features = np.column_stack([[1.0, 2.0, 3.0], [7.0] * 3, [np.nan] * 3])
    with pytest.warns(UserWarning, match="without information are ignored: feature_1, feature_2"):
        rows = FeatureTable.from_arrays(MIXED, features).rows
    for by_order in (False, True):
        assert_allclose(rows.scale(by_order=by_order).standard(rows.features)[:, 1:], 0.0)
    assert rows.offered.all()


def test_a_row_is_offered_with_half_of_its_informative_features() -> None:
    nan, inf = np.nan, np.inf
    features = [[nan, 1.0, 7.0], [2.0, nan, 7.0], [nan, nan, 7.0], [inf, -inf, nan]]
    with pytest.warns(UserWarning, match="1 rows that lack more than half .* ignored: feature_2"):
        table = FeatureTable.from_arrays({"a": np.arange(4.0)}, features)
    assert table.rows.offered.tolist() == [True, True, False, True]


def test_infinity_is_a_value_and_no_gap() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rows = FeatureTable.from_arrays({"a": np.arange(3.0)}, [np.inf, 0.0, -np.inf]).rows
    assert rows.offered.all()
    assert np.argsort(rows.scores.standard(rows.features)[:, 0]).tolist() == [2, 1, 0]


def test_repeated_rows_count_once() -> None:
    with pytest.warns(UserWarning, match="2 rows repeat the parameters of another"):
        table = FeatureTable.from_arrays({"a": [0.0, 1.0, 0.0, -0.0]}, [1, 2, 3, 4])
    assert table.rows.offered.tolist() == [True, True, False, False]
    assert table.rows.find({"a": 0.0}) == 0


def test_a_sound_table_makes_no_noise() -> None:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        FeatureTable.from_arrays(MIXED, [1, 2, 3])
    assert not said


def test_features_of_any_scale() -> None:
    tiny = FeatureTable.from_arrays(TWO, [1e-30, 3e-30]).rows
    huge = FeatureTable.from_arrays(TWO, [1e30, 3e30]).rows
    for by_order in (False, True):
        scales = [rows.scale(by_order=by_order) for rows in (tiny, huge)]
        assert_allclose(scales[0].standard(tiny.features), scales[1].standard(huge.features))


@pytest.mark.parametrize(
    ("parameters", "features", "message"),
    [
        ({}, [1.0], "table.parameters"),
        ({"a": [0.0]}, [1.0, 2.0], "table.a.shape"),
        ({"a": [[0.0]]}, [1.0], "table.a.shape"),
        ({"a": []}, [1.0], "table.a.shape"),
        ({"a": [float("nan")]}, [1.0], r"table.a\[0\]"),
        ({"a": [0.0, None]}, [1.0, 2.0], r"table.a\[1\]"),
        ({"a": [0.0]}, [], "table.features.shape"),
        ({"a": [0.0]}, [[[1.0]]], "table.features.shape"),
        ({"a": [0.0]}, ["x"], "table.features"),
    ],
)
def test_bad_arrays_are_refused(
    parameters: dict[str, object], features: list[float], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        FeatureTable.from_arrays(parameters, features)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bounds": {"a": (0, 1), "b": (0, 5.5)}}, r"table.b\[1\]: 6.0 .* 0 to 5.5"),
        ({"bounds": {"c": (0, 1)}}, "table.bounds: 'c'"),
        ({"bounds": {"a": (1, 0)}}, "table.bounds.a"),
        ({"space": {"c": FloatDistribution(0, 1)}}, "table.space: 'c'"),
        ({"space": {"a": FloatDistribution(0.5, 1)}}, r"table.a\[0\]: 0.0"),
        ({"space": {"a": FloatDistribution(0, 0.9, step=0.3)}}, r"table.a\[1\]: 1.0"),
        ({"space": {"a": CategoricalDistribution([0.0, 2.0])}}, r"table.a\[1\]: 1.0"),
        ({"feature_names": ["p", "q"]}, "table.feature_names"),
    ],
)
def test_rows_that_do_not_fit_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        FeatureTable.from_arrays(TWO, [1, 3], **options)


def test_rows_between_steps_are_refused() -> None:
    space = {"a": FloatDistribution(0, 1, step=0.25)}
    assert len(FeatureTable.from_arrays({"a": [0.25, 0.75]}, [1, 2], space=space)) == 2
    with pytest.raises(InputError, match=r"table.a\[1\]: 0.8"):
        FeatureTable.from_arrays({"a": [0.25, 0.8]}, [1, 2], space=space)


def test_a_file_that_changed_since_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.parquet"
    frame = pd.DataFrame(MIXED | {"p": [1.0, 2.0, 4.0]})
    frame.to_parquet(path)
    pickled = pickle.dumps(FeatureTable.from_parquet(path, features=["p"], parameters=list(MIXED)))
    frame.assign(p=[1.0, 2.0, 5.0]).to_parquet(path)
    with pytest.raises(InputError, match="the store this table was made from"):
        len(pickle.loads(pickled))
