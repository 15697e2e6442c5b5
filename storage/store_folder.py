"""The folder of a store that is being filled.

specification.json   written first: the configuration of the store
part-00000.parquet   a shard; done when it opens, is undamaged and its footer is as expected
search-up-00000.parquet   a generation of a search under way
repertoire.parquet   all candidates that the search tried and chose; written when it is over
manifest.json        written last: SHA-256 of every shard
kind.json            the kind of the workers, where a cluster fills the store
.lock                held by the one process that writes
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage import store
from storage.folder import Folder, remove
from storage.inputs.errors import InputError
from storage.layout import Layout
from storage.pool import KIND_NAME
from storage.simulator import PARAMETERS_KEY
from storage.tables import (
    FORMAT,
    document_hash,
    file_hash,
    read_about,
    read_columns,
    write_table,
)

SPECIFICATION_NAME = "specification.json"
REPERTOIRE_NAME = "repertoire.parquet"
GENERATION_PATTERN = "search-*.parquet"

NOT_CHOSEN = -1
FAMILY, GENERATION, ROW = "family", "generation", "row"  # columns of the repertoire

Tried = dict[str, NDArray[Any]]
"""Columns by name: points that a search has tried, and their results."""


@dataclass(frozen=True)
class StoreFolder(Folder):
    """The folder of a store; its document is the specification's."""

    KIND = "a store"
    FIRST = SPECIFICATION_NAME
    REMEDY = "another --out; or --fresh, which starts over"
    FILES = (
        store.MANIFEST_NAME,
        store.SHARD_PATTERN,
        GENERATION_PATTERN,
        REPERTOIRE_NAME,
        KIND_NAME,
    )

    @cached_property
    def layout(self) -> Layout:
        """Which rows are in which shard."""
        return Layout.of(self.document)

    def missing(self) -> list[int]:
        """Shards that are not done: absent, damaged, or of something else."""
        try:
            known = store.Manifest.read(self.path).hashes  # of an earlier run
        except InputError:
            known = {}
        return [
            number
            for number in range(self.layout.shards)
            if not self._is_done(number, known)
        ]

    def write_shard(
        self, number: int, table: pa.Table, computed_by: dict[str, Any]
    ) -> None:
        """Commit one shard; `computed_by` names code, engine and architecture."""
        # it would list the shard that this one replaces
        remove(self.path, store.MANIFEST_NAME)
        footer = self._expected_footer(number) | {
            **computed_by,
            "seed": self.document["seed"],
            "specification": self.document,
        }
        write_table(self.path / store.shard_name(number), table, footer)

    def write_manifest(self) -> None:
        """Commit the list of all shards, which finishes the store."""
        names = [store.shard_name(number) for number in range(self.layout.shards)]
        hashes = {name: file_hash(self.path / name) for name in names}
        store.Manifest(self.document, self.layout.rows, hashes).write(self.path)

    def read_grid(self, columns: list[str]) -> pa.Table:
        """Columns of all shards of the grid, which is complete."""
        files = (
            self.path / store.shard_name(number)
            for number in range(self.layout.grid_shards)
        )
        return pa.concat_tables(read_columns(file, columns) for file in files)

    def write_generation(self, family: str, number: int, tried: Tried) -> None:
        """Commit a generation of a search: whole or not at all."""
        table = pa.table({name: np.ascontiguousarray(tried[name]) for name in tried})
        name, footer = self._generation(family, number)
        write_table(self.path / name, table, footer)

    def read_generation(
        self, family: str, number: int, columns: Sequence[str]
    ) -> Tried | None:
        """These columns of a generation; None where there is none, or a damaged one."""
        return self._read(*self._generation(family, number), columns)

    def write_repertoire(
        self, found: Mapping[str, list[Tried]], chosen: Mapping[str, NDArray[np.int64]]
    ) -> None:
        """Commit all generations of a search, and which points become rows, by family."""
        tables, row = [], self.layout.samples
        for family, generations in found.items():
            sizes = [len(next(iter(tried.values()))) for tried in generations]
            rows = np.full(sum(sizes), NOT_CHOSEN)
            rows[chosen[family]] = row + np.arange(len(chosen[family]))
            row += len(chosen[family])
            columns: dict[str, Any] = {
                FAMILY: np.full(len(rows), family),
                GENERATION: np.repeat(np.arange(len(sizes)), sizes),
                ROW: rows,
            }
            names = generations[0]
            columns |= {
                n: np.concatenate([tried[n] for tried in generations]) for n in names
            }
            tables.append(pa.table(columns))
        write_table(self.path / REPERTOIRE_NAME, pa.concat_tables(tables), self._footer)

    def read_repertoire(self) -> NDArray[np.float64] | None:
        """The candidates in the order of their rows, [c, p]; None: the search is not over."""
        parameters = list(self.document[PARAMETERS_KEY])
        tried = self._read(REPERTOIRE_NAME, self._footer, [*parameters, ROW])
        if tried is None:
            return None
        rows = tried.pop(ROW)
        points = np.column_stack(list(tried.values()))[np.argsort(rows, kind="stable")]
        return points[np.count_nonzero(rows == NOT_CHOSEN) :]

    @cached_property
    def _footer(self) -> dict[str, Any]:
        """With which each file of this store begins."""
        return {"format": FORMAT, "specification_hash": document_hash(self.document)}

    def _generation(self, family: str, number: int) -> tuple[str, dict[str, Any]]:
        """Name and footer of a generation's file."""
        footer = self._footer | {"family": family, "generation": number}
        return f"search-{family}-{number:05d}.parquet", footer

    def _read(
        self, name: str, footer: dict[str, Any], columns: Sequence[str]
    ) -> Tried | None:
        """Columns of a file with this footer; None where there is none, or a damaged one."""
        path = self.path / name
        try:
            if read_about(path)[0] != footer:
                return None
            table = read_columns(path)
            return {column: table[column].to_numpy() for column in columns}
        except (InputError, KeyError):
            return None

    def _expected_footer(self, number: int) -> dict[str, Any]:
        _, rows = self.layout.shard_range(number)
        footer = self._footer | {"shard": number, "rows": rows}
        if number < self.layout.grid_shards:
            return footer
        # Its points are those of one search; a search on another machine may have found
        # others.
        path = self.path / REPERTOIRE_NAME
        return footer | {"repertoire": file_hash(path) if path.exists() else None}

    def _is_done(self, number: int, known_hashes: dict[str, str]) -> bool:
        path = self.path / store.shard_name(number)
        try:
            footer, schema = store.read_footer(path)
            read_columns(path)
        except InputError:
            return False
        expected = self._expected_footer(number).items() <= footer.items()
        expected &= (
            document_hash(footer["specification"]) == self._footer["specification_hash"]
        )
        same_columns = store.columns_of(schema) == self.document["columns"]
        return (
            expected
            and same_columns
            and known_hashes.get(path.name) in (None, file_hash(path))
        )
