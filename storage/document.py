"""A specification as JSON values: hashed, compared, and the format's version."""

import hashlib
import json
from typing import Any

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
