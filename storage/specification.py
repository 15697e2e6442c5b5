"""What a store holds: everything that decides its numbers, and nothing else.

Architecture and threads are not part of it, so a store begun on one machine is finished on another.
"""

from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from typing import Any

import pyarrow as pa

from storage.digests import body_document, terrain_document, world_document
from storage.document import FORMAT, document_hash
from storage.families import (
    LONGEST_DURATION_S,
    ROBUST,
    SHORTEST_DURATION_S,
    Family,
    read_families,
)
from storage.repertoire import Repertoire, read_repertoire
from storage.schema import arrow_schema, columns_of
from storage.searched import searched_parameters
from storage.seeds import BODY, TERRAIN, WORLD, seed_sequence
from storage.sobol import LARGEST_SEQUENCE
from taichi_nmm import __version__
from taichi_nmm.body import Bodies
from taichi_nmm.conditions import Conditions, read_conditions
from taichi_nmm.config import Table
from taichi_nmm.errors import InputError
from taichi_nmm.mujoco_engine import require_mujoco
from taichi_nmm.parameters import GAINS, LOW_LEVEL_GAINS, Parameter
from taichi_nmm.settings import OWN_ENGINE
from taichi_nmm.terrain import Terrain
from taichi_nmm.world import Worlds

DURATION_S = 5.0  # of the base setting, where the file names none
SHARD_ROWS = 4096  # seconds of work on two cores, and a few MB
CANDIDATE_SHARD_ROWS = 64  # at most: nearly all of them walk to the end of every family


@dataclass(frozen=True, eq=False)
class Specification:
    """A store to be computed: points, shards, physics, and the settings they are run on.

    It pickles: any process computes a shard from it.

    Attributes:
        samples: points.
        shard_rows: points of a shard; the last may have fewer.
        seed: of the Sobol sequence, and of the body and the terrain where they are drawn.
        conditions: under which every point is run, the base setting.
        families: further settings for the points that survive.
        searched: low-level gains that are part of the points, after the 16 gains.
        repertoire: how candidates beyond the grid are found; None: there are none.
    """

    samples: int
    shard_rows: int
    seed: int
    conditions: Conditions
    families: tuple[Family, ...] = ()
    searched: tuple[Parameter, ...] = ()
    repertoire: Repertoire | None = None

    @cached_property
    def body(self) -> Bodies:
        """The one of the base setting."""
        return self.conditions.body(seed_sequence(self.seed, BODY))

    @cached_property
    def terrain(self) -> Terrain:
        """The one of the base setting."""
        return self.conditions.terrain(seed_sequence(self.seed, TERRAIN))

    @cached_property
    def world(self) -> Worlds:
        """The one of the base setting."""
        return self.conditions.world(seed_sequence(self.seed, WORLD))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What a point consists of, [16 + k]."""
        return (*GAINS, *self.searched)

    @property
    def schema(self) -> pa.Schema:
        """The columns of every shard."""
        searched = [parameter.name for parameter in self.searched]
        families = [family.name for family in self.families]
        return arrow_schema(searched, families, origin=self.repertoire is not None)

    @property
    def candidates(self) -> int:
        """Rows after those of the grid."""
        return self.repertoire.candidates if self.repertoire else 0

    @property
    def rows(self) -> int:
        """Rows of the finished store."""
        return self.samples + self.candidates

    @property
    def walkers(self) -> int:
        """What there is to do, as progress counts it: rows, and walks of the search."""
        return self.rows + (self.repertoire.walks if self.repertoire else 0)

    @property
    def grid_shards(self) -> int:
        """Shards of the grid; those of the candidates come after them."""
        return -(-self.samples // self.shard_rows)

    @property
    def shard_count(self) -> int:
        """Shards of the finished store."""
        return self.grid_shards - (-self.candidates // self.candidate_shard_rows)

    @property
    def candidate_shard_rows(self) -> int:
        """Candidates of a shard; the last may have fewer."""
        return min(self.shard_rows, CANDIDATE_SHARD_ROWS)

    def shard_range(self, number: int) -> tuple[int, int]:
        """First row of a shard, and how many it has."""
        start, rows, end = 0, self.shard_rows, self.samples
        if number >= self.grid_shards:
            start, rows, end = self.samples, self.candidate_shard_rows, self.rows
            number -= self.grid_shards
        first = start + number * rows
        return first, min(rows, end - first)

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
            "simulation": self.conditions.simulation_document(),
            "terrain": terrain_document((self.terrain,)),
            "body": body_document(self.conditions.disturbance, self.body),
            **world_document(self.conditions.world_ranges, self.world),
            **self._family_documents(),
            **self._engine_document(),
            **({"repertoire": self.repertoire.document} if self.repertoire else {}),
            "columns": columns_of(self.schema),
        }

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the document."""
        return document_hash(self.document)

    def _engine_document(self) -> dict[str, Any]:
        """The version of another engine than our own: shards of two must not mix."""
        engine = self.conditions.settings.engine
        if engine == OWN_ENGINE:
            return {}
        require_mujoco()
        return {"engine_version": version(engine)}

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
    conditions = read_conditions(
        table,
        duration_s=DURATION_S,
        shortest_s=SHORTEST_DURATION_S,
        longest_s=LONGEST_DURATION_S,
        arch=arch,
    )
    families = read_families(table, conditions.duration_s)
    searched = searched_parameters(table.texts("searched"))
    repertoire = read_repertoire(table, families)
    table.done()
    return Specification(
        samples=_checked_samples(configured if samples is None else samples),
        shard_rows=shard_rows,
        seed=seed,
        conditions=conditions,
        families=families,
        searched=searched,
        repertoire=repertoire,
    )


def _checked_samples(samples: int) -> int:
    if not 1 <= samples <= LARGEST_SEQUENCE:
        raise InputError("samples", samples, f"a whole number from 1 to {LARGEST_SEQUENCE}")
    return samples
