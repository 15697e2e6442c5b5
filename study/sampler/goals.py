"""Several goals: each trial looks for the least of one cost, by weights of its own.

A study with k directions has k costs c_j (minus the values that are maximised). For
each trial, weights l are drawn evenly from those whose sum is one, and it looks for the
least of

    s = 1 + max_j l_j f_j + 0.05 sum_j l_j f_j,   f_j = (c_j - least_j) / typical_j,

of all trials so far, and of each row in each world of the table (Knowles 2006,
"ParEGO", equation 2: the largest of the weighted costs finds points of a front that
bends inwards, their sum does not). The least cost of a goal, and the median excess over
it, are those of the table's worlds or, without any, of the trials.
"""

from dataclasses import dataclass

import numpy as np

from study.sampler.arrays import Floats
from study.sampler.transforms import squarable, typical_excess

SUM_SHARE = 0.05  # of the weighted sum; Knowles 2006


@dataclass(frozen=True, eq=False)
class Goals:
    """One cost in place of k.

    Attributes:
        weights: l, drawn for one trial, [k], of sum 1.
        least: the least known cost of each goal, in its unit, [k]; 0 where none is
            known.
        typical: the median excess over it, in the same unit, positive, [k]; 1 where
            none is known.
    """

    weights: Floats
    least: Floats
    typical: Floats

    @classmethod
    def drawn(cls, known: Floats, rng: np.random.Generator) -> "Goals":
        """Goals with weights at random; costs `known` [n, k] tell the scale, NaN where gaps."""
        weights = rng.dirichlet(np.ones(known.shape[1]))
        columns = [column[~np.isnan(column)] for column in squarable(known).T]
        least = np.array([column.min() if len(column) else 0.0 for column in columns])
        typical = [typical_excess(column) if len(column) else 1.0 for column in columns]
        return cls(weights=weights, least=least, typical=np.array(typical))

    def cost(self, costs: Floats) -> Floats:
        """The one cost of costs [..., k], [...]."""
        weighted = self.weights * (squarable(costs) - self.least) / self.typical
        return np.asarray(
            1.0 + weighted.max(axis=-1) + SUM_SHARE * weighted.sum(axis=-1)
        )
