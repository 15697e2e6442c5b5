"""A table of a folder that goes on: its footer says what folder it is of, and digests its content.

Both are checked where the table is read again, so that a file of another folder, or one that was
edited, is refused. They find mistakes, not malice: who edits a table can make its digest too.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from storage.document import differs
from storage.shard import footer_of, read_columns, write_table
from taichi_nmm.errors import InputError
from taichi_nmm.reading import reading

DIGEST_KEY = "content_sha256"  # in the footer; folders of before it existed have none, and go on


def write_stamped(path: Path, table: pa.Table, document: dict[str, Any]) -> None:
    """Commit a table with the document of its folder.

    Raises:
        InputError: the folder cannot be written or the disk is full; nothing is left behind.
    """
    write_table(path, table, document | {DIGEST_KEY: table_digest(table)})


def read_stamped(path: Path, document: dict[str, Any], growing: tuple[str, ...] = ()) -> pa.Table:
    """The table, found to be of this folder and as it was written.

    Args:
        path: of the file.
        document: of the folder.
        growing: dictionaries of the document to which calls add; the table may have fewer entries.

    Raises:
        InputError: damaged, without a document, of another one, or with other content.
    """
    table = read_columns(path)
    with pq.ParquetFile(path) as file:
        footer = footer_of(file)
    digest = None if footer is None else footer.pop(DIGEST_KEY, None)
    try:
        found = (
            ("document", "", "missing") if footer is None else differs(document, footer, growing)
        )
    except (AttributeError, TypeError):  # of other types than a document's
        found = ("document", "", "damaged")
    if found:
        name, ours, theirs = found
        allowed = (
            f"a file of this folder, whose {name} is {ours!r}; in the file's footer: {theirs!r}"
        )
        raise InputError("out", str(path), allowed)
    with reading("out", path, "columns of strings, numbers and flags, none missing"):
        own = table_digest(table)
    if digest not in (None, own):
        allowed = "the file as it was written; its content does not fit the digest in its footer"
        raise InputError("out", str(path), allowed)
    return table


def table_digest(table: pa.Table) -> str:
    """SHA-256 of columns of strings, numbers and flags without nulls, in any version of Arrow."""
    digest = hashlib.sha256()
    for field in table.schema:
        digest.update(json.dumps([field.name, str(field.type), len(table)]).encode())
        column = table[field.name]
        if pa.types.is_string(field.type):
            digest.update(json.dumps(column.to_pylist()).encode())
        else:
            digest.update(np.ascontiguousarray(column.to_numpy()).tobytes())
    return digest.hexdigest()
