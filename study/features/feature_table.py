"""Tables of candidates of this project: those of anybody, and those that a store of gaits makes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from optuna.distributions import BaseDistribution

from study.sampler.candidate_table import COLUMN_CHECKS, CandidateTable
from study.sampler.checked_rows import Bounds, make_rows
from study.sampler.points import new_matrix
from study.sampler.rows import Rows
from taichi_nmm import checks
from taichi_nmm.errors import InputError


class FeatureTable(CandidateTable):
    """A `CandidateTable` that also reads a store of this project, without being told its columns.

    Make one by `from_arrays`, `from_dataframe` or `from_parquet`.
    """

    @classmethod
    @checks.checked(parameters=checks.optional(checks.each(checks.text)), **COLUMN_CHECKS)
    def from_parquet(
        cls,
        path: str | Path,
        *,
        features: Sequence[str],
        parameters: Sequence[str] | None = None,
        space: Mapping[str, BaseDistribution] | None = None,
        bounds: Bounds | None = None,
    ) -> Self:
        """Columns of a Parquet file, of a folder of them, or of a store.

        Args:
            path: a file; a folder of files; or a store of this project (folder, shard or merged
                file), whose parameters and bounds are known and need not be given.
            features: columns to compare rows by, k of them.
            parameters: columns that the study will suggest, d of them; None: `path` is a store.
            space: distributions of some or all parameters; by default those of `from_arrays`.
            bounds: as in `from_arrays`; None: of a store, those that it was made with.

        Raises:
            InputError: no such file, store or column, or what `from_arrays` refuses.
        """
        from study.sampler.parquet import ParquetColumns  # PyArrow is slow to load

        place, names = Path(path).absolute(), tuple(features)
        own_space = None if space is None else dict(space)
        own_bounds = None if bounds is None else dict(bounds)
        reload: ParquetColumns | StoreColumns
        if parameters is None:
            reload = StoreColumns(place, names, own_space, own_bounds)
        else:
            reload = ParquetColumns(place, names, tuple(parameters), own_space, own_bounds)
        return cls(reload(), reload, place)


@dataclass(frozen=True)
class StoreColumns:
    """The store that a table was read from: calling it reads it (again).

    Attributes:
        path: of the store.
        features: k columns of it.
        space: distributions of some parameters.
        bounds: (low, high) of some parameters; None: those of the store.
    """

    path: Path
    features: tuple[str, ...]
    space: Mapping[str, BaseDistribution] | None
    bounds: Bounds | None

    def __call__(self) -> Rows:
        """A store knows its parameters, those beside the 16 gains too, and their bounds."""
        from storage.store import open_store  # PyArrow is slow to load
        from study.sampler.parquet import filled, require_features

        require_features(self.features)
        store = open_store(self.path)
        store.require_bounds()
        ranges = store.specification["gains"]
        bounds = {name: (ends["low"], ends["high"]) for name, ends in ranges.items()}
        others = [name for name in store.columns if name not in bounds]
        for name in self.features:
            if name not in others:
                raise InputError("score", name, f"one of {', '.join(others)}")
        names, matrix = (*bounds, *self.features), new_matrix(len(store), len(bounds))
        features = np.empty((len(store), len(self.features)))
        filled((matrix, features), store.tables(names))
        columns = dict(zip(bounds, matrix.T, strict=True))
        return make_rows(columns, features, self.features, self.bounds or bounds, self.space)
