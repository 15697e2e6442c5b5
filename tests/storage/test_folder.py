"""The document of a folder, written once, then the same or refused; and tables that carry it."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from storage import tables
from storage.inputs.errors import InputError
from storage.store import FOOTER_NEEDS, read_footer
from storage.tables import (
    read_columns,
    read_stamped,
    table_digest,
    write_stamped,
    write_table,
)
from study import FeatureTable
from study.report.runs import read_trials
from tests.cases import refused

OURS = {"seed": 1, "arms": {"dog": {"k": 1}}}
TABLE = pa.table({"arm": ["a", "b"], "cost": [1.0, 2.0], "walked": [True, False]})
FOLDER = {"seed": 1, "arms": {"dog": {}, "cat": {}}}


def agreed(path, document, *growing):
    return tables.agree(
        path / "experiment.json", document, growing=growing, remedy="another --out"
    )


def read(path):
    return json.loads((path / "experiment.json").read_text())


def test_a_new_folder_gets_the_document_and_an_old_one_keeps_it(tmp_path):
    assert agreed(tmp_path, OURS) == read(tmp_path) == OURS
    before = (tmp_path / "experiment.json").stat()
    assert agreed(tmp_path, OURS, "arms") == OURS
    assert (tmp_path / "experiment.json").stat() == before
    with pytest.raises(InputError) as caught:
        agreed(tmp_path, {"seed": 2, "arms": {}})
    path = tmp_path / "experiment.json"
    expected = f"seed: 2 cannot be used; allowed: 1, as {path} says; or another --out"
    assert str(caught.value) == expected
    assert read(tmp_path) == OURS


def test_growing_parts_are_gathered_and_sorted(tmp_path):
    agreed(tmp_path, OURS, "arms")
    more = OURS | {"arms": {"cmaes": {"k": 2}}}
    grown = {"seed": 1, "arms": {"cmaes": {"k": 2}, "dog": {"k": 1}}}
    assert agreed(tmp_path, more, "arms") == read(tmp_path) == grown
    assert list(read(tmp_path)["arms"]) == ["cmaes", "dog"]
    assert agreed(tmp_path, OURS, "arms") == read(tmp_path) == grown
    with pytest.raises(InputError) as caught:
        agreed(tmp_path, OURS | {"arms": {"dog": {"k": 3}}}, "arms")
    assert caught.value.field == "arms.dog.k" and read(tmp_path) == grown
    # One order in new and old folders: the footers of tables are compared byte by byte.
    (tmp_path / "experiment.json").unlink()
    unsorted = {"ground": {"kind": "rough", "amplitude_m": 0.08}}
    new = json.dumps(agreed(tmp_path, unsorted, "ground"))
    assert json.dumps(agreed(tmp_path, unsorted, "ground")) == new
    (tmp_path / "experiment.json").unlink()
    agreed(tmp_path, {"seed": 1})  # which lacks a part that grows
    assert agreed(tmp_path, OURS, "arms") == read(tmp_path) == OURS


@pytest.mark.parametrize("text", ["", "{", "[]", '{"seed": 1, "arms": 3}'])
def test_an_unreadable_document_is_refused(tmp_path, text):
    (tmp_path / "experiment.json").write_text(text)
    with refused(r"experiment|arms"):
        agreed(tmp_path, OURS)
    with refused("a readable experiment; or another --out"):
        agreed(tmp_path, OURS, "arms")


def test_it_comes_back_or_is_refused(tmp_path):
    path = tmp_path / "a.parquet"
    write_stamped(path, TABLE, FOLDER)
    assert read_stamped(path, FOLDER).equals(TABLE)
    fewer = {"seed": 1, "arms": {"dog": {}}}
    with refused(r"arms\.cat"):
        read_stamped(path, fewer)
    assert read_stamped(path, fewer, ("arms",)).equals(TABLE)
    digest = {tables.DIGEST_KEY: table_digest(TABLE.slice(1))}
    write_table(path, TABLE, FOLDER | digest)
    with refused("does not fit the digest"):
        read_stamped(path, FOLDER)
    words = pa.array([None, None], pa.dictionary(pa.int32(), pa.string()))
    write_table(path, pa.table({"arm": words}), FOLDER)
    with refused(r"a\.parquet' .* arm has no gaps"):
        read_stamped(path, FOLDER)


def test_the_digest_is_of_the_content_alone():
    pieces = pa.concat_tables([TABLE.slice(0, 1), TABLE.slice(1)])
    assert pieces["cost"].num_chunks == 2
    assert table_digest(pieces) == table_digest(TABLE)
    others = (
        TABLE.slice(0, 1),
        TABLE.take([1, 0]),
        TABLE.rename_columns(["arm", "price", "walked"]),
        TABLE.set_column(1, "cost", pa.array([1, 2])),
        TABLE.set_column(0, "arm", [["a", "c"]]),
        TABLE.set_column(2, "walked", pa.array([True, True])),
    )
    assert len({table_digest(each) for each in (TABLE, *others)}) == 7


@pytest.mark.parametrize("footer", [{}, {"seed": 2}, {"seed": 1, "arms": 3}])
def test_other_footers_are_one_line(tmp_path, footer):
    write_table(tmp_path / "a.parquet", TABLE, footer)
    with refused(r"a\.parquet' .* a file of this folder"):
        read_stamped(tmp_path / "a.parquet", FOLDER, ("arms",))


@pytest.mark.parametrize("read", [read_columns, read_footer])
def test_a_column_whose_name_is_no_text(tmp_path, read):
    path = tmp_path / "a.parquet"
    write_table(path, pa.table({"mean_speed": [1.0]}), dict.fromkeys(FOOTER_NEEDS, 1))
    path.write_bytes(path.read_bytes().replace(b"mean_speed", b"mean\x80speed"))
    with refused(r"a\.parquet.* can't decode byte 0x80"):
        read(path)


READERS = {
    "store": read_columns,
    "table": lambda path: (
        FeatureTable.from_parquet(path, parameters=["a"], features=["b"]).rows
    ),
    "trials": lambda path: read_trials(path, ["a", "b"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("reader", READERS)
def test_a_small_file_of_too_many_rows_is_not_unpacked(tmp_path, reader):
    """A value that is repeated for ever takes no room in a file, and all of it in memory."""
    path = tmp_path / "endless.parquet"
    some = pa.table(dict.fromkeys("ab", np.zeros(tables.MOST_ROWS // 10, np.int8)))
    with pq.ParquetWriter(path, some.schema) as writer:
        for _ in range(11):
            writer.write_table(some)
    assert path.stat().st_size < 1e6
    with refused("110,000,000 rows, and 100,000,000 are allowed"):
        READERS[reader](path)
