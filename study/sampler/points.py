"""Candidates as numbers: features and unit-cube coordinates, in memory or in a file.

Tables may have tens of millions of rows. A proposal needs all features, and of the parameters those
of a few rows. So the parameters of a large table lie in a file without a name, a column after the
other, which ends with the process; memory holds what is used.
"""

import mmap
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]

MOST_IN_MEMORY = 2**26  # numbers: 512 MiB
BLOCK = 2**18  # rows at a time


def new_matrix(rows: int, columns: int) -> Floats:
    """An [n, d] matrix without content.

    Raises:
        InputError: a large one, for which the folder of temporary files has no space.
    """
    if rows * columns <= MOST_IN_MEMORY:
        return np.empty((rows, columns))
    size = rows * columns * np.dtype(np.float64).itemsize
    try:
        with tempfile.TemporaryFile() as file:
            if hasattr(os, "posix_fallocate"):  # a full disk would end the process later
                os.posix_fallocate(file.fileno(), 0, size)
            file.truncate(size)
            mapping = mmap.mmap(file.fileno(), size)
    except OSError as error:
        allowed = f"{size / 2**30:.1f} GiB of space for temporary files ({error.strerror}): TMPDIR"
        raise InputError("table", f"{rows} rows", allowed) from None
    return np.frombuffer(mapping).reshape((rows, columns), order="F")


def by_blocks(function: Callable[[Floats], Floats], matrix: Floats) -> Floats:
    """What a function makes of the rows of a matrix, [n, e]; of a large one some at a time."""
    if matrix.size <= MOST_IN_MEMORY:
        return function(matrix)
    made = new_matrix(len(matrix), function(matrix[:1]).shape[1])
    for first in range(0, len(matrix), BLOCK):
        block = slice(first, first + BLOCK)
        made[block] = function(matrix[block])
        for each in (matrix, made):
            let_go(each)
    return made


def side_by_side(left: Floats, right: Floats) -> Floats:
    """The columns of two matrices, [n, k] and [n, e], in one."""
    if left.size + right.size <= MOST_IN_MEMORY:
        return np.hstack([left, right])
    made = new_matrix(len(left), left.shape[1] + right.shape[1])
    for column, source in zip(columns_of(made), (*left.T, *right.T), strict=True):
        column[:] = source
        let_go(source)
    return made


def rows_of(matrix: Floats, index: NDArray[Any]) -> Floats:
    """Some rows, by number or by mask."""
    if matrix.size <= MOST_IN_MEMORY:
        some: Floats = matrix[index]
        return some
    return np.column_stack([column[index] for column in columns_of(matrix)])


def columns_of(matrix: Floats) -> Iterator[Floats]:
    """The columns, [n] each, one after the other; those of a file leave memory again."""
    for column in matrix.T:
        yield column
        let_go(matrix)


def let_go(matrix: Floats) -> None:
    """Have what was read or written of a large matrix leave memory: the file keeps it."""
    owner: object = matrix
    while isinstance(owner, np.ndarray):
        owner = owner.base
    if isinstance(owner, memoryview):
        owner = owner.obj
    if isinstance(owner, mmap.mmap):
        owner.madvise(mmap.MADV_DONTNEED)


@dataclass(frozen=True, eq=False)
class Points:
    """m candidates or trials.

    Attributes:
        features: in standard units, [m, k]; k may be 0.
        coordinates: in the unit cube, [m, e]; e may be 0.
    """

    features: Floats
    coordinates: Floats

    def __len__(self) -> int:
        """Number of points, m."""
        return len(self.features)

    def matrix(self, block: slice = slice(None)) -> Floats:
        """All or some of them, [m, k + e]."""
        let_go(self._stacked)  # of a large table what was read before
        return self._stacked[block]

    @cached_property
    def _stacked(self) -> Floats:
        """All of them, made once."""
        if not self.coordinates.shape[1]:
            return self.features
        return side_by_side(self.features, self.coordinates)

    @cached_property
    def distinct(self) -> tuple[Floats, NDArray[np.int64]]:
        """Of a single feature: its values in ascending order, and the place of each row, [m]."""
        values, place = np.unique(self.features[:, 0], return_inverse=True)
        return values, place

    def take(self, index: NDArray[Any]) -> "Points":
        """Some of them, by number or by mask."""
        return Points(self.features[index], rows_of(self.coordinates, index))

    def only(self, *, features: bool, coordinates: bool) -> "Points":
        """With the columns that a kernel uses."""
        if (features or not self.features.size) and (coordinates or not self.coordinates.size):
            return self
        return Points(
            self.features if features else self.features[:, :0],
            self.coordinates if coordinates else self.coordinates[:, :0],
        )
