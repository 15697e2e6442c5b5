"""Tables that other people wrote: each is read rightly, or refused in a line that says why."""

import bz2
import gzip
import lzma
from datetime import UTC, date, datetime, time, timedelta
from decimal import Decimal
from uuid import UUID

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from storage.foreign_tables import ForeignTable
from tests.cases import cases, refused

EUROPE = "\ufeffdose;cost;kind\r\n1;0,25;soft\r\n2;1,5;hard\r\n"


def read(path, **options):
    return ForeignTable.read("table", path, **options)


def of_text(folder, text, name="table.csv"):
    (folder / name).write_bytes(text.encode())
    return read(folder / name)


def of_columns(folder, **columns):
    pq.write_table(pa.table(columns), folder / "table.parquet")
    return read(folder / "table.parquet")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "dose,cost,kind\n1,0.25,soft\n2,1.5,hard\n"),
        ("a.csv", EUROPE),
        ("A.CSV", EUROPE),
        ("a.tsv", "dose\tcost\tkind\n1\t0.25\tsoft\n2\t1.5\thard\n"),
        ("a.log", EUROPE),
        ("a.tsv", "dose\tcost\tkind\n1\t0,25\tsoft\n2\t1,5\thard\n"),
        ("a.TXT", EUROPE),
        ("a.txt", "dose cost   kind\n1 0.25 soft\n 2 1.5 hard\n"),
        ("without", EUROPE),
        ("a.csv", "sep=;\ndose;cost;kind\n1;0,25;soft\n2;1,5;hard\n"),
        ("a.csv", '"dose","cost","kind"\n"1","0.25","soft"\n"2","1.5","hard"\n'),
        ("a.csv", "dose, cost, kind\n1, 0.25,soft\n2, 1.5,hard\n"),
        ("a.csv", "dose;cost;kind\n1;0,25;soft\n2;1,5;hard\n\n\n"),
        ("a.csv", "dose;cost;kind\r\n1;0,25;soft\r\n2;1,5;hard\r\n;;\r\n;;\r\n"),
        ("a.csv", "dose,cost,kind\r1,0.25,soft\r2,1.5,hard\r"),
    ],
)
def test_a_text_in_any_clear_dialect(tmp_path, name, text):
    table = of_text(tmp_path, text, name)
    assert table.names == ("dose", "cost", "kind")
    assert (
        table.values("dose").tolist() == [1, 2]
        and table.values("dose").dtype.kind == "i"
    )
    assert table.numbers("cost").tolist() == [0.25, 1.5]
    assert table.values("kind").tolist() == ["soft", "hard"]


@pytest.mark.parametrize(
    ("ending", "packed"),
    [
        (".csv.gz", gzip.compress),
        (".CSV.GZ", gzip.compress),
        (".csv.bz2", bz2.compress),
        (".csv.xz", lzma.compress),
    ],
)
def test_a_packed_text(tmp_path, ending, packed):
    path = tmp_path / f"table{ending}"
    path.write_bytes(packed(EUROPE.encode()))
    assert read(path).numbers("cost").tolist() == [0.25, 1.5]


def test_what_excel_calls_unicode_and_a_packed_parquet_file(tmp_path):
    (tmp_path / "excel.txt").write_bytes(EUROPE[1:].replace(";", "\t").encode("utf-16"))
    assert read(tmp_path / "excel.txt").numbers("cost").tolist() == [0.25, 1.5]
    of_columns(tmp_path, a=[1, 2], b=["x", "y"])
    whole = (tmp_path / "table.parquet").read_bytes()
    (tmp_path / "B.Parquet.GZ").write_bytes(gzip.compress(whole))
    assert read(tmp_path / "B.Parquet.GZ", columns=["b"]).values("b").tolist() == [
        "x",
        "y",
    ]
    (tmp_path / "named-so.csv").write_bytes(whole)
    assert read(tmp_path / "named-so.csv").numbers("a").tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (
            b"a,b\n1,5,2\n",
            "row 2 has 3 cells, and row 1, of names, 2; decimal commas need columns",
        ),
        (b"a\n1,5\n", "decimal commas need columns"),
        (b"a,b\n1,\xb5\n", "save it as CSV UTF-8"),
        (b"PK\x03\x04rest", "spreadsheet or a ZIP archive: save the table as CSV"),
        (b"a\0b\n", "it is no text"),
        (b"", "Empty CSV file"),
        (b"a,b;c,d\n1,2;3,4\n", "two of tabs, ; and ,"),
    ],
)
def test_a_text_that_cannot_be_read_in_one_way(tmp_path, content, said):
    (tmp_path / "table.csv").write_bytes(content)
    with refused(f"^table: '.*table.csv' .*{said}"):
        read(tmp_path / "table.csv")


@cases("bad-numbers.toml", "text", "said")
def test_a_column_that_has_no_numbers_in_one_reading(tmp_path, text, said):
    table = of_text(tmp_path, text)
    with refused(rf"^table(\.|: ){said}"):
        table.numbers("x")


