"""Files of a search under way: each generation of each family, whole or not at all.

They are read again in their order, and the search is where it was. They go when it is over.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage.document import FORMAT
from storage.gait_measures import MEASURE_NAMES, OBJECTIVE
from storage.shard import read_own, write_table
from taichi_nmm.errors import InputError
from taichi_nmm.reading import reading

GENERATION_PATTERN = "search-*.parquet"


@dataclass(frozen=True, eq=False)
class Generation:
    """Points that were tried for a family at a time, and what came of them.

    Attributes:
        points: [n, 16 + k], within the bounds.
        objective: [n]; see `storage.gait_measures`.
        measures: [n, m].
    """

    points: NDArray[np.float64]
    objective: NDArray[np.float64]
    measures: NDArray[np.float64]

    def columns(self, names: tuple[str, ...]) -> dict[str, NDArray[np.float64]]:
        """All of it by column; `names` are those of the parameters."""
        columns = dict(zip(names, self.points.T, strict=True))
        columns[OBJECTIVE] = self.objective
        # A gait's measures are on other settings than a row's columns of the same names.
        return columns | {
            tried_name(name): values
            for name, values in zip(MEASURE_NAMES, self.measures.T, strict=True)
        }


def tried_name(measure: str) -> str:
    """Column of a measure, on the settings of the search."""
    return f"tried_{measure}"


@dataclass(frozen=True)
class GenerationFiles:
    """The files of one store's search.

    Attributes:
        folder: of the store.
        specification_hash: of the store.
        names: of the parameters, [16 + k].
    """

    folder: Path
    specification_hash: str
    names: tuple[str, ...]

    def write(self, family: str, number: int, generation: Generation) -> None:
        """Commit a generation."""
        table = pa.table(
            {
                name: np.ascontiguousarray(values)
                for name, values in generation.columns(self.names).items()
            }
        )
        write_table(self._path(family, number), table, self._footer(family, number))

    def read(self, family: str, number: int, points: NDArray[np.float64]) -> Generation | None:
        """The generation of these points; None where there is none, or one that is damaged.

        On another machine the search may ask other points, in their last bits: then it was not
        this generation, and what follows is tried again too.
        """
        try:
            with reading("store", self._path(family, number), "a generation") as path:
                table = read_own(path, self._footer(family, number))
                tried, objective, measures = (
                    np.column_stack([table[name].to_numpy() for name in names])
                    for names in (self.names, (OBJECTIVE,), map(tried_name, MEASURE_NAMES))
                )
        except InputError:
            return None
        if not np.array_equal(tried, points):
            return None
        return Generation(tried, objective[:, 0], measures)

    def _path(self, family: str, number: int) -> Path:
        return self.folder / f"search-{family}-{number:05d}.parquet"

    def _footer(self, family: str, number: int) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "specification_hash": self.specification_hash,
            "family": family,
            "generation": number,
        }
