"""Stores that travel to workers, which share no disk with whoever reads the configuration."""

import hashlib
import io
import tarfile
from dataclasses import dataclass
from pathlib import Path

from storage.store import MANIFEST_NAME, Manifest
from taichi_nmm.reading import reading


@dataclass(frozen=True)
class Freight:
    """A store, packed.

    Attributes:
        digest: SHA-256 of the package, by which workers keep it.
        package: a tar of the store's files.
    """

    digest: str
    package: bytes

    @property
    def place(self) -> Path:
        """Where calls find the store, seen from the folder that they run in."""
        return Path("stores", self.digest, "store")

    def unpack(self, folder: Path) -> None:
        """Lay the store down at its place in a folder; nothing where it is there."""
        target = folder / self.place.parent
        if target.exists():
            return
        with tarfile.open(fileobj=io.BytesIO(self.package)) as tar:
            tar.extractall(target, filter="data")


def packed(path: Path) -> Freight:
    """A store's folder, or the one file that it is.

    Raises:
        InputError: a file of it cannot be read.
    """
    whole = io.BytesIO()
    with tarfile.open(fileobj=whole, mode="w") as tar:
        if path.is_dir():
            for name in (MANIFEST_NAME, *Manifest.read(path).hashes):
                _add(tar, path / name, f"store/{name}")
        else:
            _add(tar, path, "store")
    package = whole.getvalue()
    return Freight(hashlib.sha256(package).hexdigest(), package)


def _add(tar: tarfile.TarFile, path: Path, name: str) -> None:
    """The content alone: neither dates nor owners, which would make two packages of one store."""
    with reading("store", path, "a file that can be read") as file:
        content = file.read_bytes()
    about = tarfile.TarInfo(name)
    about.size = len(content)
    tar.addfile(about, io.BytesIO(content))
