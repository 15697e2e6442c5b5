"""Grounds and bodies as JSON values: a name or a number for people, and a digest of the rest."""

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.body import Bodies
from taichi_nmm.terrain import Terrain

DIGEST_DECIMALS = 9  # nanometres: below what another machine's last bit can change


def terrain_document(terrains: tuple[Terrain, ...]) -> dict[str, str]:
    """The grounds of one kind: the first one's name, and the digest of all heights."""
    heights = np.array([terrain.height_m for terrain in terrains])
    return {"name": terrains[0].name, "sha256": _digest(heights)}


def body_document(disturbance: float, bodies: Bodies) -> dict[str, Any]:
    """Bodies by their largest relative disturbance and the digest of all their numbers."""
    numbers = np.stack([bodies.mass_kg, bodies.inertia_kgm2, bodies.com_m])
    return {"disturbance": disturbance, "sha256": _digest(numbers)}


def _digest(values: NDArray[np.float64]) -> str:
    """SHA-256 of an array's numbers, rounded; adding zero turns -0.0 into 0.0."""
    return hashlib.sha256((np.round(values, DIGEST_DECIMALS) + 0.0).tobytes()).hexdigest()
