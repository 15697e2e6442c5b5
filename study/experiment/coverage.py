"""An order of candidates whose first few cover what a ground may be like.

The ground of a trial is like one of a store's families, and nobody knows which. Each next candidate
is the one that most raises the chance that at least one of those before it and itself walks, the
mean over the families of 1 - prod(1 - chance): the greedy rule. Its first k have at least 63 % of
the chance of the best k (Nemhauser, Wolsey, Fisher 1978). It is also what Bayes's rule says after
each fall: families on which the fallen ones hardly ever fall lose weight.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RELIABILITY = 0.7  # chance that what walks in simulation walks elsewhere, for reasons unknown
COVERING = 128  # candidates that are placed by the rule; the others follow by their mean chance


def covering_order(survival: Floats) -> NDArray[np.int64]:
    """Candidates in the order in which to try them, [n].

    Args:
        survival: of each on each family, from 0 to 1, NaN where it is not to be tried, [n, f].
    """
    chance = RELIABILITY * np.where(np.isnan(survival), 0.0, survival)
    merit = np.where(np.isnan(survival).any(axis=1), -1.0, chance.mean(axis=1))
    order = np.argsort(-merit, kind="stable")
    free, unwalked = merit >= 0.0, np.ones(chance.shape[1])
    first = []
    for _ in range(min(COVERING, int(free.sum()))):
        best = int(np.argmax(np.where(free, chance @ unwalked, -1.0)))
        first.append(best)
        free[best] = False
        unwalked = unwalked * (1.0 - chance[best])
    placed = np.array(first, dtype=np.int64)
    return np.concatenate([placed, order[~np.isin(order, placed)]])


def earliness(survival: Floats) -> Floats:
    """n less the place in that order, NaN where a candidate is not to be tried, [n]."""
    order = covering_order(survival)
    values = np.empty(len(order))
    values[order] = np.arange(len(order), 0, -1)
    return np.where(np.isnan(survival).any(axis=1), np.nan, values)