def test_another_decimal_mark_than_the_rest_of_the_file_is_refused(tmp_path):
    table = of_text(tmp_path, "x;y\n1,5;1.234\n2,5;5.678\n")  # 1,234 or 1234?
    assert table.numbers("x").tolist() == [1.5, 2.5]
    with refused(r"table.y\[0\]: '1.234' .* the same decimal mark"):
        table.numbers("y")


@pytest.mark.parametrize("other", ["0.5", "1.25", "1.2340", "1.234e2"])
def test_points_are_decimal_where_one_of_the_file_can_be_nothing_else(tmp_path, other):
    table = of_text(tmp_path, f"x;y\n1.234;2\n5.678;{other}\n")
    assert table.numbers("x").tolist() == [1.234, 5.678]


def test_gaps_and_infinity(tmp_path):
    table = of_text(tmp_path, "x,y,z\n1,inf,\nNA,-Inf,\n3,nan,\n")
    assert np.array_equal(table.numbers("x"), [1.0, np.nan, 3.0], equal_nan=True)
    assert np.array_equal(table.numbers("y"), [np.inf, -np.inf, np.nan], equal_nan=True)
    assert np.isnan(table.numbers("z")).all()
    table = of_text(tmp_path, "x;y\n0,5;1\nNA;2\n1;3\n-1e-3;4\n")
    assert np.array_equal(
        table.numbers("x"), [0.5, np.nan, 1.0, -0.001], equal_nan=True
    )
    # no row of units: nothing else is a number
    table = of_columns(tmp_path, x=["s", None])
    with refused(r"table.x\[0\]: 's' .* one in each row$"):
        table.numbers("x")


def test_types_of_a_parquet_file(tmp_path):
    table = of_columns(
        tmp_path,
        decimal=pa.array([Decimal("1.5"), Decimal("1.75")], pa.decimal128(8, 2)),
        whole=pa.array([Decimal("3"), Decimal("4")], pa.decimal128(8, 0)),
        coded=pa.array(["a", "b"]).dictionary_encode(),
        view=pa.array(["a", "b"], pa.string_view()),
        flag=[True, False],
        maybe=[True, None],
        gap=pa.array([2**53, None]),
        none=pa.nulls(2),
        half=pa.array(np.array([0.5, 1.5], np.float16)),
        id=[2**60, 2**60 + 1],
    )
    assert table.values("decimal").tolist() == [1.5, 1.75]
    assert (
        table.values("whole").tolist() == [3, 4]
        and table.values("whole").dtype == np.int64
    )
    assert table.values("coded").tolist() == table.values("view").tolist() == ["a", "b"]
    assert table.values("flag").tolist() == [True, False]
    assert table.numbers("flag").tolist() == [1.0, 0.0]
    assert table.values("maybe").tolist() == [True, None]
    assert np.array_equal(table.numbers("maybe"), [1.0, np.nan], equal_nan=True)
    assert np.array_equal(table.values("gap"), [2.0**53, np.nan], equal_nan=True)
    assert (
        np.isnan(table.numbers("none")).all() and np.isnan(table.values("none")).all()
    )
    assert table.numbers("half").tolist() == [0.5, 1.5]
    # as choices they are what they are
    assert table.values("id").tolist() == [2**60, 2**60 + 1]
    with refused(r"table.id: .* whole numbers up to 2\^53"):
        table.numbers("id")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ([date(2026, 5, 4)], "'2026-05-04' .* of a date or a time make a number"),
        ([datetime(2026, 5, 4, 14, 30)], "'2026-05-04 14:30.* of a date or a time"),
        ([time(14, 30)], "'14:30.* of a date or a time"),
        ([timedelta(seconds=3)], "of a date or a time"),
        ([[1.0, 2.0]], "'list<.*a column of numbers, words or flags"),
        ([{"a": 1}], "'struct<.*a column of numbers, words or flags"),
        ([b"bytes"], "'binary'.*a column of numbers, words or flags"),
        ([Decimal(2**70)], "whole numbers within 2"),
    ],
)
def test_a_column_of_something_else_is_refused_by_name(tmp_path, values, said):
    table = of_columns(tmp_path, x=values, y=[1.0])
    for wanted in (table.values, table.numbers):
        with refused(f"^table.x: .*{said}"):
            wanted("x")
    assert table.numbers("y").tolist() == [1.0]


@pytest.mark.parametrize("strings", [["1.5", "2"], ["1", "2"]])
def test_words_that_look_like_numbers_are_none(tmp_path, strings):
    table = of_columns(tmp_path, x=strings)
    assert table.values("x").tolist() == strings
    with refused(r"table.x\[0\]: '1.* no words that look like them"):
        table.numbers("x")


MOMENT = datetime(2026, 5, 4, 14, 30)
LATER = [timedelta(0), timedelta(milliseconds=10), timedelta(hours=1)]
OF_A_DAY = [(MOMENT + t).time() for t in LATER]


