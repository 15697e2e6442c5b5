"""The walks of a block: what several arms try on one robot is simulated once.

Arms that read one store often propose the same row. The robot of a run is the same for all of them,
and a walk has the same bits in any company, so the first walk stands for all.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from study.experiment.experiment import Experiment
from study.experiment.trials import costs, finite, simulate_trials

Floats = NDArray[np.float64]
Rows = NDArray[np.void]


class Walks:
    """What came of walks, by run and gains."""

    def __init__(self) -> None:
        """None yet."""
        self._found: dict[tuple[int, bytes], tuple[np.void, float]] = {}

    def add(self, run: int, gains: Floats, rows: Rows, cost: Floats) -> None:
        """Keep walks of a run that are known: gains [n, 16 + k], rows [n], cost [n]."""
        for tried, row, value in zip(gains, rows, cost.tolist(), strict=True):
            self._found.setdefault((run, tried.tobytes()), (row.copy(), value))

    def walk(
        self, experiment: Experiment, runs: Sequence[int], gains: Floats
    ) -> tuple[Rows, Floats]:
        """Rows of the simulator, finite, and costs of n trials, [n]; what is new is simulated.

        Args:
            experiment: of the trials.
            runs: of each, [n].
            gains: the searched parameters of each, [n, 16 + k].

        Raises:
            InputError: what the simulator refuses.
        """
        keys = [(run, tried.tobytes()) for run, tried in zip(runs, gains, strict=True)]
        first = {key: place for place, key in reversed(list(enumerate(keys)))}
        new = sorted(place for key, place in first.items() if key not in self._found)
        if new:
            tried = [runs[place] for place in new]
            rows = finite(simulate_trials(experiment, tried, gains[new]).rows)
            for place, row, value in zip(new, rows, costs(rows, experiment.cost), strict=True):
                self._found[keys[place]] = (row.copy(), float(value))
        found = [self._found[key] for key in keys]
        return np.array([row for row, _ in found]), np.array([value for _, value in found])
