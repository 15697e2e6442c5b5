import json
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import taichi_nmm
from storage import open_store
from storage import precompute as filling
from storage.pool import Pool, local_pool
from storage.precompute import precompute
from storage.store_folder import StoreFolder
from storage.tables import FOOTER_KEY
from tests.cases import asset, refused
from tests.storage import fake
from tests.storage.fake import content

SHARD = "part-00003.parquet"
rows_of = partial(pq.read_table, partitioning=None)
# the last one within the family
STOPS = [(0, {}, 0), (3, {}, 3), (5, {"robust": True}, 2)]


@pytest.fixture
def store(tmp_path):
    path = tmp_path / "store"
    fill(path)
    return path


def fill(path, fresh=False, **changes):
    return precompute(fake.specification(**changes), path, fresh)


def test_a_store_is_its_shards_a_specification_and_a_manifest(store):
    shards = [f"part-{number:05d}.parquet" for number in range(7)]
    assert sorted(content(store)) == [
        ".lock",
        "manifest.json",
        *shards,
        "specification.json",
    ]
    manifest = json.loads((store / "manifest.json").read_text())
    assert [shard["file"] for shard in manifest["shards"]] == shards
    assert manifest["rows"] == 50
    assert manifest["specification"] == fake.specification().document
    footer = json.loads(pq.read_schema(store / SHARD).metadata[FOOTER_KEY])
    specification = fake.specification()
    assert footer == fake.ENGINE | {
        "format": 1,
        "specification_hash": specification.hash,
        "shard": 3,
        "rows": 8,
        "seed": 7,
        "code_version": "0.4.0",
        "specification": specification.document,
    }
    before = content(store)
    (store / SHARD).unlink()
    with ThreadPoolExecutor(2) as executor:
        executor.shutdown()
        precompute(fake.specification(), store, pool=Pool(executor, 2))
    assert content(store) == before


def test_shards_that_are_computed_together_are_the_same(store, monkeypatch):
    before = content(store)
    for number in (0, 1, 2, 4, 6):
        (store / f"part-{number:05d}.parquet").unlink()
    units = []
    kind = type(fake.specification().simulator)
    monkeypatch.setattr(kind, "points_at_once", 16)  # of shards of 8
    score = filling.score_rows
    monkeypatch.setattr(
        filling,
        "score_rows",
        lambda specification, rows, *others: (
            units.append(rows),
            score(specification, rows, *others),
        )[1],
    )
    fill(store)
    assert units == [range(16), range(16, 24), range(32, 40), range(48, 50)]
    assert content(store) == before


def test_shards_in_any_order(store, tmp_path, monkeypatch):
    threads, seen = [], []

    def simulate(gains, **options):
        threads.append(options["settings"].threads)
        time.sleep(0.05 / len(threads))  # later ones overtake
        return fake.simulate(gains, **options)

    monkeypatch.setitem(vars(taichi_nmm), "simulate", simulate)
    with ThreadPoolExecutor(3) as executor:  # where the fake simulator is seen
        pool = Pool(executor, 3)
        precompute(
            fake.specification(), tmp_path / "b", progress=seen.append, pool=pool
        )
    assert content(tmp_path / "b") == content(store)
    assert threads == [1] * 8  # the last shard is cut: three processes have six others
    assert len(seen) == 9 and seen[0] == 0 and seen[-1] == 50 and seen == sorted(seen)


def test_a_stop_loses_shards_of_which_a_part_is_missing(store, tmp_path):
    with ThreadPoolExecutor(1) as executor:
        fake.interrupt(6, fake.specification(), tmp_path / "b", pool=Pool(executor, 20))
    assert len([*(tmp_path / "b").glob("part-*")]) <= 1  # of six parts of two rows each
    fill(tmp_path / "b")
    assert content(tmp_path / "b") == content(store)


def test_shards_of_mixed_kind(store, tmp_path, monkeypatch):
    monkeypatch.setattr(
        filling, "own_kind", lambda simulator: {"processor": "Fast 3000"}
    )
    with ThreadPoolExecutor(2) as executor:
        precompute(
            fake.specification(), tmp_path / "b", pool=Pool(executor, 2, mixed=True)
        )
    found = open_store(tmp_path / "b")
    assert all(footer["kind"] == {"processor": "Fast 3000"} for footer in found.footers)
    assert found.table().equals(open_store(store).table())


@pytest.mark.slow
def test_processes_compute_the_same_bytes(tmp_path, monkeypatch):
    # the real one, which the processes have
    monkeypatch.delitem(vars(taichi_nmm), "simulate")
    short = {"duration_s": 0.2, "arch": "cpu"}
    specification = fake.specification(
        samples=24, simulation=short, searched=["theta_ref"]
    )
    precompute(specification, tmp_path / "one")
    with local_pool(2) as pool:
        precompute(specification, tmp_path / "two", pool=pool)
    assert content(tmp_path / "one") == content(tmp_path / "two")


def another_specification(file):
    other = file.parent.with_name("other")
    fill(other, seed=8)
    shutil.copy(other / file.name, file)


