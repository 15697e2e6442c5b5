"""Damage to what a Parquet file holds, its columns and its footer, and to what a database holds."""

import hashlib
import json
import sqlite3
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from numpy.random import Generator

from storage.document import document_hash
from storage.shard import FOOTER_KEY
from storage.stamped import DIGEST_KEY, table_digest
from tests.fuzz.damage import damaged_document
from tests.fuzz.hostile import VALUES, chance, pick

TYPES = (
    pa.int8(), pa.int32(), pa.int64(), pa.uint64(), pa.float16(), pa.float32(), pa.float64(),
    pa.string(), pa.large_string(), pa.binary(), pa.bool_(), pa.null(), pa.timestamp("s"),
    pa.list_(pa.float64()), pa.dictionary(pa.int32(), pa.string()), pa.decimal128(20, 2),
)  # fmt: skip
DEFERRED = "PRAGMA ignore_check_constraints = ON"


def damaged_columns(rng: Generator, path: Path) -> None:
    """Write the file again: a column dropped, renamed, doubled, of another type, with other values.

    Its footer stays; a digest in it is made to fit, so that a reader must look at the values.
    """
    table = pq.read_table(path, partitioning=None)
    footer = table.schema.metadata
    for _ in range(1 + int(rng.exponential(0.4))):
        table = other_table(rng, table.replace_schema_metadata(None))
    if footer and FOOTER_KEY in footer:
        document = json.loads(footer[FOOTER_KEY])
        if DIGEST_KEY in document and chance(rng, 0.8):
            with suppress(Exception):  # of types that have no digest
                document[DIGEST_KEY] = table_digest(table)
        table = table.replace_schema_metadata({FOOTER_KEY: json.dumps(document)})
    pq.write_table(table, path, compression="zstd", write_page_checksum=True)


def other_table(rng: Generator, table: pa.Table) -> pa.Table:
    """A table with one change."""
    place = int(rng.integers(table.num_columns)) if table.num_columns else 0
    rows = len(table)
    kind = int(rng.integers(9))
    if kind == 0 or not table.num_columns:
        return table.slice(int(rng.integers(rows + 1)), int(rng.integers(rows + 1)))
    field = table.schema.field(place)
    if kind == 1:
        return table.remove_column(place)
    if kind == 2:
        names = list(table.column_names)
        names[place] = pick(rng, ("", "a", names[0], names[-1], "\n", f" {names[place]}"))
        return table.rename_columns(names)
    if kind == 3:
        return table.append_column(field, table.column(place))
    if kind == 4:
        return pa.concat_tables([table, table.slice(0, min(rows, 2))])
    if kind == 5:
        return table.take(pa.array(rng.permutation(rows)))
    values = table.column(place).to_pylist()
    if kind == 6:
        return table.set_column(place, field.name, as_column(values, pick(rng, TYPES)))
    for _ in range(pick(rng, (1, 1, 2, rows))):
        if rows:
            values[int(rng.integers(rows))] = pick(rng, VALUES)
    return table.set_column(place, field.name, as_column(values, field.type))


def as_column(values: list[Any], kind: pa.DataType) -> pa.Array:
    """The values as this type; those that are none of it are left out."""
    kept = []
    for value in values:
        try:
            pa.array([value], kind)
        except (pa.ArrowException, TypeError, ValueError, OverflowError):
            value = None
        kept.append(value)
    return pa.array(kept, kind)


def damaged_footer(rng: Generator, path: Path) -> None:
    """Write the file again with a damaged document in its footer, or none, or no JSON.

    Hashes in it are made to fit now and then, so that a reader must look at what is said.
    """
    table = pq.read_table(path, partitioning=None)
    document = damaged_document(rng, json.loads(table.schema.metadata[FOOTER_KEY]))
    if chance(rng, 0.5):
        sign(document)
    text = json.dumps(document).encode()
    metadata = pick(rng, ({FOOTER_KEY: text},) * 20 + (None, {FOOTER_KEY: b"\xff"}, {b"a": text}))
    pq.write_table(
        table.replace_schema_metadata(metadata), path, compression="zstd", write_page_checksum=True
    )
    manifest = path.with_name("manifest.json")
    if manifest.is_file() and chance(rng, 0.5):
        known = json.loads(manifest.read_text())
        for shard in known["shards"]:
            if shard["file"] == path.name:
                shard["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
        if isinstance(document, dict) and "specification" in document:
            known["specification"] = document["specification"]
            sign(known)
        manifest.write_text(json.dumps(known))


def sign(document: Any) -> None:
    """Have the hash of a specification fit it, where there is one."""
    if isinstance(document, dict) and "specification" in document:
        document["specification_hash"] = document_hash(document["specification"])


def damaged_database(rng: Generator, path: Path) -> None:
    """Values of cells replaced, rows dropped or doubled, a table dropped or renamed."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(DEFERRED)
        for _ in range(1 + int(rng.exponential(0.5))):
            with suppress(sqlite3.Error):  # a constraint that stands in the way
                change_database(rng, connection)
        connection.commit()
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def change_database(rng: Generator, connection: sqlite3.Connection) -> None:
    """One change."""
    names = [
        row[0]
        for row in connection.execute(
            "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite%'"
            " ORDER BY name"
        )
    ]
    name = pick(rng, names)
    columns = [row[1] for row in connection.execute(f'PRAGMA table_info("{name}")')]
    column = pick(rng, columns)
    rows = connection.execute(f'SELECT rowid, "{column}" FROM "{name}" ORDER BY rowid').fetchall()
    kind = int(rng.integers(14))
    if kind == 0:
        connection.execute(f'DROP TABLE "{name}"')
    elif kind == 1:
        connection.execute(f'ALTER TABLE "{name}" RENAME COLUMN "{column}" TO "{column}_"')
    elif not rows:
        return
    elif kind == 2:
        connection.execute(f'DELETE FROM "{name}" WHERE rowid = ?', (pick(rng, rows)[0],))
    elif kind == 3:
        connection.execute(f'DELETE FROM "{name}"')
    elif kind == 4:
        others = ", ".join(f'"{each}"' for each in columns[1:])
        connection.execute(f'INSERT INTO "{name}" ({others}) SELECT {others} FROM "{name}"')
    else:
        row, old = pick(rng, rows)
        value = in_cell(rng, old)
        every = "" if chance(rng, 0.15) else f" WHERE rowid = {row}"
        connection.execute(f'UPDATE "{name}" SET "{column}" = ?{every}', (value,))


def in_cell(rng: Generator, old: Any) -> Any:
    """A value for a cell: of JSON, where there was JSON."""
    if isinstance(old, str):
        with suppress(ValueError):
            document = json.loads(old)
            changed = damaged_document(rng, document) if chance(rng, 0.7) else pick(rng, VALUES)
            return json.dumps(changed) if chance(rng, 0.9) else json.dumps(changed)[:-1]
    value = pick(rng, VALUES)
    if isinstance(value, str):
        return value.encode() if chance(rng, 0.2) else value
    if value is None or isinstance(value, float):
        return value
    if isinstance(value, int) and abs(value) < 2**63:
        return value
    return json.dumps(value)
