"""A folder whose files are the state of some work: one process fills it, any later one goes on.

Its first file is the document, which describes the work. Other work in this folder is
refused.
"""

import fnmatch
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import pyarrow as pa

from storage.commit import TEMPORARY_SUFFIX, lock_now, require_folder, writable
from storage.inputs.errors import InputError
from storage.tables import agree, read_stamped, write_stamped

LOCK_NAME = ".lock"
UNFINISHED = f".*{TEMPORARY_SUFFIX}"


@dataclass(frozen=True)
class Folder:
    """A folder being filled; made by `claim`, which gives one process the right to write.

    A child sets the names of its files.

    Attributes:
        path: of the folder.
        document: what describes the work, as JSON values.
        KIND: of folder, for messages: "a store".
        FIRST: name of the document's file.
        GROWING: dictionaries of the document to which calls add.
        REMEDY: what a user may do where the document is another one.
        FILES: patterns of all other files, in the order of their removal.
    """

    path: Path
    document: dict[str, Any]

    KIND: ClassVar[str]
    FIRST: ClassVar[str]
    GROWING: ClassVar[tuple[str, ...]] = ()
    REMEDY: ClassVar[str] = "another --out"
    FILES: ClassVar[tuple[str, ...]] = ()

    @classmethod
    @contextmanager
    def claim(
        cls, path: Path, document: dict[str, Any], fresh: bool = False
    ) -> Iterator[Self]:
        """Hold the folder: new, or begun with the same document, or emptied by `fresh`.

        Files that were never finished are removed.

        Raises:
            InputError: in use by another process, of something else, of another
                document, or not writable.
        """
        cls._require_claimable(path)
        with writable(path):
            path.mkdir(parents=True, exist_ok=True)
            # never removed: another process may hold it
            lock = (path / LOCK_NAME).open("a")
        with lock:
            lock_now(lock.fileno(), path)
            remove(path, UNFINISHED)
            # a folder would be met after the work
            for pattern in (cls.FIRST, *cls.FILES):
                for file in sorted(path.glob(pattern)):
                    if file.is_dir():
                        allowed = "a file there, not a folder; or another --out"
                        raise InputError("out", str(file), allowed)
            if fresh:  # the document goes last: it tells whose folder this is
                remove(path, *cls.FILES, cls.FIRST)
            yield cls(path, cls._agree(path, document))

    @classmethod
    def check(cls, path: Path, document: dict[str, Any]) -> Self:
        """The folder that `claim` would hold, if no other process does; nothing is written.

        Raises:
            InputError: of something else, of another document, or not writable.
        """
        cls._require_claimable(path)
        return cls(path, cls._agree(path, document, write=False))

    def read_state(self, name: str, schema: pa.Schema, content: str) -> pa.Table:
        """A table of this schema that `write_state` wrote; empty where there is none.

        Messages say what it holds, its `content`.

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
    def _require_claimable(cls, path: Path) -> None:
        """Refuse a folder that holds something else, whose files would be overwritten."""
        with writable(path):
            require_folder(path)
            names = {file.name for file in path.iterdir()} if path.is_dir() else set()
        foreign = sorted(names - {LOCK_NAME, *fnmatch.filter(names, UNFINISHED)})
        if foreign and cls.FIRST not in names:
            allowed = f"an empty folder or {cls.KIND} (this has {foreign[0]})"
            raise InputError("out", str(path), allowed)

    @classmethod
    def _agree(
        cls, path: Path, document: dict[str, Any], write: bool = True
    ) -> dict[str, Any]:
        file, growing = path / cls.FIRST, cls.GROWING
        return agree(file, document, growing=growing, remedy=cls.REMEDY, write=write)


def remove(path: Path, *patterns: str) -> None:
    """Remove the files of a folder whose names match, pattern after pattern."""
    with writable(path):
        for pattern in patterns:
            for file in path.glob(pattern):
                file.unlink()
