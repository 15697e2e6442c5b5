"""How long features are followed that bring no better cost.

The likelihood cannot tell a feature that follows the cost everywhere from one that follows it
everywhere but at its best: both explain the trials. What tells them apart is success. Once the
best cost is older than `PATIENCE` trials, every other trial is left to the parameters alone, until
one of either kind is better than all before (win-stay, lose-shift: Robbins 1952). From then on a
feature that misleads costs half the trials, as where the two take turns (Antonova et al. 2018).
"""

import numpy as np
from numpy.typing import NDArray

PATIENCE = 3  # trials without a better cost
PATIENCE_TOLD = 20  # where the user has said which end of a feature is good


def is_doubtful(cost: NDArray[np.float64], turn: int, told: bool) -> bool:
    """Whether this trial is left to the parameters.

    Args:
        cost: of the finished trials that kept their limits, in their order, [n].
        turn: number of the trial.
        told: the user has said which end of a feature is good.
    """
    if not len(cost):
        return False
    age = len(cost) - 1 - int(np.argmin(cost))
    return turn % 2 == 1 and age >= (PATIENCE_TOLD if told else PATIENCE)
