"""The folder of a store. The folder is the state; this class knows every file in it.

specification.json   written first: what the store is to hold
part-00000.parquet   a shard; done when it opens, is undamaged and its footer is as expected
search-up-00000.parquet   a generation of a search under way
repertoire.parquet   what the search tried and chose; done when the search is over
manifest.json        written last: SHA-256 of every shard
kind.json            of a store that a cluster fills: what its workers compute with
.lock                held by the one process that writes
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from storage.chosen import REPERTOIRE_NAME, RepertoireFile
from storage.claim import claimed, remove
from storage.document import FORMAT, agree, document_hash
from storage.generation_files import GENERATION_PATTERN, GenerationFiles
from storage.kind import KIND_NAME
from storage.manifest import MANIFEST_NAME, Manifest
from storage.schema import columns_of
from storage.shard import (
    SHARD_PATTERN,
    file_hash,
    read_columns,
    read_footer,
    shard_name,
    write_table,
)
from storage.specification import Specification
from taichi_nmm.errors import InputError

SPECIFICATION_NAME = "specification.json"
REMEDY = "another --out; or --fresh, which starts over"


@dataclass(frozen=True)
class StoreFolder:
    """A folder being filled; made by `claim`, which gives one process the right to write."""

    path: Path
    specification: Specification

    @staticmethod
    @contextmanager
    def claim(path: Path, specification: Specification, fresh: bool) -> Iterator["StoreFolder"]:
        """Hold the folder: new, or begun with the same specification, or emptied by `fresh`.

        Raises:
            InputError: in use by another process, not a store, a store of another specification,
                or not writable.
        """
        with claimed(path, SPECIFICATION_NAME, "a store"):
            _require_files(path)
            if fresh:
                remove(path, MANIFEST_NAME, SHARD_PATTERN, GENERATION_PATTERN)
                remove(path, REPERTOIRE_NAME, KIND_NAME, SPECIFICATION_NAME)
            agree(path / SPECIFICATION_NAME, specification.document, remedy=REMEDY)
            yield StoreFolder(path, specification)

    @property
    def generations(self) -> GenerationFiles:
        """The files of a search under way."""
        return GenerationFiles(self.path, self.specification.hash, self._names)

    @property
    def repertoire(self) -> RepertoireFile:
        """The file of a search that is over."""
        first_row = self.specification.samples
        return RepertoireFile(
            self.path / REPERTOIRE_NAME, self.specification.hash, self._names, first_row
        )

    def finish_search(self) -> None:
        """Remove the generations: the repertoire holds all of them."""
        remove(self.path, GENERATION_PATTERN)

    def missing(self) -> list[int]:
        """Shards that are not done: absent, damaged, or of something else."""
        known = self._known_hashes()
        numbers = range(self.specification.shard_count)
        return [number for number in numbers if not self._is_done(number, known)]

    def write_shard(self, number: int, table: pa.Table, computed_by: dict[str, Any]) -> None:
        """Commit one shard; `computed_by` names code, engine and architecture."""
        remove(self.path, MANIFEST_NAME)  # it would speak of the shard that this one replaces
        footer = self._expected_footer(number) | {
            **computed_by,
            "seed": self.specification.seed,
            "specification": self.specification.document,
        }
        write_table(self.path / shard_name(number), table, footer)

    def write_manifest(self) -> None:
        """Commit the list of all shards, which finishes the store."""
        names = [shard_name(number) for number in range(self.specification.shard_count)]
        hashes = {name: file_hash(self.path / name) for name in names}
        specification = self.specification
        Manifest(specification.document, specification.rows, hashes).write(self.path)

    def _expected_footer(self, number: int) -> dict[str, Any]:
        _, rows = self.specification.shard_range(number)
        footer = {
            "format": FORMAT,
            "specification_hash": self.specification.hash,
            "shard": number,
            "rows": rows,
        }
        if number < self.specification.grid_shards:
            return footer
        # Its points are those of one search; a search on another machine may have found others.
        return footer | {"repertoire": self._repertoire_hash()}

    def _repertoire_hash(self) -> str | None:
        """SHA-256 of the repertoire's file; None while it is not there."""
        path = self.path / REPERTOIRE_NAME
        return file_hash(path) if path.exists() else None

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.specification.parameters)

    def _is_done(self, number: int, known_hashes: dict[str, str]) -> bool:
        path = self.path / shard_name(number)
        try:
            footer, schema = read_footer(path)
            read_columns(path)
        except InputError:
            return False
        expected = self._expected_footer(number).items() <= footer.items()
        expected &= document_hash(footer["specification"]) == self.specification.hash
        same_columns = columns_of(schema) == self.specification.document["columns"]
        return expected and same_columns and known_hashes.get(path.name) in (None, file_hash(path))

    def _known_hashes(self) -> dict[str, str]:
        """Hashes in the manifest of an earlier run, where there is one."""
        try:
            return Manifest.read(self.path).hashes
        except InputError:
            return {}


def _require_files(path: Path) -> None:
    """Refuse a folder that has the name of a file of ours: it would be noticed after the work."""
    for pattern in (MANIFEST_NAME, SPECIFICATION_NAME, REPERTOIRE_NAME, SHARD_PATTERN):
        for file in sorted(path.glob(pattern)):
            if file.is_dir():
                raise InputError("out", str(file), "a file there, not a folder; or another --out")
