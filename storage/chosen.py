"""What a search found, and which of it become rows of the store: repertoire.parquet."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from storage.document import FORMAT
from storage.gait_measures import cells
from storage.generation_files import Generation
from storage.shard import read_own, write_table
from taichi_nmm.errors import InputError
from taichi_nmm.reading import reading

REPERTOIRE_NAME = "repertoire.parquet"
NOT_CHOSEN = -1
FAMILY, GENERATION, ROW = "family", "generation", "row"


def choose(
    found: dict[str, list[Generation]], shares: dict[str, int]
) -> dict[str, NDArray[np.int64]]:
    """Candidates of each family.

    Half of a family's are the best of a cell each, which keeps gaits apart; the others the best of
    all, however alike: of two gaits that do the same on the search's settings, one may walk on a
    body where the other falls. The grid's own points are rows already.

    Args:
        found: generations by family; the first one is the grid's.
        shares: how many of a family, by its name.

    Returns:
        By family, numbers of points, counted through its generations; the best come first.
    """
    chosen = {}
    for family, generations in found.items():
        share = shares[family]
        objective = np.concatenate([one.objective for one in generations])
        cell = cells(np.concatenate([one.measures for one in generations]))
        best = np.argsort(-objective, kind="stable")
        best = best[best >= len(generations[0].points)]
        _, first = np.unique(cell[best], return_index=True)
        elites = best[np.sort(first)][: share // 2]
        others = best[~np.isin(best, elites)][: share - len(elites)]
        both = np.concatenate([elites, others])
        chosen[family] = both[np.argsort(-objective[both], kind="stable")]
    return chosen


@dataclass(frozen=True)
class RepertoireFile:
    """The file of a store in which all points stand that its search tried.

    Attributes:
        path: of the file.
        specification_hash: of the store.
        names: of the parameters, [16 + k].
        first_row: of the store's candidates.
    """

    path: Path
    specification_hash: str
    names: tuple[str, ...]
    first_row: int

    def write(
        self, found: dict[str, list[Generation]], chosen: dict[str, NDArray[np.int64]]
    ) -> None:
        """Commit what a search found and what was chosen of it."""
        tables, row = [], self.first_row
        for family, generations in found.items():
            sizes = [len(one.points) for one in generations]
            rows = np.full(sum(sizes), NOT_CHOSEN)
            rows[chosen[family]] = row + np.arange(len(chosen[family]))
            row += len(chosen[family])
            columns: dict[str, Any] = {
                FAMILY: np.full(len(rows), family),
                GENERATION: np.repeat(np.arange(len(sizes)), sizes),
                ROW: rows,
            }
            parts = [one.columns(self.names) for one in generations]
            columns |= {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
            tables.append(pa.table(columns))
        write_table(self.path, pa.concat_tables(tables), self._footer())

    def read(self) -> NDArray[np.float64] | None:
        """The candidates in the order of their rows, [n, 16 + k]; None: the search is not over."""
        try:
            with reading("store", self.path, "a repertoire") as path:
                table = read_own(path, self._footer())
                rows = table[ROW].to_numpy()
                points = np.column_stack([table[name].to_numpy() for name in self.names])
                points = points[np.argsort(rows, kind="stable")]
                return points[np.count_nonzero(rows == NOT_CHOSEN) :]
        except InputError:
            return None

    def _footer(self) -> dict[str, Any]:
        return {"format": FORMAT, "specification_hash": self.specification_hash}
