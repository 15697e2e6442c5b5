"""What a user may ask for, and what a machine is taken for."""

import pytest

import taichi_nmm
from storage.dask_session import packed, unpack
from storage.pool import Cluster, differences, own_kind, processor
from storage.precompute import precompute
from storage.store import open_store
from taichi_nmm import InputError, Settings
from taichi_nmm.kernel_cache import COMPILER
from taichi_nmm.walker_simulator import Walker
from tests.cases import asset, refused
from tests.storage import fake

pytest.importorskip(
    "distributed", reason="distributed is not installed: the extra cluster"
)

ADDRESSES = asset("addresses.toml")


@pytest.mark.parametrize(("address", "processes"), ADDRESSES["processes"].items())
def test_addresses(address, processes):
    assert Cluster(address).local_processes == processes


@pytest.mark.parametrize("address", ADDRESSES["none"]["words"])
def test_what_is_no_address(address):
    with refused(r"^cluster: .* local:N with N from 1 to 256, or a sched"):
        Cluster(address)


def test_no_password_is_shown_and_a_missing_library_named(monkeypatch):
    with pytest.raises(InputError) as caught:
        Cluster("tcp://me:secret@head:1")
    assert "secret" not in str(caught.value)
    monkeypatch.setattr("storage.pool.find_spec", {"distributed": None}.__getitem__)
    with refused(r"pip install 'taichi-nmm\[cluster\]'"):
        Cluster("local:2")


def test_a_kind_says_what_computes(monkeypatch, tmp_path):
    speed_mps = 0.0

    def simulate(gains, **options):
        result = fake.simulate(gains, progress=lambda *_: None, **options)
        result.rows["mean_speed_mps"][-1] = speed_mps
        return result

    monkeypatch.setitem(vars(taichi_nmm), "simulate", simulate)
    walker = Walker(Settings(arch="cpu"))
    kind = own_kind(walker, ("numpy", "scipy"))
    assert kind == own_kind(walker, ("scipy",))
    assert list(kind) == [
        "canary",
        "processor",
        "taichi-nmm",
        COMPILER,
        "numpy",
        "scipy",
    ]
    assert differences(kind, kind) == ""
    speed_mps = 1.0
    found = differences(own_kind(walker), kind)
    assert found.startswith("canary ") and found.endswith(
        f", scipy none, not {kind['scipy']}"
    )
    (tmp_path / "cpuinfo").write_text(
        "processor\t: 0\nmodel name\t: Fast 3000\nmodel name : x\n"
    )
    assert processor(tmp_path / "cpuinfo") == "Fast 3000"
    assert processor(tmp_path / "nothing") != ""


def test_a_store_is_packed_and_unpacked(tmp_path):
    store = tmp_path / "store"
    precompute(fake.specification(), store)
    (store / "mine.txt").write_text("stays here")
    (tmp_path / "elsewhere").mkdir()
    unpack(packed(store), tmp_path / "elsewhere" / "store")
    found = open_store(tmp_path / "elsewhere" / "store", verify=True)
    assert found.table().equals(open_store(store).table())
    assert not (found.path / "mine.txt").exists()
    unpack(packed(store / "part-00000.parquet"), tmp_path / "one" / "store")
    assert len(open_store(tmp_path / "one" / "store")) == 8
    unpack({"../../outside.parquet": b""}, tmp_path / "two" / "store")
    assert [file.name for file in tmp_path.rglob("outside*")] == ["outside.parquet"]
    assert (tmp_path / "two" / "store" / "outside.parquet").is_file()
    with refused(r"part-00001\.parquet"):
        (store / "part-00001.parquet").unlink()
        packed(store)
