"""Documents of folders, as JSON values: hashed, compared, agreed upon; and the format's version."""

import hashlib
import json
from pathlib import Path
from typing import Any

from storage.commit import commit_json
from taichi_nmm.errors import InputError
from taichi_nmm.reading import json_document, reading

FORMAT = 1  # of specification.json, manifest.json and the footers


def document_hash(document: dict[str, Any]) -> str:
    """SHA-256 of a document, whatever its layout in a file."""
    return hashlib.sha256(json.dumps(document, separators=(",", ":")).encode()).hexdigest()


def difference(document: Any, other: Any, name: str = "") -> tuple[str, Any, Any] | None:
    """The first field in which two documents differ, as (dotted name, value, other value)."""
    if isinstance(document, list) and isinstance(other, list):
        document, other = dict(enumerate(document)), dict(enumerate(other))
    if not (isinstance(document, dict) and isinstance(other, dict)):
        return None if document == other else (name, document, other)
    for key in dict.fromkeys([*document, *other]):
        path = f"{name}.{key}" if name else str(key)
        found = difference(document.get(key), other.get(key), path)
        if found:
            return found
    return None


def differs(
    document: dict[str, Any], known: dict[str, Any], growing: tuple[str, ...] = ()
) -> tuple[str, Any, Any] | None:
    """As `difference`; a key that one side of a `growing` dictionary lacks is no difference."""
    ours = document | {key: known.get(key, {}) | document[key] for key in growing}
    theirs = known | {key: document[key] | known.get(key, {}) for key in growing}
    return difference(ours, theirs)


def agree(
    path: Path,
    document: dict[str, Any],
    *,
    growing: tuple[str, ...] = (),
    remedy: str,
    write: bool = True,
) -> dict[str, Any]:
    """Write the document into a new folder; in an old one, check that it is the same.

    Args:
        path: the document's file, which need not be there.
        document: of this call.
        growing: dictionaries of the document to which calls add; where missing in the file, empty.
        remedy: advice for messages: "another --out".
        write: whether the file is made, or gets what the call adds.

    Returns:
        The document that is then in the file, or would be.

    Raises:
        InputError: the file cannot be read or written, or has another document.
    """
    known: dict[str, Any] = {}
    if path.exists():
        allowed = f"a readable {path.stem}; or {remedy}"
        known = json_document("out", path, allowed)
        with reading("out", path, allowed):
            found = differs(document, known, growing)
            grown = {key: known.get(key, {}) | document[key] for key in growing}
        if found:
            name, here, there = found
            raise InputError(name or path.stem, here, f"{there!r}, as {path} says; or {remedy}")
    else:
        grown = {key: document[key] for key in growing}
    whole = document | {key: dict(sorted(values.items())) for key, values in grown.items()}
    if write and (not path.exists() or (growing and whole != known)):
        commit_json(path, whole)
    return whole
