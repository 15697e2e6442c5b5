"""Tables of rows: from arrays, frames, Parquet and stores; imperfect, refused, pickled, shown."""

import pickle
from decimal import Decimal

import numpy as np
import optuna
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from optuna.distributions import (
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

import taichi_nmm
from storage import open_store
from storage.precompute import precompute
from study import DoGSampler, FeatureTable
from taichi_nmm.parameters import GAIN_NAMES, GAINS, LOW_LEVEL_GAINS
from tests.storage import fake
from tests.study import fake_walker
from tests.study.conftest import refused
from tests.study.sampler.studies import rows_of, study_of

TWO = {"a": [0.0, 1.0], "b": [5.0, 6.0]}
MIXED = {"rate": [0.1, 0.01, 1.0], "units": [3, 1, 2], "kind": ["relu", "tanh", "relu"]}


def test_arrays_make_rows_of_native_values():
    rows = FeatureTable.from_arrays(
        MIXED, np.arange(6.0).reshape(3, 2), ["p", "q"]
    ).rows
    assert rows.as_parameters(1) == {"rate": 0.01, "units": 1, "kind": "tanh"}
    assert [type(v) for v in rows.as_parameters(1).values()] == [float, int, str]
    own = FloatDistribution(0.01, 1.0), IntDistribution(1, 3)
    assert rows.space.distributions == (*own, CategoricalDistribution(("relu", "tanh")))
    assert rows.feature_names == ("p", "q")
    for by_order in (False, True):
        standard = rows.scale(by_order=by_order).standard(rows.features)
        assert_allclose(standard.mean(axis=0), 0.0, atol=1e-12)
        assert_allclose(standard.std(axis=0), 1.0)
    rows = FeatureTable.from_arrays(TWO, [1, 3]).rows  # one feature may be a column
    assert rows.feature_names == ("feature_0",)
    assert rows.standard.standard(rows.features).tolist() == [[-1.0], [1.0]]
    given = {
        "rate": FloatDistribution(1e-3, 1.0, log=True),
        "units": FloatDistribution(0.0, 4.0),
    }
    rows = FeatureTable.from_arrays(MIXED, [1, 2, 3], space=given).rows
    assert rows.space.distributions[:2] == tuple(given.values())
    assert type(rows.as_parameters(0)["units"]) is float
    space = {"a": FloatDistribution(0.1, 1.1, step=0.25)}
    assert len(FeatureTable.from_arrays({"a": [0.35, 0.85]}, [1, 2], space=space)) == 2


def test_rows_are_found_by_their_values():
    rows = FeatureTable.from_arrays(MIXED, [1, 3, 4]).rows
    assert rows.find({"rate": 1.0, "units": 2, "kind": "relu", "other": 2}) == 2
    assert rows.find({"rate": np.nextafter(1.0, 2.0), "units": 2, "kind": "relu"}) == 2
    assert rows.find({"rate": 1.000001, "units": 2, "kind": "relu"}) is None
    assert rows.find({"rate": 1.0, "units": 2, "kind": "gelu"}) is None
    assert rows.find({"rate": 1.0}) is None


def test_a_data_frame_gives_named_columns():
    frame = pd.DataFrame(MIXED | {"p": [1, 2, 4], "q": [0.5, np.nan, 1.5]})
    table = FeatureTable.from_dataframe(
        frame, parameters=list(MIXED), features=["p", "q"]
    )
    assert table.rows.feature_names == ("p", "q")
    assert_allclose(table.rows.features, [[1.0, 0.5], [2.0, np.nan], [4.0, 1.5]])


def test_any_parquet_file_or_folder_will_do(tmp_path):
    frame = pd.DataFrame(MIXED | {"p": [1.0, 2.0, 4.0]})
    for part in range(2):
        own = frame.assign(units=frame.units + 3 * part)
        own.to_parquet(tmp_path / f"part-{part}.parquet")
    whole = FeatureTable.from_parquet(tmp_path, features=["p"], parameters=list(MIXED))
    assert whole.rows.parameters[:, 1].tolist() == [3, 1, 2, 6, 4, 5]
    given = {"features": ["p"], "parameters": ["rate"], "bounds": {"rate": (0, 2)}}
    one = FeatureTable.from_parquet(tmp_path / "part-0.parquet", **given)
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
def test_bad_parquet_is_refused(tmp_path, file, parameters, message):
    (tmp_path / "text.parquet").write_text("no")
    pd.DataFrame(MIXED | {"p": [1.0, 2.0, 4.0]}).to_parquet(tmp_path / "good.parquet")
    with refused(message):
        FeatureTable.from_parquet(
            tmp_path / file, features=["p"], parameters=parameters
        )


def test_a_table_of_arrays_pickles_with_its_arrays_alone():
    column = np.arange(500.0)
    table = FeatureTable.from_arrays({"a": column, "b": column}, column)
    before = len(pickle.dumps(table))
    assert table.rows.offered.all() and table.rows.find({"a": 3.0, "b": 3.0}) == 3
    assert table.rows.unit.shape == (500, 2)
    assert len(pickle.dumps(table)) == before < 3 * column.nbytes + 2000
    assert pickle.loads(pickle.dumps(table)).rows.find({"a": 3.0, "b": 3.0}) == 3


def test_a_feature_without_information_weighs_nothing_and_half_of_the_others_offer_a_row():
    features = np.column_stack([[1.0, 2.0, 3.0], [7.0] * 3, [np.nan] * 3])
    with pytest.warns(
        UserWarning, match="without information are ignored: feature_1, feature_2"
    ):
        rows = FeatureTable.from_arrays(MIXED, features).rows
    for by_order in (False, True):
        assert_allclose(
            rows.scale(by_order=by_order).standard(rows.features)[:, 1:], 0.0
        )
    assert rows.offered.all()
    nan, inf = np.nan, np.inf
    features = [[nan, 1.0, 7.0], [2.0, nan, 7.0], [nan, nan, 7.0], [inf, -inf, nan]]
    with pytest.warns(
        UserWarning, match="1 rows that lack more than half .* ignored: feature_2"
    ):
        table = FeatureTable.from_arrays({"a": np.arange(4.0)}, features)
    assert table.rows.offered.tolist() == [True, True, False, True]


def test_repeated_rows_count_once():
    with pytest.warns(UserWarning, match="2 rows repeat the parameters of another"):
        table = FeatureTable.from_arrays({"a": [0.0, 1.0, 0.0, -0.0]}, [1, 2, 3, 4])
    assert table.rows.offered.tolist() == [True, True, False, False]
    assert table.rows.find({"a": 0.0}) == 0


def test_features_of_any_scale():
    tiny = FeatureTable.from_arrays(TWO, [1e-30, 3e-30]).rows
    huge = FeatureTable.from_arrays(TWO, [1e30, 3e30]).rows
    for by_order in (False, True):
        scales = [rows.scale(by_order=by_order) for rows in (tiny, huge)]
        assert_allclose(
            scales[0].standard(tiny.features), scales[1].standard(huge.features)
        )


@pytest.mark.parametrize(
    ("parameters", "features", "options", "message"),
    [
        ({}, [1.0], {}, "table.parameters"),
        ({"a": [0.0]}, [1.0, 2.0], {}, "table.a.shape"),
        ({"a": [[0.0]]}, [1.0], {}, "table.a.shape"),
        ({"a": []}, [1.0], {}, "table.a.shape"),
        ({"a": [0.0]}, [], {}, "table.features.shape"),
        ({"a": [0.0]}, [[[1.0]]], {}, "table.features.shape"),
        (
            TWO,
            [1, 3],
            {"bounds": {"a": (0, 1), "b": (0, 5.5)}},
            r"table.b\[1\]: 6.0 .* 0 to 5.5",
        ),
        (TWO, [1, 3], {"bounds": {"c": (0, 1)}}, "table.bounds: 'c'"),
        (
            {"a": ["0.5", "0.7", "1O"]},
            [1, 3, 5],
            {},
            r"table.a\[0\]: '0.5' .*row 2 has '1O'",
        ),
        (
            {"a": ["r\u00f6t", "blue", "ro\u0308t "]},
            [1, 3, 5],
            {},
            r"table.a\[2\]: .* in row 0",
        ),
        ({"a": pd.array([1, None], dtype="Int64")}, [1, 3], {}, r"table.a\[1\]: nan"),
        ({"a": [Decimal(2**60)]}, [1], {}, r"table.a\[0\]: 115.* up to 2\^53"),
        (TWO, [1, 3], {"bounds": {"a": (1, 0)}}, "table.bounds.a"),
        (
            MIXED,
            [1, 2, 3],
            {"bounds": {"kind": (1, 2)}},
            "table.bounds.kind: .* categorical",
        ),
        (TWO, [1, 3], {"space": {"c": FloatDistribution(0, 1)}}, "table.space: 'c'"),
        (
            TWO,
            [1, 3],
            {"space": {"a": FloatDistribution(0.5, 1)}},
            r"table.a\[0\]: 0.0 .* 0.5 to 1",
        ),
    ],
)
def test_bad_arrays_are_refused(parameters, features, options, message):
    with refused(message):
        FeatureTable.from_arrays(parameters, features, **options)


# Choices and gaps.
@pytest.mark.parametrize(
    ("values", "choices"),
    [
        (["sqrt", None, "log2"], [None, "sqrt", "log2"]),
        ([True, None, False], [None, True, False]),
        (["scale", 0.1, 1], [0.1, 1, "scale"]),
    ],
)
def test_none_and_numbers_among_words_are_choices(values, choices):
    table = FeatureTable.from_arrays({"kind": values}, [1.0, 2.0, 4.0])
    study = study_of(
        table, lambda trial: trial.suggest_categorical("kind", choices) is None, 3
    )
    assert {trial.params["kind"] for trial in study.trials} == set(values)
    assert sorted(rows_of(study)) == [0, 1, 2]


@pytest.mark.parametrize("values", [[3, None, 5], [None, None], ["x", float("nan")]])
def test_what_may_be_a_gap_names_the_way_to_make_it_a_choice(values):
    with refused(r"table.depth\[\d\]: .* None .*space=\{'depth': "):
        FeatureTable.from_arrays({"depth": values}, np.arange(float(len(values))))


@pytest.mark.parametrize(
    "values", [[3, None, 5], [3.0, float("nan"), 5.0], ["x", None, "y"]]
)
def test_given_as_a_choice_a_gap_is_none(values):
    choices = [None if value is None or value != value else value for value in values]
    frame = pd.DataFrame({"depth": values, "feature": [1.0, 2.0, 3.0]})
    named = {"parameters": ["depth"], "features": ["feature"]}
    space = {"depth": CategoricalDistribution(choices)}
    given = FeatureTable.from_dataframe(frame, space=space, **named)
    assert [given.rows.as_parameters(row)["depth"] for row in range(3)] == choices


# Stores.
def test_a_store_gives_its_parameters_and_bounds(store):
    table = FeatureTable.from_parquet(
        store, features=["phi_corrected", "mean_speed_mps"]
    )
    rows = table.rows
    assert len(table) == 200
    assert rows.names == GAIN_NAMES
    quality = fake_walker.quality(rows.parameters)
    assert_allclose(
        rows.features, np.column_stack([np.round(50 * quality), 1.3 * quality])
    )
    assert rows.space.distributions == tuple(
        FloatDistribution(g.low, g.high) for g in GAINS
    )


def test_a_store_of_more_parameters_gives_them_all(tmp_path, monkeypatch):
    monkeypatch.setitem(vars(taichi_nmm), "simulate", fake.simulate)
    families, path = {"up": fake.family(settings=2, kind="ramp")}, tmp_path / "store"
    precompute(fake.specification(searched=["theta_ref"], families=families), path)
    features = ["up_survived_fraction_mean", "phi_printed"]
    rows = FeatureTable.from_parquet(path, features=features).rows
    theta_ref = LOW_LEVEL_GAINS[7]
    assert rows.names == (*GAIN_NAMES, "theta_ref")
    assert rows.space.distributions[-1] == FloatDistribution(
        theta_ref.low, theta_ref.high
    )
    assert np.array_equal(rows.parameters, open_store(path).points())
    assert rows.find(rows.as_parameters(11)) == 11
    assert rows.as_parameters(11)["theta_ref"] == rows.parameters[11, 16]
    with refused("theta_ref"):
        FeatureTable.from_parquet(path, features=["theta_ref"])


def test_a_stored_table_pickles_without_its_rows_and_is_refused_after_a_change(
    store, tmp_path
):
    table = FeatureTable.from_parquet(store, features=["phi_printed"])
    pickled = pickle.dumps(table)
    assert len(pickled) < 2000
    assert_array_equal(pickle.loads(pickled).rows.parameters, table.rows.parameters)
    sampler = DoGSampler(table, seed=1)
    optuna.create_study(sampler=sampler).ask()
    assert len(pickle.dumps(sampler)) < 6000
    store.rename(tmp_path / "old")
    fake_walker.write_plain_store(store, samples=100)
    with refused("the store this table was made from"):
        len(pickle.loads(pickled))


@pytest.mark.parametrize(
    ("features", "options", "message"),
    [
        (["phi"], {}, "phi"),
        (["K_GAS"], {}, "K_GAS"),
        (["end_reason"], {}, "end_reason"),
        ([], {}, "features: 'none'"),
        ([], {"parameters": ["K_GAS"]}, "features: 'none'"),
    ],
)
def test_columns_that_are_no_feature_or_none_are_refused(
    store, features, options, message
):
    with refused(message):
        FeatureTable.from_parquet(store, features=features, **options)


# What a table looks like at a prompt.
@pytest.mark.filterwarnings("ignore:FeatureTable")
@pytest.mark.parametrize(
    ("rows", "parameters", "features", "shown"),
    [
        (600, 2, 3, "600 rows, 2 parameters, 3 features: a, b, c"),
        (1, 1, 2, "1 row, 1 parameter, 2 features: a, b"),
    ],
)
def test_a_table_shows_its_size_and_features(rows, parameters, features, shown):
    columns = {f"x{i}": np.linspace(0, 1, rows) for i in range(parameters)}
    values = np.random.default_rng(0).random((rows, features))
    made = FeatureTable.from_arrays(columns, values, list("abcdef"[:features]))
    assert repr(made) == f"FeatureTable({shown})"


def test_a_table_that_travelled_is_not_read_again_to_be_shown(tmp_path):
    path = tmp_path / "table.parquet"
    pd.DataFrame({"x": [0.0, 1.0], "f": [1.0, 2.0]}).to_parquet(path)
    made = pickle.dumps(
        FeatureTable.from_parquet(path, features=["f"], parameters=["x"])
    )
    path.unlink()
    assert repr(pickle.loads(made)) == "FeatureTable(2 rows, 1 parameter, 1 feature: f)"
