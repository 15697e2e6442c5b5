import errno
import os
from pathlib import Path

import pyarrow as pa
import pytest

from storage.commit import commit, commit_json
from storage.shard import read_columns, read_footer, write_table
from taichi_nmm.errors import InputError

TABLE = pa.table({"row": [0, 1], "score": [0.5, 0.25]})
FOOTER = {"format": 1, "rows": 2, "shard": 0, "specification": {}, "specification_hash": ""}


def test_a_file_appears_whole_with_its_footer(tmp_path: Path) -> None:
    path = tmp_path / "part.parquet"
    write_table(path, TABLE, FOOTER)
    footer, schema = read_footer(path)
    assert footer == FOOTER and schema == TABLE.schema
    assert read_columns(path, ["score"])["score"].to_pylist() == [0.5, 0.25]
    assert [file.name for file in tmp_path.iterdir()] == ["part.parquet"]


def test_same_table_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_table(tmp_path / name, TABLE, FOOTER)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_disk_full_leaves_the_old_file_and_no_temporary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "part.parquet"
    write_table(path, TABLE, FOOTER)
    before = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="No space left on device") as caught:
        write_table(path, TABLE.slice(1), FOOTER | {"rows": 1})
    assert caught.value.field == "out"
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_what_reads_back_differently_never_gets_the_name(tmp_path: Path) -> None:
    def write_half(temporary: Path) -> None:
        temporary.write_bytes(b"PAR1 and then the power failed")

    def check(temporary: Path) -> None:
        raise OSError("what was read back differs from what was written")

    with pytest.raises(InputError, match="differs"):
        commit(tmp_path / "part.parquet", write_half, check)
    assert not list(tmp_path.iterdir())


def test_a_footer_that_lies_about_its_rows_is_not_committed(tmp_path: Path) -> None:
    path = tmp_path / "part.parquet"
    write_table(path, TABLE, FOOTER | {"rows": 3})
    with pytest.raises(InputError, match="a file of 3 rows"):
        read_footer(path)


def test_interrupt_while_writing_leaves_nothing(tmp_path: Path) -> None:
    def write(temporary: Path) -> None:
        temporary.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        commit(tmp_path / "file", write, lambda temporary: None)
    assert not list(tmp_path.iterdir())


def test_no_folder_to_write_in(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file or directory"):
        commit_json(tmp_path / "missing" / "file.json", {})
