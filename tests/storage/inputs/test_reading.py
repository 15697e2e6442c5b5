"""Hostile files at every door of the packages: each ends in one line, soon, and without a hang."""

import bz2
import gzip
import json
import lzma
import os
import signal
from pathlib import Path

import pytest

from storage import open_store
from storage.inputs import reading
from storage.inputs.config import read_toml
from study import FeatureTable
from study.experiment.gains import gains_of_row
from taichi_nmm import InputError, load_all_gains, load_gains, terrain
from taichi_nmm.parameters import GAIN_NAMES, PUBLISHED_GAINS

SLOW_S = 60  # a pipe without a writer would hold a test for ever
GAINS = json.dumps(dict(zip(GAIN_NAMES, PUBLISHED_GAINS.tolist(), strict=True)))
TABLE = FeatureTable.from_parquet
DOORS = {
    "gains": lambda path: load_gains(str(path)),
    "all gains": lambda path: load_all_gains(str(path)),
    "toml": read_toml,
    "terrain": terrain.from_file,
    "store": open_store,
    "row": lambda path: gains_of_row(path, 0),
    "table": lambda path: TABLE(path, parameters=["x"], features=["y"]),
    "table of a store": lambda path: TABLE(path, features=["y"]),
}


@pytest.fixture(autouse=True)
def no_hang():
    def stop(*_):
        raise TimeoutError("hangs")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SLOW_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def refused(read, path):
    with pytest.raises(InputError) as caught:
        read(path)
    line = str(caught.value)
    assert line.isprintable() and len(line) < 2000
    return line


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize(
    "name", ["x" * 300, "x/" * 3000, "nul\0.json", "new\nline", "\udcff", "."]
)
def test_names_that_no_file_can_have(tmp_path, door, name):
    refused(DOORS[door], tmp_path / name)


@pytest.mark.parametrize("door", DOORS)
def test_a_pipe_is_not_waited_for(tmp_path, door):
    os.mkfifo(tmp_path / "pipe")
    refused(DOORS[door], tmp_path / "pipe")
    refused(DOORS[door], Path("/dev/zero"))


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize(
    "content",
    [
        b"[" * 100_000,
        b'{"a":' * 100_000,
        b"[" * 200 + b"1" + b"]" * 200,
        b"a = " + b"[" * 3000 + b"]" * 3000,
        b"\xff\xfe\x00",
        b"PAR1" * 3,
        b"PAR1\xff\xff\xff\x7fPAR1",
        b"9" * 5000,
        b'{"K_GAS": ' + b"9" * 5000 + b"}",
        b"K_GAS = " + b"9" * 5000,
        b"",
    ],
)
def test_content_that_breaks_parsers(tmp_path, door, content):
    path = tmp_path / "file"
    path.write_bytes(content)
    if content or door != "toml":  # an empty configuration is one
        refused(DOORS[door], path)


@pytest.mark.parametrize("digits", [310, 400, 4000, 5000])
def test_whole_numbers_beyond_any_float(tmp_path, digits):
    path = tmp_path / "gains.json"
    path.write_text(GAINS.replace("3.874", "9" * digits))
    refused(DOORS["gains"], path)
    torso = json.loads(GAINS) | {"theta_ref": 0.1}
    path.write_text(json.dumps(torso).replace("0.1}", "9" * digits + "}"))
    refused(DOORS["all gains"], path)
    path.write_text(f"samples = {'9' * digits}\nduration_s = {'9' * digits}")
    refused(lambda path: read_toml(path).number("duration_s"), path)
    refused(lambda path: read_toml(path).integer("samples"), path)


def test_keys_that_come_twice_and_shapes(tmp_path):
    path = tmp_path / "gains.json"
    path.write_text(GAINS.replace("{", '{"K_GAS": 1.0, '))
    assert "K_GAS" in refused(DOORS["gains"], path)
    path.write_text("a = 1\na = 2")
    refused(DOORS["toml"], path)
    # A mark at the beginning is no fault, but JSON of another shape is.
    path.write_text("\ufeffa = 1")
    assert read_toml(path).integer("a") == 1
    for content in (
        "5",
        "[]",
        "null",
        '"K_GAS"',
        '{"gains": []}',
        '{"gains": 5}',
        "true",
        "NaN",
    ):
        path.write_text(content)
        refused(DOORS["gains"], path)


PACK = {
    ".gz": gzip.compress,
    ".bz2": bz2.compress,
    ".xz": lzma.compress,
}


@pytest.mark.parametrize("suffix", PACK)
def test_no_bomb_is_unpacked(tmp_path, suffix, monkeypatch):
    path = tmp_path / f"hill.csv{suffix}"
    whole = PACK[suffix](b"0,0\n10,1\n")
    path.write_bytes(whole)
    assert terrain.from_file(path).height(5.0) == 0.5
    for damaged in (
        whole[:-5],
        whole[:9],
        whole[:1],
        b"",
        b"0,0\n1,1\n",
        whole[:-9] + b"\0" * 9,
    ):
        path.write_bytes(damaged)
        refused(terrain.from_file, path)
    monkeypatch.setattr(reading, "MOST_BYTES", 1 << 20)
    path.write_bytes(PACK[suffix](b"0" * (1 << 24)))
    assert "MiB" in refused(terrain.from_file, path)


def test_a_file_that_is_too_long(tmp_path):
    path = tmp_path / "long"
    with path.open("wb") as file:
        # of zeros, and takes no place on the disk
        file.truncate(reading.MOST_BYTES + 1)
    for door in ("gains", "toml", "terrain"):
        assert "MiB" in refused(DOORS[door], path)
