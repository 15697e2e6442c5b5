"""One shard: a Parquet file whose footer says what it is part of."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from storage.commit import commit
from storage.document import FORMAT
from taichi_nmm.errors import InputError
from taichi_nmm.reading import parse_json, reading

FOOTER_KEY = b"taichi_nmm"
FOOTER_NEEDS = {"format", "rows", "shard", "specification", "specification_hash"}
SHARD_PATTERN = "part-*.parquet"
HASH_BLOCK_BYTES = 1 << 20


def shard_name(number: int) -> str:
    """File name of a shard."""
    return f"part-{number:05d}.parquet"


def write_table(path: Path, table: pa.Table, footer: dict[str, Any]) -> None:
    """Commit a table with its footer; the same table and footer give the same bytes.

    Raises:
        InputError: the folder cannot be written or the disk is full; nothing is left behind.
    """
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


def footer_of(file: pq.ParquetFile) -> dict[str, Any] | None:
    """What the footer says; None in a Parquet file of somebody else."""
    try:
        return parse_json((file.schema_arrow.metadata or {})[FOOTER_KEY])
    except (KeyError, ValueError, RecursionError):
        return None


def read_footer(path: Path) -> tuple[dict[str, Any], pa.Schema]:
    """Footer and columns of a shard or a merged file.

    Raises:
        InputError: missing, truncated, not Parquet, or not of this project.
    """
    allowed = "a Parquet file that is whole"
    with reading("store", path, allowed) as whole, pq.ParquetFile(whole) as file:
        footer, schema, rows = footer_of(file), file.schema_arrow, file.metadata.num_rows
        schema.names  # noqa: B018  # refuses those that are no text
    if footer is None or not footer.keys() >= FOOTER_NEEDS:
        raise InputError("store", str(path), "a file whose footer has a store's specification")
    if footer["format"] != FORMAT:
        raise InputError("store", str(path), f"format {FORMAT}, not {footer['format']!r}")
    if footer["rows"] != rows:
        raise InputError("store", str(path), f"a file of {footer['rows']!r} rows, not {rows}")
    footer["rows"] = rows  # a whole number, which 1.0 or true are not
    return footer, schema.remove_metadata()


def read_columns(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Columns of a file, every page checked against its checksum.

    Raises:
        InputError: the file cannot be read, is damaged, or has gaps, which no store has.
    """
    with reading("store", path, "an undamaged Parquet file") as file:
        table = pq.read_table(
            file, columns=columns, page_checksum_verification=True, partitioning=None
        )
        for name in table.column_names:  # which may be no text
            if table[name].null_count:
                raise InputError("store", str(path), f"a file whose {name} has no gaps")
    return table.replace_schema_metadata(None)


def read_own(path: Path, footer: dict[str, Any]) -> pa.Table:
    """All columns of a file that has exactly this footer.

    Raises:
        InputError: the file cannot be read, is damaged, or is something else.
    """
    allowed = "a Parquet file that is whole"
    with reading("store", path, allowed) as whole, pq.ParquetFile(whole) as file:
        if footer_of(file) != footer:
            raise ValueError("of something else")
    return read_columns(path)


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes.

    Raises:
        InputError: the file cannot be read.
    """
    digest = hashlib.sha256()
    with reading("store", path, "a file that can be read") as whole, whole.open("rb") as file:
        while block := file.read(HASH_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()