def edited_specification(file):
    """Beside the hash of the one that it was."""
    table = rows_of(file)
    footer = json.loads(table.schema.metadata[FOOTER_KEY])
    footer["specification"]["gains"].pop("K_TA")
    edited = table.replace_schema_metadata({FOOTER_KEY: json.dumps(footer)})
    pq.write_table(edited, file, write_page_checksum=True)


OTHER_BYTES = "other bytes"  # of the right rows
DAMAGE = {
    "truncated": lambda file: file.write_bytes(file.read_bytes()[:-100]),
    "empty": lambda file: file.write_bytes(b""),
    "foreign": lambda file: pq.write_table(pa.table({"a": [1]}), file),
    "other columns": lambda file: pq.write_table(
        rows_of(file).drop_columns(["phi_printed"]), file
    ),
    "fewer rows": lambda file: pq.write_table(rows_of(file).slice(1), file),
    "another shard": lambda file: shutil.copy(
        file.with_name("part-00002.parquet"), file
    ),
    "another specification": another_specification,
    "edited specification": edited_specification,
    "a flipped bit": fake.flip_a_bit,
    OTHER_BYTES: lambda file: pq.write_table(rows_of(file), file, compression="snappy"),
    "removed": Path.unlink,
}


@pytest.mark.parametrize("manifest", [True, False])
@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_shard_is_found_and_redone(store, damage, manifest):
    """The right rows in other bytes are noticed by the manifest alone."""
    before = content(store)
    if not manifest:
        (store / "manifest.json").unlink()
    DAMAGE[damage](store / SHARD)
    noticed = manifest or damage != OTHER_BYTES
    assert fill(store).points_computed == (8 if noticed else 0)
    assert not noticed or content(store) == before


@pytest.mark.parametrize("text", ["", "{", "[]", '{"shards": 3}'])
def test_a_damaged_manifest_is_written_again(store, text):
    before = content(store)
    (store / "manifest.json").write_text(text)
    assert fill(store).points_computed == 0
    assert content(store) == before


@pytest.mark.parametrize("name", [SHARD, "manifest.json", "specification.json"])
def test_a_folder_in_a_files_place_is_refused_before_the_work(store, name):
    (store / name).unlink()
    (store / name).mkdir()
    before = sorted(store.iterdir())
    with refused(f"out: .*{name}.*not a folder"):
        precompute(
            fake.specification(), store, progress=lambda points: pytest.fail("it works")
        )
    assert sorted(store.iterdir()) == before


@pytest.mark.parametrize(("calls", "changes", "done"), STOPS)
def test_an_interrupt_loses_one_shard(tmp_path, calls, changes, done):
    fake.interrupt(calls, fake.specification(**changes), tmp_path / "store")
    assert not (tmp_path / "store" / "manifest.json").exists()
    assert fill(tmp_path / "store", **changes).points_computed == 50 - done * 8
    fill(tmp_path / "other", **changes)
    assert content(tmp_path / "store") == content(tmp_path / "other")


def test_a_run_goes_on_in_its_own_folder_alone(store):
    before = content(store)
    (store / ".part-00001.parquet.123.tmp").write_bytes(b"half")
    fill(store)
    assert content(store) == before
    specification = fake.specification()
    with (
        StoreFolder.claim(store, specification.document, fresh=False),
        refused("no other process"),
        StoreFolder.claim(store, specification.document, fresh=True),
    ):
        pytest.fail("two processes would write")
    assert fill(store).points_computed == 0
    (store / SHARD).unlink()
    seen = []
    precompute(fake.specification(), store, progress=seen.append)
    assert seen[0] == 42 and seen[-1] == 50 and seen == sorted(seen)


@pytest.mark.parametrize(
    ("field", "changes"), asset("other-specifications.toml").items()
)
def test_another_specification_is_refused_by_name(store, changes, field):
    before = content(store)
    with refused(rf"^{field}: .*--fresh"):
        fill(store, **changes)
    assert content(store) == before


@pytest.mark.parametrize("text", ["", "{"])
def test_fresh_starts_over_and_leaves_the_files_of_others(store, text):
    (store / "notes.txt").write_text("mine")
    summary = fill(store, fresh=True, samples=20)
    assert (summary.points, summary.points_computed) == (20, 20)
    shards = [f"part-{number:05d}.parquet" for number in range(3)]
    assert sorted(file.name for file in store.glob("*.parquet")) == shards
    assert (store / "notes.txt").read_text() == "mine"
    (store / "specification.json").write_text(text)
    with refused("a readable specification"):
        fill(store)
    assert fill(store, fresh=True).points_computed == 50


@pytest.mark.parametrize("name", ["notes.txt", SHARD, "manifest.json"])
@pytest.mark.parametrize("fresh", [False, True])
def test_a_folder_of_something_else_is_refused(tmp_path, name, fresh):
    (tmp_path / name).write_text("mine")
    with refused(name):
        fill(tmp_path, fresh)
    assert content(tmp_path) == {name: b"mine"}


def test_out_is_a_file(tmp_path):
    (tmp_path / "file").write_text("mine")
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with refused(r"^out: "):
            fill(path)
