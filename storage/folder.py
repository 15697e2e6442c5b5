"""A folder whose files are the state of some work: one process fills it, any later one goes on.

The first file is the document: what the folder is to hold. Work with another document is refused.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import pyarrow as pa

from storage.commit import TEMPORARY_SUFFIX, lock_now, require_folder, writable
from storage.document import agree, agreed
from storage.tables import read_stamped, write_stamped
from taichi_nmm.errors import InputError

LOCK_NAME = ".lock"


@dataclass(frozen=True)
class Folder:
    """A folder being filled; made by `claim`, which gives one process the right to write.

    A child sets the names of its files.

    Attributes:
        path: of the folder.
        document: of the folder, as JSON values.
    """

    path: Path
    document: dict[str, Any]

    KIND: ClassVar[str]  # of folder, for messages: "a store"
    FIRST: ClassVar[str]  # name of the document's file
    GROWING: ClassVar[tuple[str, ...]] = ()  # dictionaries of the document to which calls add
    REMEDY: ClassVar[str] = "another --out"  # where the document is another one
    FILES: ClassVar[tuple[str, ...]] = ()  # patterns of all others, in the order of their removal

    @classmethod
    @contextmanager
    def claim(cls, path: Path, document: dict[str, Any], fresh: bool = False) -> Iterator[Self]:
        """Hold the folder: new, or begun with the same document, or emptied by `fresh`.

        Raises:
            InputError: in use by another process, of something else, of another document, or not
                writable.
        """
        with claimed(path, cls.FIRST, cls.KIND):
            cls._require_files(path)
            if fresh:
                remove(path, *cls.FILES, cls.FIRST)  # the document last: it says whose folder it is
            yield cls(
                path, agree(path / cls.FIRST, document, growing=cls.GROWING, remedy=cls.REMEDY)
            )

    @classmethod
    def check(cls, path: Path, document: dict[str, Any]) -> Self:
        """The folder that `claim` would hold, if no other process does; nothing is written.

        Raises:
            InputError: of something else, of another document, or not writable.
        """
        require_claimable(path, cls.FIRST, cls.KIND)
        known = agreed(path / cls.FIRST, document, growing=cls.GROWING, remedy=cls.REMEDY)
        return cls(path, known)

    def read_state(self, name: str, schema: pa.Schema, content: str) -> pa.Table:
        """A table that `write_state` wrote; empty where there is none.

        Args:
            name: of its file.
            schema: its columns.
            content: what it holds, for messages.

        Raises:
            InputError: damaged, edited, of another folder, or with other columns.
        """
        path = self.path / name
        if not path.exists():
            return schema.empty_table()
        table = read_stamped(path, self.document, self.GROWING)
        if not table.schema.equals(schema):
            raise InputError("out", str(path), f"{content}, in this version's form")
        return table

    def write_state(self, name: str, table: pa.Table) -> None:
        """Commit a table with the folder's document and a digest of the content."""
        write_stamped(self.path / name, table, self.document)

    @classmethod
    def _require_files(cls, path: Path) -> None:
        """Refuse a folder within it that has a file's name: it would be noticed after the work."""
        for pattern in (cls.FIRST, *cls.FILES):
            for file in sorted(path.glob(pattern)):
                if file.is_dir():
                    allowed = "a file there, not a folder; or another --out"
                    raise InputError("out", str(file), allowed)


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
        remove(path, f".*{TEMPORARY_SUFFIX}")
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
    foreign = sorted(name for name in names if name != LOCK_NAME and not _is_temporary(name))
    if foreign and first not in names:
        raise InputError("out", str(path), f"an empty folder or {kind} (this has {foreign[0]})")


def remove(path: Path, *patterns: str) -> None:
    """Remove the files of a folder whose names match, pattern after pattern."""
    with writable(path):
        for pattern in patterns:
            for file in path.glob(pattern):
                file.unlink()


def _is_temporary(name: str) -> bool:
    return name.startswith(".") and name.endswith(TEMPORARY_SUFFIX)
