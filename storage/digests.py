"""Digests of arrays; grounds and bodies as JSON values, named for people and digested."""

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.body import Bodies
from taichi_nmm.terrain import Terrain
from taichi_nmm.world import WorldRanges, Worlds

DIGEST_DECIMALS = 9  # nanometres: below what another machine's last bit can change


def array_digest(*arrays: NDArray[np.float64]) -> str:
    """SHA-256 of the arrays' numbers, one after the other, rounded; -0.0 counts as 0.0."""
    digest = hashlib.sha256()
    for values in arrays:
        digest.update((np.round(values, DIGEST_DECIMALS) + 0.0).tobytes())
    return digest.hexdigest()


def terrain_document(terrains: tuple[Terrain, ...]) -> dict[str, str]:
    """The grounds of one kind: the first one's name, and the digest of all heights."""
    heights = array_digest(*(terrain.height_m for terrain in terrains))
    return {"name": terrains[0].name, "sha256": heights}


def body_document(disturbance: float, bodies: Bodies) -> dict[str, Any]:
    """Bodies by their largest relative disturbance and the digest of all their numbers."""
    numbers = array_digest(bodies.mass_kg, bodies.inertia_kgm2, bodies.com_m)
    return {"disturbance": disturbance, "sha256": numbers}


def world_document(ranges: WorldRanges, worlds: Worlds) -> dict[str, Any]:
    """Worlds by what they were drawn from and the digest of all their numbers; {}: nominal ones.

    The key "world" is newer than many stores, so it appears only where it is needed.
    """
    if not (drawn_from := ranges.document()):
        return {}
    numbers = array_digest(*vars(worlds).values())
    return {"world": drawn_from | {"sha256": numbers}}
