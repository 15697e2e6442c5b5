"""Parquet files with a footer of ours: written whole, checked when read; documents of folders.

A document is of JSON values: hashed, compared, agreed upon. The footer of a *stamped*
table has the document of its folder and a digest of its content. Both are checked when
the table is read again, so that a file of another folder, or one that was edited, is
refused. They find mistakes, not malice: anybody who edits a table can make its digest
too.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage.commit import commit, commit_json
from storage.inputs.documents import difference as difference
from storage.inputs.documents import differs as differs
from storage.inputs.errors import InputError
from storage.inputs.reading import json_document, parse_json, reading

if TYPE_CHECKING:
    from pyarrow import parquet as pq

FORMAT = 1  # of specification.json, manifest.json and the footers
FOOTER_KEY = b"taichi_nmm"
# in a stamped table's footer; files older than the key have none
DIGEST_KEY = "content_sha256"
MOST_ROWS = 10**8  # 0.8 GB a column; a hundred times the largest store of docs/


def write_table(path: Path, table: pa.Table, footer: dict[str, Any]) -> None:
    """Commit a table with its footer; the same table and footer give the same bytes.

    Raises:
        InputError: the folder cannot be written or the disk is full; nothing is left
            behind.
    """
    from pyarrow import parquet as pq  # here and below: a text does without

    stamped = table.replace_schema_metadata({FOOTER_KEY: json.dumps(footer)})
    words = [field.name for field in table.schema if pa.types.is_string(field.type)]

    def write(temporary: Path) -> None:
        pq.write_table(
            stamped,
            temporary,
            compression="zstd",
            use_dictionary=words,  # a dictionary of floats is larger than the floats
            write_page_checksum=True,  # a reader finds a flipped bit with no manifest at hand
        )

    def check(temporary: Path) -> None:
        with pq.ParquetFile(temporary) as file:
            if footer_of(file) != footer or file.metadata.num_rows != len(table):
                raise OSError("what was read back differs from what was written")

    commit(path, write, check)


def footer_of(file: "pq.ParquetFile") -> dict[str, Any] | None:
    """The footer; None in a Parquet file of somebody else."""
    try:
        return parse_json((file.schema_arrow.metadata or {})[FOOTER_KEY])
    except (KeyError, ValueError, RecursionError):
        return None


def read_any(
    file: Path | pa.BufferReader, columns: Sequence[str] | None = None
) -> pa.Table:
    """Columns of anybody's Parquet file; pages that have a checksum are checked against it.

    Raises:
        ValueError: more than `MOST_ROWS`: a value repeated for ever takes a few bytes
            of a file.
    """
    from pyarrow import parquet as pq

    with pq.ParquetFile(
        file, page_checksum_verification=True
    ) as whole:  # faster than `read_table`
        rows = whole.metadata.num_rows
        if rows > MOST_ROWS:
            raise ValueError(f"it has {rows:,} rows, and {MOST_ROWS:,} are allowed")
        return (
            whole.read()
            if columns is None
            else whole.read(list(columns)).select(list(columns))
        )


def read_columns(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Columns of a file, every page checked against its checksum.

    Raises:
        InputError: the file cannot be read, is damaged, or has gaps, which no store
            has.
    """
    with reading("store", path, "an undamaged Parquet file") as file:
        table = read_any(file, columns)
        for name in table.column_names:  # which may be no text
            if table[name].null_count:
                raise InputError("store", str(path), f"a file whose {name} has no gaps")
    return table.replace_schema_metadata(None)


def read_about(path: Path) -> tuple[dict[str, Any] | None, pa.Schema, int]:
    """Footer, as of `footer_of`, schema and number of rows of a file.

    Raises:
        InputError: the file cannot be read, or is damaged.
    """
    from pyarrow import parquet as pq

    allowed = "a Parquet file that is whole"
    with reading("store", path, allowed) as whole, pq.ParquetFile(whole) as file:
        file.schema_arrow.names  # noqa: B018  # refuses those that are no text
        return (
            footer_of(file),
            file.schema_arrow.remove_metadata(),
            file.metadata.num_rows,
        )


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes.

    Raises:
        InputError: the file cannot be read.
    """
    with (
        reading("store", path, "a file that can be read") as whole,
        whole.open("rb") as file,
    ):
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_stamped(path: Path, table: pa.Table, document: dict[str, Any]) -> None:
    """Commit a table with the document of its folder.

    Raises:
        InputError: the folder cannot be written or the disk is full; nothing is left
            behind.
    """
    write_table(path, table, document | {DIGEST_KEY: table_digest(table)})


def read_stamped(
    path: Path, document: dict[str, Any], growing: tuple[str, ...] = ()
) -> pa.Table:
    """The table of a file of this folder that is as it was written.

    Of `growing` dictionaries of the folder's document, the file may have fewer entries.

    Raises:
        InputError: damaged, without a document, of another one, or with other content.
    """
    table = read_columns(path)
    footer, _, _ = read_about(path)
    digest: Any = None
    found: tuple[str, Any, Any] | None = ("document", "", "missing")
    if footer is not None:
        digest = footer.pop(DIGEST_KEY, None)
        try:
            found = differs(document, footer, growing)
        except (AttributeError, TypeError):  # of other types than a document's
            found = ("document", "", "damaged")
    if found:
        name, ours, theirs = found
        allowed = (
            f"a file of this folder, whose {name} is {ours!r}; in the file's footer: "
        )
        raise InputError("out", str(path), f"{allowed}{theirs!r}")
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


def document_hash(document: dict[str, Any]) -> str:
    """SHA-256 of a document, whatever its layout in a file."""
    return hashlib.sha256(
        json.dumps(document, separators=(",", ":")).encode()
    ).hexdigest()


def agree(
    path: Path,
    document: dict[str, Any],
    *,
    growing: tuple[str, ...] = (),
    remedy: str,
    write: bool = True,
) -> dict[str, Any]:
    """Write the document into the file of a new folder; in an old one, check that it is the same.

    Calls add to `growing` dictionaries of the document; where missing in the file, they
    are empty. Without `write` the file is neither made nor does it get what this call
    adds.

    Returns:
        The document that is then in the file, or would be.

    Raises:
        InputError: the file cannot be read or written, or has another document; the
            `remedy`, such as "another --out", ends the line.
    """
    known: dict[str, Any] = {}
    if path.exists():
        allowed = f"a readable {path.stem}; or {remedy}"
        known = json_document("out", path, allowed)
        with reading("out", path, allowed):
            found = differs(document, known, growing)
        if found:
            name, here, there = found
            raise InputError(
                name or path.stem, here, f"{there!r}, as {path} says; or {remedy}"
            )
    grown = {
        key: dict(sorted((known.get(key, {}) | document[key]).items()))
        for key in growing
    }
    whole = document | grown
    if write and (not path.exists() or (growing and whole != known)):
        commit_json(path, whole)
    return whole


def plain(column: pa.Array | pa.ChunkedArray) -> NDArray[Any]:
    """A column as an array, [n].

    By DLPack where that does: `to_numpy` loads pandas, which takes longer than to read
    a store.
    """
    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    if pa.types.is_boolean(column.type) and not column.null_count:
        return plain(column.cast(pa.uint8())).astype(np.bool_)
    if pa.types.is_primitive(column.type) and not column.null_count:
        return np.from_dlpack(column)
    return np.asarray(column.to_numpy(zero_copy_only=False))
