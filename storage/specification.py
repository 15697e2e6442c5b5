"""What a store holds: everything that decides its numbers, and nothing else.

Architecture and threads are not part of it, so a store begun on one machine is finished on another.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pyarrow as pa

from storage.digests import body_document, terrain_document
from storage.document import FORMAT, document_hash
from storage.families import (
    LONGEST_DURATION_S,
    ROBUST,
    SHORTEST_DURATION_S,
    Family,
    read_bodies,
    read_families,
)
from storage.schema import arrow_schema, columns_of
from storage.searched import searched_parameters
from storage.seeds import BODY, TERRAIN, seed_sequence
from storage.sobol import LARGEST_SEQUENCE
from taichi_nmm import __version__
from taichi_nmm.body import Bodies
from taichi_nmm.config import Table, read_settings, read_terrain
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAINS, LOW_LEVEL_GAINS, Parameter
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import Terrain

SHARD_ROWS = 4096  # seconds of work on two cores, and a few MB


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
        families: further settings for the points that survive.
        searched: low-level gains that are part of the points, after the 16 gains.
    """

    samples: int
    shard_rows: int
    seed: int
    duration_s: float
    settings: Settings
    disturbance: float
    body: Bodies
    terrain: Terrain
    families: tuple[Family, ...] = ()
    searched: tuple[Parameter, ...] = ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What a point consists of, [16 + k]."""
        return (*GAINS, *self.searched)

    @property
    def schema(self) -> pa.Schema:
        """The columns of every shard."""
        searched = [parameter.name for parameter in self.searched]
        return arrow_schema(searched, [family.name for family in self.families])

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
                gain.name: {"low": float(gain.low), "high": float(gain.high)}
                for gain in self.parameters
            },
            "low_level_gains": {
                gain.name: float(gain.default)
                for gain in LOW_LEVEL_GAINS
                if gain not in self.searched
            },
            "simulation": {
                "duration_s": self.duration_s,
                "physics_step_s": self.settings.physics_step_s,
                "contact_relaxation_speed_mps": self.settings.contact_relaxation_speed_mps,
                "precision": self.settings.precision,
            },
            "terrain": terrain_document((self.terrain,)),
            "body": body_document(self.disturbance, self.body),
            **self._family_documents(),
            "columns": columns_of(self.schema),
        }

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the document."""
        return document_hash(self.document)

    def _family_documents(self) -> dict[str, Any]:
        """The key "families" is newer than many stores, so it appears only where it is needed."""
        documents = {family.name: family.document for family in self.families}
        robust = documents.pop(ROBUST, None)
        return {"robust": robust} | ({"families": documents} if documents else {})


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
    disturbance, body = read_bodies(table.table("body"), seed, BODY, 1)
    families = read_families(table, duration_s)
    searched = searched_parameters(table.texts("searched"))
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
        families=families,
        searched=searched,
    )


def _checked_samples(samples: int) -> int:
    if not 1 <= samples <= LARGEST_SEQUENCE:
        raise InputError("samples", samples, f"a whole number from 1 to {LARGEST_SEQUENCE}")
    return samples
