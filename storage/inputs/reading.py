"""The one reader of files that a user names: every fault of a file is an error of one line.

A file is not trusted. It may be a pipe without a writer, be packed a thousandfold, be
nested a hundred thousand deep, or hold a number of five thousand digits. Other packages
read Parquet files within `reading`.
"""

import json
import os
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from storage.inputs.errors import InputError

# of a text, unpacked: a hundred times the longest of this project
MOST_BYTES = 16 << 20
DEEPEST = 100  # tables and lists in each other
PACKED_BY = {".gz": "gzip", ".bz2": "bz2", ".xz": "lzma", ".lzma": "lzma"}


@contextmanager
def reading(field: str, path: str | Path, allowed: str) -> Iterator[Path]:
    """A file for the block to read; an exception of the block becomes an error of one line.

    Args:
        field: that named the file.
        path: of the file.
        allowed: a description of usable files: "a Parquet file that is whole".

    Raises:
        InputError: it is missing, no regular file, cannot be opened, or the block
            raised.
    """
    try:
        file = Path(path)
        if not stat.S_ISREG(file.stat().st_mode):
            raise ValueError("not a regular file")
        yield file
    except InputError:
        raise
    except Exception as error:  # parsers raise anything, down to RecursionError
        raise InputError(field, str(path), f"{allowed} ({_reason(error)})") from None


def read_text(field: str, path: str | Path, allowed: str) -> str:
    """The text of a UTF-8 file; one that is packed (.gz, .bz2, .xz, .lzma) is unpacked.

    Raises:
        InputError: as of `reading`; or the text is longer than `MOST_BYTES`.
    """
    with reading(field, path, allowed) as file:
        packed_by = PACKED_BY.get(file.suffix.lower())
        with (
            import_module(packed_by).open(file)
            if packed_by
            else file.open("rb") as stream
        ):
            content: bytes = stream.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise ValueError(f"longer than {MOST_BYTES >> 20} MiB")
        return content.decode("utf-8-sig")  # some programs begin a text with a mark


def json_document(field: str, path: str | Path, allowed: str) -> dict[str, Any]:
    """The JSON object of a file.

    Raises:
        InputError: as of `read_text`; or the text is no JSON object, or one with a key
            twice.
    """
    text = read_text(field, path, allowed)
    with reading(field, path, allowed):
        return parse_json(text)


def toml_document(field: str, path: str | Path, allowed: str) -> dict[str, Any]:
    """The top table of a TOML file.

    Raises:
        InputError: as of `read_text`; or the text is no TOML.
    """
    text = read_text(field, path, allowed)
    with reading(field, path, allowed):
        return _shallow(tomllib.loads(text))


def parse_json(text: str | bytes) -> dict[str, Any]:
    """The JSON object of a text that is in no file.

    Raises:
        ValueError, RecursionError: no JSON object, a key twice, or nested deeper than
            `DEEPEST`.
    """
    document = json.loads(text, object_pairs_hook=_each_once)
    if not isinstance(document, dict):
        raise ValueError("no JSON object")
    return _shallow(document)


def is_folder(path: str | Path) -> bool:
    """Whether it is a folder; a name that no file can have is none."""
    return os.path.isdir(path)  # noqa: PTH112  (pathlib raises for such a name)


def is_there(path: str | Path) -> bool:
    """Whether anything has this name; of a name that no file can have, nothing does."""
    return os.path.exists(path)  # noqa: PTH110


def is_file(path: str | Path) -> bool:
    """Whether it is a regular file; a name that no file can have is none."""
    return os.path.isfile(path)  # noqa: PTH113


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON, unless a key comes twice: either value may be the intended one."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key {key!r} comes twice")
        found[key] = value
    return found


def _shallow(document: dict[str, Any]) -> dict[str, Any]:
    """The document, unless it is nested so deep that recursion through it may fail."""
    level: list[Any] = [document]
    for _ in range(DEEPEST):
        level = [child for node in level for child in _children(node)]
        if not level:
            return document
    raise ValueError(f"nested deeper than {DEEPEST}")


def _children(node: Any) -> list[Any]:
    if isinstance(node, dict):
        return list(node.values())
    return node if isinstance(node, list) else []


def _reason(error: Exception) -> str:
    """The message of an error, in one line."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return (str(error).splitlines() or [type(error).__name__])[0]
