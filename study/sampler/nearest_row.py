"""The row of a table that is nearest to a point off it, and how far away it is."""

import numpy as np
from numpy.typing import NDArray

from study.sampler.rows import Rows

Floats = NDArray[np.float64]


class NearestRow:
    """Distances from the rows that may be proposed, each computed once a process.

    A distance is the root mean square, over the d parameters, of how far two points are apart in
    the unit cube: a parameter's whole range is 1 (of a logarithmic one, the range of its logarithm;
    outside the range it goes on), and two different choices are 1 apart. At a distance of 0.05,
    parameters differ by a twentieth of their ranges.

    Args:
        rows: of the table; those without features, or equal to an earlier one, are left out.
    """

    def __init__(self, rows: Rows) -> None:
        self.rows = rows
        self._known: dict[bytes, tuple[int, float]] = {}

    def of(self, parameters: Floats) -> tuple[int, float]:
        """The nearest row of a point [d], of equal ones the first, and its distance.

        Where no row may be proposed, the distance is infinite.
        """
        key = parameters.tobytes()
        if key not in self._known:
            self._known[key] = self._measure(parameters)
        return self._known[key]

    def _measure(self, parameters: Floats) -> tuple[int, float]:
        """The same, computed."""
        numbers, coordinates = self.rows.numbers, self.rows.chosen_unit
        if not len(numbers):
            return 0, np.inf
        point = self.rows.space.unbounded(parameters[None])[0]
        squares = np.zeros(len(numbers))
        for column, value in enumerate(point):  # column by column: no second table is made
            squares += (coordinates[:, column] - value) ** 2
        best = int(np.argmin(squares))
        return int(numbers[best]), float(np.sqrt(squares[best] / len(parameters)))
