import errno
import fcntl
import os
import re
from pathlib import Path

import pyarrow as pa
import pytest

from storage.commit import commit, commit_json, temporary_sibling, together
from storage.store import read_footer
from storage.tables import read_columns, write_table
from tests.cases import refused
from tests.processes import python

IMPORTS = "import sys; from pathlib import Path; from storage.commit import commit_json, together\n"
TABLE = pa.table({"row": [0, 1], "score": [0.5, 0.25]})
FOOTER = {
    "format": 1,
    "rows": 2,
    "shard": 0,
    "specification": {},
    "specification_hash": "",
}


def test_a_file_appears_whole_with_its_footer_which_counts_its_rows(tmp_path):
    path = tmp_path / "part.parquet"
    write_table(path, TABLE, FOOTER)
    footer, schema = read_footer(path)
    assert footer == FOOTER and schema == TABLE.schema
    assert read_columns(path, ["score"])["score"].to_pylist() == [0.5, 0.25]
    assert [file.name for file in tmp_path.iterdir()] == ["part.parquet"]
    write_table(tmp_path / "again", TABLE, FOOTER)
    assert (tmp_path / "again").read_bytes() == path.read_bytes()
    write_table(path, TABLE, FOOTER | {"rows": 3})
    with refused("a file of 3 rows"):
        read_footer(path)


def test_a_full_disk_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "part.parquet"
    write_table(path, TABLE, FOOTER)
    before = path.read_bytes()

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with refused(r"^out: .*No space left on device"):
        write_table(path, TABLE.slice(1), FOOTER | {"rows": 1})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_what_reads_back_differently_or_is_interrupted_never_gets_the_name(tmp_path):
    def check(temporary):
        raise OSError("what was read back differs from what was written")

    def interrupted(temporary):
        temporary.write_text("half")
        raise KeyboardInterrupt

    with refused("differs"):
        commit(
            tmp_path / "part.parquet",
            lambda temporary: temporary.write_text("half"),
            check,
        )
    assert not list(tmp_path.iterdir())
    with pytest.raises(KeyboardInterrupt):
        commit(tmp_path / "file", interrupted, lambda temporary: None)
    assert not list(tmp_path.iterdir())
    with refused("No such file or directory"):
        commit_json(tmp_path / "missing" / "file.json", {})


def test_what_a_killed_process_left_goes_and_what_a_living_one_writes_stays(tmp_path):
    path, other = tmp_path / "file.json", tmp_path / ".another.json.1.tmp"
    killed, living = (tmp_path / f".file.json.{pid}.tmp" for pid in (1, 2))
    for file in (killed, living, other):
        file.write_text("half")
    with living.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        commit_json(path, {})
    assert set(tmp_path.iterdir()) == {path, living, other}
    commit_json(path, {})
    assert set(tmp_path.iterdir()) == {path, other}


def test_what_is_removed_before_its_lock(tmp_path, monkeypatch):
    """By another process, that finds it without a lock."""
    real, calls = fcntl.flock, []

    def late(file, operation):
        if not calls:
            Path(file.name).unlink()
        calls.append(operation)
        real(file, operation)

    monkeypatch.setattr(fcntl, "flock", late)
    with temporary_sibling(tmp_path / "a") as temporary:
        assert temporary.exists()
    assert calls == [fcntl.LOCK_EX] * 2 and not list(tmp_path.iterdir())


def errors_of(code, path):
    """Of another process that runs the code."""
    return python("-c", IMPORTS + code, path).stderr


def test_what_is_being_written_or_filled_is_let_be(tmp_path):
    path = tmp_path / "file.json"
    with temporary_sibling(path) as temporary:
        assert (
            errors_of("commit_json(Path(sys.argv[1]), {})", path) == ""
            and temporary.exists()
        )
    assert list(tmp_path.iterdir()) == [path]
    path.unlink()
    folder = tmp_path / "report"
    with together(folder) as new:
        (new / "file").write_text("first")
        errors = errors_of("with together(Path(sys.argv[1])): pass", folder)
        assert (
            "allowed: a folder that no other process is filling at this moment"
            in errors
        )
    assert [file.name for file in tmp_path.rglob("*")] == ["report", "file"]


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_without_locks(tmp_path, monkeypatch, number):
    def fails(file, operation):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", fails)
    allowed = f"a place on a file system with locks, such as a local disk ({os.strerror(number)})"
    error = refused(re.escape(allowed))
    with error, together(tmp_path / "report"):
        pass


def test_files_move_into_a_named_folder(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    monkeypatch.chdir(tmp_path / "a")
    for folder in (Path(), Path(".."), Path("..", "a")):
        with together(folder) as new:
            (new / "file").touch()
        assert (folder / "file").exists()
        (folder / "file").unlink()
    error = refused(r"^out: '/' .* a folder that has a name")
    with error, together(Path("/")):
        pass
    assert [file.name for file in tmp_path.iterdir()] == ["a"] and not list(
        Path().iterdir()
    )


def test_files_appear_together(tmp_path):
    folder = tmp_path / "deep" / "report"
    # of a process that was killed
    (tmp_path / "deep" / ".report.new").mkdir(parents=True)
    (tmp_path / "deep" / ".report.new" / "old").touch()
    for text in ("1", "2"):
        with together(folder) as new:
            (new / "a").write_text(text)
            (new / text).touch()
            assert not (folder / text).exists()
        assert (folder / "a").read_text() == text
    assert sorted(path.name for path in folder.iterdir()) == ["1", "2", "a"]
    (tmp_path / "file").touch()
    with refused(r"out: .*file"), together(tmp_path / "file"):
        pass
    assert [path.name for path in folder.parent.iterdir()] == ["report"]
