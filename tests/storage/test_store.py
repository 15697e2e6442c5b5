"""Stores are read: whole, a shard, merged, unfinished, damaged, edited, or of an old version."""

import pickle
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from storage import merge, open_store
from storage.inputs.config import Table
from storage.precompute import precompute
from storage.specification import read_specification
from storage.tables import FOOTER_KEY
from taichi_nmm import GAIN_NAMES, GAINS, InputError, walker_simulator
from tests.cases import refused
from tests.processes import printed
from tests.storage import fake

SHARD = "part-00003.parquet"
FOOTERS = ["3", "{", '{"rows": 1}', '{"rows": 1, "specification": 4}']
OLD_STORE = Path(__file__).parents[1] / "assets" / "store-v1"


def test_arrow_and_numpy_agree(folder):
    store = open_store(folder, verify=True)
    table, rows = store.table(), store.numpy()
    assert len(store) == len(table) == len(rows) == 50
    assert list(store.columns) == table.column_names == list(rows.dtype.names)
    assert pickle.loads(pickle.dumps(store)).table() == table
    for name in store.columns:
        values = np.array(table[name].to_pylist())
        assert np.array_equal(values, rows[name])
    assert rows["row"].tolist() == list(range(50))
    assert rows["end_reason"].dtype.kind == "U"
    assert rows["step_count"].dtype == np.int32
    assert rows["robust_evaluated"].dtype == np.bool_
    names = ("phi_printed", "row")
    assert store.table(names).column_names == list(names)
    assert store.numpy(names).dtype.names == names
    with refused("column: 'phi'"):
        store.table(["phi"])


def test_one_shard_opens_alone(folder, tmp_path):
    for path in (folder / "part-00001.parquet", tmp_path / "taken-out.parquet"):
        if not path.exists():
            shutil.copy(folder / "part-00001.parquet", path)
        store = open_store(path, verify=True)
        assert store.numpy(["row"])["row"].tolist() == list(range(8, 16))
        assert store.specification == fake.specification(robust=True).document
    renamed = folder.rename(folder.with_name("seed=3"))
    assert "seed" not in open_store(renamed).table().column_names


