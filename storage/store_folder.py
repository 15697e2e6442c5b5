"""The folder of a store. The folder is the state; this class knows every file in it.

specification.json   written first: what the store is to hold
part-00000.parquet   a shard; done when it opens, is undamaged and its footer is as expected
manifest.json        written last: SHA-256 of every shard
.lock                held by the one process that writes
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from storage.claim import claimed, remove
from storage.document import FORMAT, agree
from storage.manifest import MANIFEST_NAME, Manifest
from storage.schema import columns_of
from storage.shard import file_hash, read_columns, read_footer, shard_name, write_table
from storage.specification import Specification
from taichi_nmm.errors import InputError

SPECIFICATION_NAME = "specification.json"
SHARD_PATTERN = "part-*.parquet"
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
            if fresh:
                remove(path, MANIFEST_NAME, SHARD_PATTERN, SPECIFICATION_NAME)
            agree(path / SPECIFICATION_NAME, specification.document, remedy=REMEDY)
            yield StoreFolder(path, specification)

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
        Manifest(specification.document, specification.samples, hashes).write(self.path)

    def _expected_footer(self, number: int) -> dict[str, Any]:
        _, rows = self.specification.shard_range(number)
        return {
            "format": FORMAT,
            "specification_hash": self.specification.hash,
            "shard": number,
            "rows": rows,
        }

    def _is_done(self, number: int, known_hashes: dict[str, str]) -> bool:
        path = self.path / shard_name(number)
        try:
            footer, schema = read_footer(path)
            read_columns(path)
        except InputError:
            return False
        expected = self._expected_footer(number).items() <= footer.items()
        same_columns = columns_of(schema) == self.specification.document["columns"]
        return expected and same_columns and known_hashes.get(path.name) in (None, file_hash(path))

    def _known_hashes(self) -> dict[str, str]:
        """Hashes in the manifest of an earlier run, where there is one."""
        try:
            return Manifest.read(self.path).hashes
        except InputError:
            return {}
