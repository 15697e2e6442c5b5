"""A simulator that is asked what points off a table come to in its worlds.

Rows tell of the points between them as far as costs are smooth. Where a step makes a
walker fall they tell little, and trials have to find out. A simulation takes seconds, a
trial of a machine takes far more. So the points that promise most, by what rows tell, are
simulated in all worlds before one of them is proposed, and so is each trial off the table.
"""

from collections.abc import Callable

import numpy as np

from storage.inputs.errors import InputError
from study.sampler.arrays import Floats
from study.sampler.rows import Rows
from study.sampler.worlds import Ensemble, matrix_of

ASKED = 16  # points of each proposal
FIELD = "outcomes(params)"
ROUNDED = 1e-3  # standard deviations that a simulator may be off by rounding


class Asked:
    """A user's function that simulates points, each of them once in a process."""

    def __init__(self, function: Callable[[Floats], Floats]) -> None:
        """Take a function of points [m, d] that returns outcomes as the table has them of rows."""
        self._function = function
        self._known: dict[bytes, Floats] = {}

    def __getstate__(self) -> dict[str, object]:
        """The state without outcomes, which another process asks for again."""
        return self.__dict__ | {"_known": {}}

    def columns(self, parameters: Floats, ensemble: Ensemble) -> Floats:
        """What an ensemble has of points [m, d], [m, k]; NaN where a world tells nothing."""
        keys = [point.tobytes() for point in parameters]
        places = {key: place for place, key in enumerate(keys)}
        new = [key for key in places if key not in self._known]
        if new:
            found = self._simulated(parameters[[places[key] for key in new]])
            ensemble.columns_of(found)  # refused before it is kept
            self._known |= zip(new, found, strict=True)
        return ensemble.columns_of(np.stack([self._known[key] for key in keys]))

    def doubt(self, rows: Rows, ensemble: Ensemble) -> str:
        """A line, if the best row, simulated, costs other than the table has it; else ""."""
        place = [int(ensemble.mean.argmin())]
        row = rows.numbers[place]
        found = ensemble.told(self.columns(rows.parameters[row], ensemble))
        known = ensemble.told(ensemble.columns[place])
        if np.allclose(found, known, rtol=0.0, atol=ROUNDED):
            return ""
        return (
            f"feature_function: row {row[0]}, simulated, comes to other outcomes than"
            " the table has; are worlds in its order, and costs the same?"
        )

    def _simulated(self, parameters: Floats) -> Floats:
        try:
            returned = self._function(parameters.copy())
        except Exception as error:
            raised = f"{type(error).__name__}: {error}"
            raise InputError(FIELD, raised, "outcomes, no exception") from error
        outcomes = matrix_of(FIELD, returned, "w")
        if len(outcomes) != len(parameters):
            allowed = f"outcomes of {len(parameters)} points"
            raise InputError(f"{FIELD}.shape", outcomes.shape, allowed)
        return outcomes