@pytest.mark.parametrize(
    "values",
    [
        *[
            pa.array([MOMENT + t for t in LATER], pa.timestamp(unit))
            for unit in ("ms", "us", "ns")
        ],
        pa.array(
            [(MOMENT + t).replace(tzinfo=UTC) for t in LATER],
            pa.timestamp("us", "Asia/Tokyo"),
        ),
        *[pa.array(LATER, pa.duration(unit)) for unit in ("ms", "us", "ns")],
        *[pa.array(OF_A_DAY, kind) for kind in (pa.time64("us"), pa.time32("ms"))],
        pa.array([f"2026-05-04 {clock}" for clock in OF_A_DAY]),
        pa.array([*map(str, OF_A_DAY)]),
        pa.array(["14:30:00", "14:30:00,010000", "15:30:00"]),
        pa.array([1700000000.0, 1700000000.01, 1700003600.0]),
        pa.array([Decimal(0), Decimal("0.01"), Decimal(3600)]),
    ],
)
def test_a_clock_is_seconds_from_its_first_reading(tmp_path, values):
    table = of_columns(tmp_path, time=values)
    assert np.allclose(table.seconds("time"), [0.0, 0.01, 3600.0], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("readings", "seconds"),
    [
        ("2026-05-04 14:30:00.010 2026-05-04T14:30:01Z", None),
        ("14:30:00 14:30:02", 2.0),
        ("14:30:00.5 14:30:02", 1.5),
        ("2026-05-04T14:30:00.010 2026-05-04T14:30:00.510", 0.5),
        ("2026-05-04T14:30:00+02:00 2026-05-04T14:30:02+02:00", 2.0),
        ("100 102.5", 2.5),
        ("-1 0", 1.0),
    ],
)
def test_clocks_in_a_text(tmp_path, readings, seconds):
    table = of_text(
        tmp_path, "time,x\n" + "".join(f"{r},1\n" for r in readings.split())
    )
    if seconds is None:
        with refused(r"table.time\[0\]: '2026.* seconds, or times such as"):
            table.seconds("time")
    else:
        assert table.seconds("time").tolist() == [0.0, pytest.approx(seconds, abs=1e-9)]


@cases("bad-clocks.toml", "readings", "said")
def test_what_is_no_clock_is_refused(tmp_path, readings, said):
    table = of_text(
        tmp_path, "time,x\n" + "".join(f"{r},1\n" for r in readings.split())
    )
    with refused(rf"^table.{said}"):
        table.seconds("time")


def test_folders_of_parquet_as_hive_writes_them(tmp_path):
    for dose, kind in ((0.5, "a%20b"), (10, "c")):
        folder = tmp_path / f"dose={dose}" / f"kind={kind}"
        folder.mkdir(parents=True)
        pq.write_table(pa.table({"x": [dose, dose + 1.0]}), folder / "part-0.parquet")
    (tmp_path / "_temporary").mkdir()
    (tmp_path / "_temporary" / "part.parquet").write_text("half")
    (tmp_path / ".part.parquet").write_text("hidden")
    table = read(tmp_path, columns=["dose", "kind", "x"])
    assert table.numbers("x").tolist() == [0.5, 1.5, 10.0, 11.0]
    assert table.numbers("dose").tolist() == [0.5, 0.5, 10.0, 10.0]
    assert table.values("kind").tolist() == ["a b", "a b", "c", "c"]
    assert read(tmp_path).names == ("x", "dose", "kind")
    (tmp_path / "dose=3").mkdir()
    pq.write_table(pa.table({"x": [1.0]}), tmp_path / "dose=3" / "part-0.PARQUET")
    with refused("a folder whose files all lie in KEY=VALUE of dose, kind"):
        read(tmp_path)


def test_files_of_a_folder_may_have_whole_numbers_or_others(tmp_path):
    for part, values in enumerate(([1, 2], [2.5])):
        pq.write_table(pa.table({"x": values}), tmp_path / f"part-{part}.parquet")
    assert read(tmp_path).numbers("x").tolist() == [1.0, 2.0, 2.5]
    pq.write_table(pa.table({"x": ["word"]}), tmp_path / "part-2.parquet")
    with refused("files of the same columns"):
        read(tmp_path)


def test_other_columns_may_hold_anything(tmp_path):
    table = of_columns(
        tmp_path, x=[1.0], id=[UUID(int=3).bytes], when=[MOMENT], deep=[[{"a": 1}]]
    )
    assert table.numbers("x").tolist() == [1.0]


def test_words_are_read_as_words_where_they_are_wanted(tmp_path):
    (tmp_path / "table.csv").write_text("kind,note,x\n007,,1\n2026-05-04,nan,2\n")
    table = read(tmp_path / "table.csv", words=["kind", "note", "other"])
    assert table.values("kind").tolist() == ["007", "2026-05-04"]
    assert table.values("note").tolist() == ["", "nan"]
    assert table.numbers("x").tolist() == [1.0, 2.0]
