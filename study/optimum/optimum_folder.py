"""The folder of an estimate. The folder is the state; this class knows every file in it.

search.json           written first: what is estimated, with which versions
evaluations.parquet   every point that CMA-ES tried, rewritten whole at each checkpoint
dog/                  the comparison's folder of the determinants-of-gait sampler
runs.parquet          written at the end: the best of every run of both
optimum.json          written last: the best of all
.lock                 held by the one process that writes
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from storage.commit import commit_json
from storage.document import agree
from storage.folder import claimed
from storage.tables import read_stamped, write_stamped, write_table
from study.experiment.identity import GROWING
from study.experiment.trials import OUTCOMES
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAIN_NAMES

SEARCH_NAME = "search.json"
EVALUATIONS_NAME = "evaluations.parquet"
DOG_NAME = "dog"
RUNS_NAME = "runs.parquet"
OPTIMUM_NAME = "optimum.json"

_TRIED = [
    *((name, pa.float64()) for name in (*GAIN_NAMES, "cost")),
    ("walked", pa.bool_()),
    *((name, pa.float64()) for name in OUTCOMES),
]


def _schema(*first: tuple[str, pa.DataType]) -> pa.Schema:
    columns = [*first, *_TRIED]
    return pa.schema([pa.field(name, kind, nullable=False) for name, kind in columns])


EVALUATIONS = _schema(("run", pa.int32()), ("generation", pa.int32()), ("member", pa.int32()))
RUNS = _schema(
    ("method", pa.string()), ("run", pa.int32()), ("evaluations", pa.int64()), ("stop", pa.string())
)


@dataclass(frozen=True)
class OptimumFolder:
    """A folder being filled; made by `claim`, which gives one process the right to write."""

    path: Path
    document: dict[str, Any]

    @staticmethod
    @contextmanager
    def claim(path: Path, document: dict[str, Any]) -> Iterator["OptimumFolder"]:
        """Hold the folder: new, or begun with the same document.

        Raises:
            InputError: in use by another process, of something else, of another document, or not
                writable.
        """
        with claimed(path, SEARCH_NAME, "one of this command"):
            agree(path / SEARCH_NAME, document, growing=GROWING, remedy="another --out")
            yield OptimumFolder(path, document)

    def read_evaluations(self) -> pa.Table:
        """What CMA-ES has tried, by run, generation and member.

        Raises:
            InputError: a damaged or edited file, or one of something else.
        """
        path = self.path / EVALUATIONS_NAME
        if not path.exists():
            return EVALUATIONS.empty_table()
        table = read_stamped(path, self.document, GROWING)
        if not table.schema.equals(EVALUATIONS):
            raise InputError("out", str(path), "points that CMA-ES tried, in this version's form")
        return table

    def write_evaluations(self, table: pa.Table) -> None:
        """Commit them."""
        write_stamped(self.path / EVALUATIONS_NAME, table, self.document)

    def write_runs(self, table: pa.Table) -> None:
        """Commit the best of every run."""
        write_table(self.path / RUNS_NAME, table, self.document)

    def write_optimum(self, document: dict[str, Any]) -> Path:
        """Commit the result."""
        commit_json(self.path / OPTIMUM_NAME, document)
        return self.path / OPTIMUM_NAME
