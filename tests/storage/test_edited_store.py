"""Stores whose files somebody has edited: each is opened, or refused in one line."""

import json
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from storage import merge, open_store
from storage.document import document_hash
from storage.tables import FOOTER_KEY
from study import FeatureTable, covered_table, survival_table
from taichi_nmm.errors import InputError

Document = dict[str, Any]
WRONG: tuple[Any, ...] = (
    None, True, "a", "", "../outside.parquet", -1, 99, 1.5, 10**400, [], [None], {}, {"a": {}},
)  # fmt: skip


def edits(document: Any) -> Iterator[Any]:
    """The document with each of its values, however deep, replaced by each of `WRONG`, or gone."""
    for key in document if isinstance(document, dict) else range(min(len(document), 2)):
        value = document[key]
        for wrong in WRONG:
            yield _with(document, key, wrong)
        yield (
            {name: other for name, other in document.items() if name != key}
            if isinstance(document, dict)
            else document[:key] + document[key + 1 :]
        )
        if isinstance(value, dict | list):
            yield from (_with(document, key, changed) for changed in edits(value))


def _with(document: Any, key: Any, value: Any) -> Any:
    copied = document.copy()
    copied[key] = value
    return copied


def look_at(path: Path) -> None:
    """All that is done with a store."""
    store = open_store(path, verify=True)
    assert len(store) == len(store.table()) == len(store.gains())
    assert isinstance(store.families, tuple)
    store.require_bounds()
    FeatureTable.from_parquet(path, features=["phi_printed"])


def write_manifest(folder: Path, document: Document) -> None:
    (folder / "manifest.json").write_text(json.dumps(document))


def test_every_edit_of_a_manifest(folder: Path) -> None:
    whole = json.loads((folder / "manifest.json").read_text())
    small = whole | {"specification": "whole"}  # what is in it is the next test's
    count = refused = 0
    for document in edits(small):
        if document.get("specification") == "whole":
            document["specification"] = whole["specification"]
        write_manifest(folder, document)
        count += 1
        try:
            look_at(folder)
        except InputError as error:
            refused += 1
            assert str(error).isprintable()
            assert "manifest" in str(error) or "part-0000" in str(error) or "rows" in str(error)
    assert count > 100
    assert refused >= count - 1  # true counts as the format 1


def test_every_edit_of_a_footer(folder: Path) -> None:
    shard = folder / "part-00000.parquet"
    table = pq.read_table(shard, partitioning=None)
    footer = json.loads(table.schema.metadata[FOOTER_KEY])
    footer["specification"]["gains"] = dict(list(footer["specification"]["gains"].items())[-1:])
    path = folder / "edited.parquet"
    every = list(edits(footer))
    refused = 0
    for document in random.Random(1).sample(every, 150):
        specification = document.get("specification")
        if document.get("specification_hash") == footer["specification_hash"]:
            document = document | {"specification_hash": document_hash(specification)}
        pq.write_table(table.replace_schema_metadata({FOOTER_KEY: json.dumps(document)}), path)
        try:
            look_at(path)
        except InputError as error:
            refused += 1
            assert str(error).isprintable()
    assert refused > 100
    for read in (survival_table, covered_table):
        with pytest.raises(InputError):
            read(path)


def test_a_column_with_a_gap_is_refused(folder: Path) -> None:
    shard = folder / "part-00000.parquet"
    table = pq.read_table(shard, partitioning=None)
    place, flags = table.column_names.index("robust_evaluated"), table["robust_evaluated"]
    gap = pa.array([None, *flags.to_pylist()[1:]], flags.type)
    path = folder / "edited.parquet"
    pq.write_table(table.set_column(place, pa.field("robust_evaluated", flags.type), gap), path)
    with pytest.raises(InputError, match=r"edited\.parquet.*robust_evaluated has no gaps"):
        open_store(path).table()


def test_shards_lie_in_their_folder(folder: Path) -> None:
    shutil.copy(folder / "part-00001.parquet", folder.parent / "outside.parquet")
    text = (folder / "manifest.json").read_text()
    places = ("../outside.parquet", str(folder.parent / "outside.parquet"), "./part-00001.parquet")
    for place in places:
        (folder / "manifest.json").write_text(text.replace("part-00001.parquet", place))
        with pytest.raises(InputError, match="in the same folder"):
            open_store(folder)


def test_another_format_is_refused(folder: Path) -> None:
    path = folder / "manifest.json"
    path.write_text(path.read_text().replace('"format": 1', '"format": 99', 1))
    with pytest.raises(InputError, match="of format 99, not 1"):
        open_store(folder)
    shard = folder / "part-00000.parquet"
    table = pq.read_table(shard, partitioning=None)
    footer = table.schema.metadata[FOOTER_KEY].replace(b'"format": 1', b'"format": 99', 1)
    pq.write_table(table.replace_schema_metadata({FOOTER_KEY: footer}), shard)
    with pytest.raises(InputError, match="format 1, not 99"):
        open_store(shard)


@pytest.mark.parametrize(
    "name", ["", ".", "x" * 300, "nul\0", "\ud800", "missing/file", "file.txt/x"]
)
def test_merging_into_no_file(folder: Path, name: str) -> None:
    (folder / "file.txt").write_text("")
    before = sorted(folder.iterdir())
    with pytest.raises(InputError) as caught:
        merge(folder, folder / name if name else Path())
    assert str(caught.value).isprintable()
    assert sorted(folder.iterdir()) == before
