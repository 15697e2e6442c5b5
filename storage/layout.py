"""Which rows of a store lie in which of its shards."""

import math
from dataclasses import dataclass
from typing import Any

# At most: nearly all candidates run to the end of every family.
CANDIDATE_SHARD_ROWS = 64


@dataclass(frozen=True)
class Layout:
    """Which rows are in which shard: `samples` of the grid, then `candidates`.

    Attributes:
        samples: rows of the grid.
        shard_rows: rows of one of its shards; the last may have fewer.
        candidates: rows of the repertoire, at most 64 in a shard; 0: there is none.
    """

    samples: int
    shard_rows: int
    candidates: int

    @staticmethod
    def of(document: dict[str, Any]) -> "Layout":
        """The layout of a specification's document."""
        candidates = document.get("repertoire", {}).get("candidates", 0)
        return Layout(
            samples=document["samples"],
            shard_rows=document["shard_rows"],
            candidates=candidates,
        )

    @property
    def rows(self) -> int:
        """Rows of the finished store."""
        return self.samples + self.candidates

    @property
    def grid_shards(self) -> int:
        """Shards of the grid; those of the candidates come after them."""
        return math.ceil(self.samples / self.shard_rows)

    @property
    def shards(self) -> int:
        """Shards of the finished store."""
        return self.grid_shards + math.ceil(self.candidates / self._candidate_rows)

    def shard_range(self, number: int) -> tuple[int, int]:
        """First row of a shard, and how many it has."""
        start, rows, end = 0, self.shard_rows, self.samples
        if number >= self.grid_shards:
            start, rows, end = self.samples, self._candidate_rows, self.rows
            number -= self.grid_shards
        first = start + number * rows
        return first, min(rows, end - first)

    @property
    def _candidate_rows(self) -> int:
        return min(self.shard_rows, CANDIDATE_SHARD_ROWS)
