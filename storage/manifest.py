"""The list of a finished store's shards with their SHA-256: written last, it says "finished"."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from storage.commit import commit_json
from storage.document import FORMAT, document_hash
from storage.shard import shard_name
from taichi_nmm.reading import json_document, reading

MANIFEST_NAME = "manifest.json"


@dataclass(frozen=True)
class Manifest:
    """Content of manifest.json.

    Attributes:
        specification: what was computed.
        rows: of the whole store.
        hashes: SHA-256 by file name, in the order of the rows.
    """

    specification: dict[str, Any]
    rows: int
    hashes: dict[str, str]

    def write(self, folder: Path) -> None:
        """Commit it to a folder."""
        document = {
            "format": FORMAT,
            "specification_hash": document_hash(self.specification),
            "rows": self.rows,
            "shards": [{"file": name, "sha256": value} for name, value in self.hashes.items()],
            "specification": self.specification,
        }
        commit_json(folder / MANIFEST_NAME, document)

    @staticmethod
    def read(folder: Path) -> "Manifest":
        """The manifest of a folder.

        Raises:
            InputError: there is none (the store is not finished), or it is damaged.
        """
        path = folder / MANIFEST_NAME
        allowed = "a finished store, which has an undamaged manifest: run precompute.py again"
        document = json_document("store", path, allowed)
        with reading("store", path, allowed):
            return _sound(document)


def _sound(document: dict[str, Any]) -> Manifest:
    """What a manifest says, unless it is none; then whatever is raised tells why."""
    if document["format"] != FORMAT:
        raise ValueError(f"of format {document['format']!r}, not {FORMAT}")
    specification, rows = document["specification"], document["rows"]
    if document_hash(specification) != document["specification_hash"]:
        raise ValueError("its specification has another hash")
    hashes = {shard["file"]: shard["sha256"] for shard in document["shards"]}
    if not hashes or list(hashes) != [shard_name(number) for number in range(len(hashes))]:
        raise ValueError("its shards are not part-00000.parquet and so on, in the same folder")
    if not all(isinstance(value, str) for value in hashes.values()) or type(rows) is not int:
        raise ValueError("rows or hashes that are none")
    return Manifest(specification, rows, hashes)
