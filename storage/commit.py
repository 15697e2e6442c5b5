"""The commit protocol: a file appears under its name whole and checked, or not at all.

A process that is killed while it writes straight to the destination leaves an
unreadable file under the final name. So a temporary sibling is written, closed,
re-opened to be checked, and put on the disk before it takes its name; then the folder
is put on the disk.
"""

import errno
import fcntl
import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from storage.inputs.errors import InputError

TEMPORARY_SUFFIX = ".tmp"  # hidden files of this ending are never read
UNHELD = "a folder that no other process is filling at this moment"


def commit(
    path: Path,
    write: Callable[[Path], object],
    check: Callable[[Path], object],
    field: str = "out",
) -> None:
    """Make the file `path`: `write` fills a temporary sibling, `check` re-opens it and may raise.

    Raises:
        InputError: naming the path as `field`: the folder cannot be written or the disk
            is full; nothing is left behind.
    """
    with writable(path, field):
        if not path.name:
            raise OSError("no name of a file")
        with temporary_sibling(path) as temporary:
            write(temporary)
            check(temporary)
            sync(temporary)
            temporary.replace(path)
            sync(path.parent)


@contextmanager
def temporary_sibling(path: Path) -> Iterator[Path]:
    """An empty file beside `path` that is to take its name; it is gone at the end if it has not.

    It is locked while this process lives. Siblings that killed processes left are
    removed.
    """
    remove_orphans(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY_SUFFIX}")
    with _locked_new(temporary):
        try:
            yield temporary
        finally:
            temporary.unlink(missing_ok=True)


def _locked_new(path: Path) -> BinaryIO:
    """A new file that is locked; it is made again if another process removes it before the lock."""
    while True:
        held = path.open("ab")
        fcntl.flock(held, fcntl.LOCK_EX)
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(held.fileno()), path.stat()):
                return held
        held.close()


def commit_text(path: Path, text: str, field: str = "out") -> None:
    """Make a text file; errors name it as `field`."""

    def check(temporary: Path) -> None:
        if temporary.read_text(encoding="utf-8") != text:
            raise OSError("what was read back differs from what was written")

    commit(
        path,
        lambda temporary: temporary.write_text(text, encoding="utf-8"),
        check,
        field,
    )


def commit_json(path: Path, document: dict[str, Any]) -> None:
    """Make a JSON file."""
    commit_text(path, json.dumps(document, indent=2) + "\n")


@contextmanager
def writable(path: Path, field: str = "out") -> Iterator[None]:
    """Turn the system's refusal to write at `path`, which `field` names, into one line."""
    try:
        if b"\0" in os.fsencode(path):
            raise OSError("no name that a file can have")
        yield
    except (OSError, UnicodeEncodeError) as error:
        reason = getattr(error, "strerror", None) or error
        allowed = f"a place that can be written, with space left ({reason})"
        raise InputError(field, str(path), allowed) from None


@contextmanager
def together(folder: Path) -> Iterator[Path]:
    """A folder to write files to, which move to `folder` when the block has ended well.

    If it ends otherwise, nothing is there that was not there before.

    Raises:
        InputError: the folder cannot be written, the disk is full, or another process
            is filling the same folder.
    """
    require_named(folder)
    new = folder.resolve().with_name(f".{folder.resolve().name}.new")
    taken = InputError("out", str(folder), UNHELD)
    with writable(folder):
        new.mkdir(parents=True, exist_ok=True)
    try:
        held = os.open(new, os.O_RDONLY)
    except FileNotFoundError:  # its holder has just finished
        raise taken from None
    try:
        lock_now(held, folder)
        if not new.exists() or not os.path.samestat(os.fstat(held), new.stat()):
            raise taken
        try:
            with writable(folder):
                for left in new.iterdir():  # by a process that was killed
                    shutil.rmtree(left) if left.is_dir() else left.unlink()
            yield new
            with writable(folder):
                folder.mkdir(exist_ok=True)
                for file in sorted(new.iterdir()):
                    file.replace(folder / file.name)
        finally:
            shutil.rmtree(new, ignore_errors=True)
    finally:
        os.close(held)


def lock_now(
    held: int, path: Path, field: str = "out", taken: InputError | None = None
) -> None:
    """Lock an open file or folder, of descriptor `held`, as long as it is open.

    Raises:
        InputError: `taken`, or one that names `path` as `field`: another process holds
            the lock; or the file system has no locks, as some network and FUSE file
            systems (errors 37, 95).
    """
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise taken or InputError(field, str(path), UNHELD) from None
    except OSError as error:
        allowed = f"a place on a file system with locks, such as a local disk ({error.strerror})"
        raise InputError(field, str(path), allowed) from None


def require_writable(path: Path, field: str = "out") -> None:
    """Refuse a file or folder that can be neither written nor made; nothing is touched.

    Raises:
        InputError: naming the path, as `field`.
    """
    with writable(path, field):
        with suppress(FileNotFoundError, NotADirectoryError):
            path.stat()  # refuses a name that is too long, for which `exists` is False on 3.14
        nearest = next(
            each for each in (path, *path.absolute().parents) if each.exists()
        )
        if nearest != path and not nearest.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, f"{nearest} is no folder")
        if not os.access(nearest, os.W_OK | (os.X_OK if nearest.is_dir() else 0)):
            raise PermissionError(errno.EACCES, f"{nearest} cannot be written")


def require_folder(path: Path, field: str = "out") -> None:
    """Refuse a folder that can be neither written to nor made; nothing is touched.

    Raises:
        InputError: naming the path, as `field`.
    """
    require_writable(path, field)
    if path.exists() and not path.is_dir():
        raise InputError(field, str(path), "a folder")


def require_named(folder: Path) -> None:
    """Refuse a folder that `together` cannot fill; nothing is touched.

    Raises:
        InputError: it has no name, such as /; or as `require_folder`.
    """
    if not folder.resolve().name:
        raise InputError("out", str(folder), "a folder that has a name")
    require_folder(folder)


def remove_orphans(path: Path) -> None:
    """Remove temporary siblings of a file that no process holds."""
    for file in path.parent.iterdir():
        if file.name.startswith(f".{path.name}.") and file.name.endswith(
            TEMPORARY_SUFFIX
        ):
            with suppress(OSError):  # locked, gone, or another user's
                # it has its name; closing it would end SQLite's locks
                if file.stat().st_nlink > 1:
                    file.unlink()
                    continue
                with file.open("ab") as orphan:
                    fcntl.flock(orphan, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    file.unlink()


def sync(path: Path) -> None:
    """Have the system put a file's or a folder's content on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
