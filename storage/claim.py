"""The right to fill a folder: one process at a time, and nothing of anybody else's in it."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from storage.commit import TEMPORARY_SUFFIX, require_folder, writable
from taichi_nmm.errors import InputError

LOCK_NAME = ".lock"


@contextmanager
def claimed(path: Path, first: str, kind: str) -> Iterator[None]:
    """Hold a folder, made where it is missing, and rid it of files that were never finished.

    Args:
        path: of the folder.
        first: the file that whoever fills such a folder writes first.
        kind: what such a folder is, for messages: "a store".

    Raises:
        InputError: in use by another process, not empty and without the first file, or not
            writable.
    """
    require_claimable(path, first, kind)
    with writable(path):
        path.mkdir(parents=True, exist_ok=True)
        lock = (path / LOCK_NAME).open("a")  # never removed: another process may hold it
    with lock:
        try:
            fcntl.flock(lock.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            allowed = "a folder that no other process is filling at this moment"
            raise InputError("out", str(path), allowed) from None
        remove(path, f".*{TEMPORARY_SUFFIX}")
        yield


def remove(path: Path, *patterns: str) -> None:
    """Remove the files of a folder whose names match."""
    with writable(path):
        for pattern in patterns:
            for file in path.glob(pattern):
                file.unlink()


def require_claimable(path: Path, first: str, kind: str) -> None:
    """Refuse a folder that holds something else, whose files would be overwritten.

    Nothing is written. Arguments as of `claimed`.

    Raises:
        InputError: not a folder, not empty and without the first file, or not writable.
    """
    with writable(path):
        require_folder(path)
        names = {file.name for file in path.iterdir()} if path.is_dir() else set()
    foreign = sorted(name for name in names if name != LOCK_NAME and not _is_temporary(name))
    if foreign and first not in names:
        raise InputError("out", str(path), f"an empty folder or {kind} (this has {foreign[0]})")


def _is_temporary(name: str) -> bool:
    return name.startswith(".") and name.endswith(TEMPORARY_SUFFIX)
