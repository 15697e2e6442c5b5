"""What a store holds: everything that decides its numbers, and nothing else.

Architecture and threads are not part of it, so a store begun on one machine is finished on another.
"""

import copy
import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.document import FORMAT, document_hash
from storage.schema import arrow_schema, columns_of
from storage.seeds import BODY, ROBUST_BODY, ROBUST_TERRAIN, TERRAIN, seed_sequence
from storage.sobol import LARGEST_SEQUENCE
from taichi_nmm import __version__
from taichi_nmm.body import Bodies
from taichi_nmm.config import Table, read_settings, read_terrain
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAINS, LOW_LEVEL_GAINS
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import Terrain

SHARD_ROWS = 4096  # seconds of work on two cores, and a few MB
SHORTEST_DURATION_S, LONGEST_DURATION_S = 0.1, 1000.0
LARGEST_DISTURBANCE = 0.9
LARGEST_SETTING_COUNT = 64
DIGEST_DECIMALS = 9  # nanometres: below what another machine's last bit can change


@dataclass(frozen=True, eq=False)
class Robust:
    """Disturbed settings that every point alive at `min_survival_s` is run on, for `horizon_s`.

    Setting k is body k on terrain k; all points share the settings.
    """

    min_survival_s: float
    horizon_s: float
    seed: int
    disturbance: float
    bodies: Bodies
    terrains: tuple[Terrain, ...]


@dataclass(frozen=True, eq=False)
class Specification:
    """A store to be computed: points, shards, physics, and the settings they are run on.

    Attributes:
        samples: points.
        shard_rows: points of a shard; the last may have fewer.
        seed: of the Sobol sequence, and of the body and the terrain where they are drawn.
        duration_s: horizon of every point on `body` and `terrain`.
        settings: the simulator's.
        disturbance: largest relative disturbance that `body` was drawn with.
        body: one body.
        terrain: one ground.
        robust: further settings for the points that survive, or None.
    """

    samples: int
    shard_rows: int
    seed: int
    duration_s: float
    settings: Settings
    disturbance: float
    body: Bodies
    terrain: Terrain
    robust: Robust | None

    @property
    def shard_count(self) -> int:
        """Shards of the finished store."""
        return -(-self.samples // self.shard_rows)

    def shard_range(self, number: int) -> tuple[int, int]:
        """First row of a shard, and how many it has."""
        first = number * self.shard_rows
        return first, min(self.shard_rows, self.samples - first)

    @cached_property
    def document(self) -> dict[str, Any]:
        """All of it as JSON values: what specification.json and the footers carry."""
        return {
            "format": FORMAT,
            "code_version": __version__,  # shards of two simulators must not mix
            "samples": self.samples,
            "shard_rows": self.shard_rows,
            "seed": self.seed,
            "gains": {
                gain.name: {"low": float(gain.low), "high": float(gain.high)} for gain in GAINS
            },
            "low_level_gains": {gain.name: float(gain.default) for gain in LOW_LEVEL_GAINS},
            "simulation": {
                "duration_s": self.duration_s,
                "physics_step_s": self.settings.physics_step_s,
                "contact_relaxation_speed_mps": self.settings.contact_relaxation_speed_mps,
                "precision": self.settings.precision,
            },
            "terrain": _terrain_document((self.terrain,)),
            "body": _body_document(self.disturbance, self.body),
            "robust": None if self.robust is None else _robust_document(self.robust),
            "columns": columns_of(arrow_schema(self.robust is not None)),
        }

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the document."""
        return document_hash(self.document)


def read_specification(
    table: Table, samples: int | None = None, arch: str | None = None
) -> Specification:
    """The specification in a configuration; `samples` and `arch` override the file's.

    Raises:
        InputError: an unknown key, a wrong type or a value out of range.
    """
    configured = table.integer("samples", low=1, high=LARGEST_SEQUENCE)
    seed = table.integer("seed", 0)
    shard_rows = table.integer("shard_rows", SHARD_ROWS, 1, LARGEST_SEQUENCE)
    simulation = table.table("simulation")
    duration_s = simulation.number("duration_s", 5.0, SHORTEST_DURATION_S, LONGEST_DURATION_S)
    settings = read_settings(simulation, arch)
    simulation.done()
    terrain = read_terrain(table.table("terrain"), seed_sequence(seed, TERRAIN))
    disturbance, body = _read_bodies(table.table("body"), seed, BODY, 1)
    robust = _read_robust(table.table("robust"), duration_s)
    table.done()
    return Specification(
        samples=_checked_samples(configured if samples is None else samples),
        shard_rows=shard_rows,
        seed=seed,
        duration_s=duration_s,
        settings=settings,
        disturbance=disturbance,
        body=body,
        terrain=terrain,
        robust=robust,
    )


def _checked_samples(samples: int) -> int:
    if not 1 <= samples <= LARGEST_SEQUENCE:
        raise InputError("samples", samples, f"a whole number from 1 to {LARGEST_SEQUENCE}")
    return samples


def _read_robust(table: Table, duration_s: float) -> Robust | None:
    """The table [robust]; without `settings` (or with 0) there is no robust score."""
    count = table.integer("settings", 0, 0, LARGEST_SETTING_COUNT)
    if count == 0:
        table.done()
        return None
    seed = table.integer("seed", 0)
    disturbance, bodies = _read_bodies(table.table("body"), seed, ROBUST_BODY, count)
    terrain = table.table("terrain")
    robust = Robust(
        min_survival_s=table.number("min_survival_s", 3.0, 0.0, duration_s),
        horizon_s=table.number("horizon_s", 8.0, SHORTEST_DURATION_S, LONGEST_DURATION_S),
        seed=seed,
        disturbance=disturbance,
        bodies=bodies,
        terrains=tuple(
            read_terrain(copy.deepcopy(terrain), seed_sequence(seed, ROBUST_TERRAIN, index))
            for index in range(count)
        ),
    )
    table.done()
    return robust


def _read_bodies(table: Table, seed: int, purpose: int, count: int) -> tuple[float, Bodies]:
    """The table [body]: the largest disturbance, and `count` bodies drawn with it."""
    disturbance = table.number("disturbance", 0.0, 0.0, LARGEST_DISTURBANCE)
    table.done()
    seeds = [seed_sequence(seed, purpose, index) for index in range(count)]
    return disturbance, Bodies.disturbed(seeds, disturbance)


def _robust_document(robust: Robust) -> dict[str, Any]:
    return {
        "settings": len(robust.bodies),
        "min_survival_s": robust.min_survival_s,
        "horizon_s": robust.horizon_s,
        "seed": robust.seed,
        "terrain": _terrain_document(robust.terrains),
        "body": _body_document(robust.disturbance, robust.bodies),
    }


def _terrain_document(terrains: tuple[Terrain, ...]) -> dict[str, str]:
    heights = np.array([terrain.height_m for terrain in terrains])
    return {"name": terrains[0].name, "sha256": _digest(heights)}


def _body_document(disturbance: float, bodies: Bodies) -> dict[str, Any]:
    numbers = np.stack([bodies.mass_kg, bodies.inertia_kgm2, bodies.com_m])
    return {"disturbance": disturbance, "sha256": _digest(numbers)}


def _digest(values: NDArray[np.float64]) -> str:
    """SHA-256 of an array's numbers, rounded; adding zero turns -0.0 into 0.0."""
    return hashlib.sha256((np.round(values, DIGEST_DECIMALS) + 0.0).tobytes()).hexdigest()
