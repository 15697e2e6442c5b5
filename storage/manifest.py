"""The list of a finished store's shards with their SHA-256: written last, it says "finished"."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from storage.commit import commit_json
from storage.document import FORMAT, document_hash
from taichi_nmm.errors import InputError

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
        if not path.exists():
            raise InputError("store", str(folder), f"a finished store: it has a {MANIFEST_NAME}")
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            hashes = {shard["file"]: shard["sha256"] for shard in document["shards"]}
            manifest = Manifest(document["specification"], int(document["rows"]), hashes)
            sound = document_hash(manifest.specification) == document["specification_hash"]
        except (OSError, ValueError, KeyError, TypeError):
            sound = False
        if not sound:
            raise InputError("store", str(path), "an undamaged manifest: run precompute.py again")
        return manifest
