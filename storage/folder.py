"""A folder whose files are the state of some work: one process fills it, any later one goes on."""

import fnmatch
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from storage.commit import TEMPORARY_SUFFIX, lock_now, require_folder, writable
from taichi_nmm.errors import InputError

LOCK_NAME = ".lock"
UNFINISHED = f".*{TEMPORARY_SUFFIX}"


@contextmanager
def claimed(path: Path, first: str, kind: str) -> Iterator[None]:
    """Hold a folder, made where it is missing, and remove files that were never finished.

    Args:
        path: of the folder.
        first: the file that the work writes first.
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
        lock_now(lock.fileno(), path)
        remove(path, UNFINISHED)
        yield


def require_claimable(path: Path, first: str, kind: str) -> None:
    """Refuse a folder that holds something else, whose files would be overwritten.

    Nothing is written. Arguments as of `claimed`.

    Raises:
        InputError: not a folder, not empty and without the first file, or not writable.
    """
    with writable(path):
        require_folder(path)
        names = {file.name for file in path.iterdir()} if path.is_dir() else set()
    names -= {LOCK_NAME, *fnmatch.filter(names, UNFINISHED)}
    if names and first not in names:
        raise InputError("out", str(path), f"an empty folder or {kind} (this has {min(names)})")


def remove(path: Path, *patterns: str) -> None:
    """Remove the files of a folder whose names match, pattern after pattern."""
    with writable(path):
        for pattern in patterns:
            for file in path.glob(pattern):
                file.unlink()