def test_merged_file_holds_the_same_rows(folder, tmp_path):
    merged = merge(folder, tmp_path / "merged.parquet")
    assert merged.table() == open_store(folder).table().combine_chunks()
    footer = merged.footers[0]
    assert (footer["rows"], footer["shard"]) == (50, list(range(7)))
    assert (footer["arch"], footer["engine"]) == ("cpu", "fake")
    assert (
        open_store(tmp_path / "merged.parquet", verify=True).columns == merged.columns
    )
    merge(folder, tmp_path / "again.parquet")
    files = [tmp_path / name for name in ("merged.parquet", "again.parquet")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_shards_of_an_unfinished_store_are_taken_where_wanted(folder, tmp_path):
    whole = open_store(folder)
    assert open_store(folder, unfinished=True) == whole
    table, first = whole.table(), whole.footers[0]["rows"]
    (folder / "manifest.json").unlink()
    whole.files[0].unlink()
    rest = open_store(folder, unfinished=True)
    assert rest.files == whole.files[1:]
    assert rest.table().equals(table.slice(first))
    precompute(fake.specification(), tmp_path / "other")
    shutil.copy(tmp_path / "other" / "part-00000.parquet", folder)
    with refused("shards of one store"):
        open_store(folder, unfinished=True)
    for file in folder.glob("part-*"):
        file.unlink()
    with refused("has finished a shard"):
        open_store(folder, unfinished=True)


def manifest(old, new):
    """An edit of a store's manifest, beside which lies a shard that is no part of it."""

    def edit(folder):
        path, outside = folder / "manifest.json", folder.parent / "outside.parquet"
        shutil.copy(folder / "part-00001.parquet", outside)
        path.write_text(
            path.read_text().replace(old, new.replace("OUTSIDE", str(outside)), 1)
        )

    return edit


def without_a_column(folder):
    table = pq.read_table(folder / SHARD, partitioning=None)
    pq.write_table(table.drop_columns(["phi_printed"]), folder / SHARD)


REFUSED = {
    "no folder": (shutil.rmtree, "which `precompute` makes .No such file"),
    "no manifest": (
        lambda folder: (folder / "manifest.json").unlink(),
        "a finished store",
    ),
    "an edited specification": (
        manifest('"seed": 7', '"seed": 9'),
        "an undamaged manifest",
    ),
    "another format": (manifest('"format": 1', '"format": 99'), "of format 99, not 1"),
    "a missing shard": (
        lambda folder: (folder / SHARD).unlink(),
        r"part-00003\.parquet",
    ),
    "a missing column": (without_a_column, "columns of its specification"),
    "a shard in another's place": (
        lambda folder: shutil.copy(folder / "part-00002.parquet", folder / SHARD),
        "shard 3 of this store",
    ),
    **{
        place: (manifest("part-00001.parquet", place), "in the same folder")
        for place in ("../outside.parquet", "OUTSIDE", "./part-00001.parquet")
    },
    **{
        f"a manifest of {text}": (
            lambda folder, text=text: (folder / "manifest.json").write_text(text),
            "an undamaged manifest",
        )
        for text in ("nothing", "", "[]", "{}", '{"shards": [1]}')
    },
}


@pytest.mark.parametrize("fault", REFUSED)
def test_a_folder_that_is_no_whole_store_is_refused(folder, fault):
    damage, allowed = REFUSED[fault]
    damage(folder)
    with refused(allowed):
        open_store(folder)


@pytest.mark.parametrize("length", [0, 3, 1000])
def test_a_truncated_shard(folder, length):
    shard = folder / SHARD
    shard.write_bytes(shard.read_bytes()[:length])
    for path in (folder, shard):
        with refused(r"part-00003\.parquet.* whole"):
            open_store(path)


@pytest.mark.parametrize(
    "footers", [{}, *({"taichi_nmm": footer} for footer in FOOTERS)]
)
def test_a_foreign_file_even_with_a_footer_of_our_key(tmp_path, footers):
    path, table = tmp_path / "foreign.parquet", pa.table({"phi_printed": [1.0]})
    pq.write_table(table.replace_schema_metadata(footers), path)
    with refused("footer"):
        open_store(path)
    path.write_text("row,phi_printed\n0,1\n")
    with refused("Parquet"):
        open_store(path)


def test_a_wrong_hash_is_found_when_verified(folder):
    shard = folder / SHARD
    pq.write_table(pq.read_table(shard, partitioning=None), shard, compression="snappy")
    assert len(open_store(folder)) == 50
    for path in (folder, shard):
        with refused("SHA-256"):
            open_store(path, verify=True)


@pytest.mark.slow
def test_a_flipped_bit_changes_no_value(folder, tmp_path):
    """Wherever it lies, the values are those that were written, or one line refuses the file."""
    truth, rng = open_store(folder).table(), np.random.default_rng(34)
    # the manifest and the shards
    files = sorted(path.name for path in folder.glob("[mp]*.*"))
    errors = 0
    for number in range(60):
        flipped = shutil.copytree(folder, tmp_path / f"flipped-{number}")
        file = flipped / files[number % len(files)]
        content = bytearray(file.read_bytes())
        content[rng.integers(len(content))] ^= 1 << rng.integers(8)
        file.write_bytes(content)
        try:
            assert open_store(flipped).table().equals(truth)
        except InputError:
            errors += 1
        with pytest.raises(InputError):
            open_store(flipped, verify=True)
    assert 0 < errors < 60
    path = Path(shutil.copy(folder / SHARD, tmp_path / "flipped.parquet"))
    fake.flip_a_bit(path)
    for verify in (False, True):
        with refused("undamaged"):
            open_store(path, verify=verify).table()


def test_a_store_of_other_bounds_is_refused(folder, monkeypatch):
    store = open_store(folder)
    store.require_bounds()
    monkeypatch.setattr(walker_simulator, "GAINS", GAINS[:-1])
    with refused(rf"^store\.gains\.{GAIN_NAMES[-1]}: "):
        store.require_bounds()


def test_the_old_folder_opens_and_is_not_resumed(tmp_path):
    store = open_store(OLD_STORE, verify=True)
    rows = store.numpy()
    assert rows["row"].tolist() == list(range(20))
    assert store.specification["code_version"] == "0.1.0"
    assert [footer["rows"] for footer in store.footers] == [12, 8]
    assert {footer["engine"] for footer in store.footers} == {"taichi"}
    assert rows["end_reason"].tolist().count("completed") == 2
    assert rows["phi_printed"].sum() == pytest.approx(88.49891221523285, rel=1e-12)
    assert len(store.bounds) == 16
    for name, bound in store.bounds.items():
        assert np.all((bound["low"] <= rows[name]) & (rows[name] <= bound["high"]))
    assert len(open_store(OLD_STORE / "part-00001.parquet", verify=True)) == 8
    merged = merge(OLD_STORE, tmp_path / "merged.parquet")
    assert merged.table().equals(store.table().combine_chunks())
    # The numbers of two simulators do not mix.
    folder = shutil.copytree(OLD_STORE, tmp_path / "store")
    request = read_specification(Table({"samples": 20, "shard_rows": 12, "seed": 1}))
    with refused(r"code_version.*0\.1\.0"):
        precompute(request, folder, fresh=False)
    assert open_store(folder).table().equals(open_store(OLD_STORE).table())


def test_a_column_with_a_gap_and_a_shard_of_another_format(folder):
    shard = folder / "part-00000.parquet"
    table = pq.read_table(shard, partitioning=None)
    place, flags = (
        table.column_names.index("robust_evaluated"),
        table["robust_evaluated"],
    )
    gap = pa.array([None, *flags.to_pylist()[1:]], flags.type)
    path = folder / "edited.parquet"
    pq.write_table(
        table.set_column(place, pa.field("robust_evaluated", flags.type), gap), path
    )
    with refused(r"edited\.parquet.*robust_evaluated has no gaps"):
        open_store(path).table()
    footer = table.schema.metadata[FOOTER_KEY].replace(
        b'"format": 1', b'"format": 99', 1
    )
    pq.write_table(table.replace_schema_metadata({FOOTER_KEY: footer}), shard)
    with refused("format 1, not 99"):
        open_store(shard)


@pytest.mark.parametrize(
    "name", ["", ".", "x" * 300, "nul\0", "\ud800", "missing/file", "file/x"]
)
def test_merging_into_no_file(folder, name):
    (folder / "file").write_text("")
    before = sorted(folder.iterdir())
    with pytest.raises(InputError) as caught:
        merge(folder, folder / name if name else Path())
    assert name != "missing/file" or "a place that can be written" in str(caught.value)
    assert sorted(folder.iterdir()) == before


@pytest.mark.slow
def test_reading_loads_no_simulator(folder):
    code = "import sys, storage; storage.open_store(sys.argv[1]).numpy()\n"
    code += "print({'taichi', 'quadrants', 'matplotlib', 'optuna'}.intersection(sys.modules))"
    assert printed("-c", code, folder) == "set()\n"
