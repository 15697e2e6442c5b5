"""An order of candidates whose first few cover what a ground may be like.

The first is the one that best survives the plainest ground. From then on the ground of a trial is
like one of several, and nobody knows which: each next candidate is the one that most raises the
chance that at least one of those so far walks, the mean over the grounds of 1 - prod(1 - chance).
That is the greedy rule, whose k candidates have at least 63 % of what the best k would add
(Nemhauser, Wolsey, Fisher 1978), and what Bayes's rule says after each fall: grounds on which the
fallen ones hardly ever fall lose weight.

How steep a family's ramps are is its maker's choice, so that a candidate's chance on a ground is
relative to the best one's there.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RELIABILITY = 0.7  # chance that the best of a ground walks on its like elsewhere
SHARPNESS = 3.0  # who survives half as long as the best has an eighth of its chance
COVERING = 128  # candidates that are placed by the rule; the others follow by their mean chance


def chances(survival: Floats) -> Floats:
    """To walk on the like of each ground, of each candidate, [n, f], by its survival, [n, f]."""
    best = survival.max(axis=0, initial=np.finfo(np.float64).tiny)
    return np.asarray(RELIABILITY * (survival / best) ** SHARPNESS)


def covering_order(plainest: Floats, survival: Floats) -> NDArray[np.int64]:
    """Candidates in the order in which to try them, [n].

    Args:
        plainest: survival of the plainest ground, from 0 to 1, NaN: not to be tried, [n].
        survival: of each ground, from 0 to 1, [n, f].
    """
    free = ~np.isnan(plainest)
    chance = chances(survival)
    merit = np.where(free, chance.mean(axis=1), -1.0)
    order = np.argsort(-merit, kind="stable")
    best = int(np.argmax(np.where(free, plainest, -1.0)))
    unwalked = np.ones(survival.shape[1])
    first = []
    for _ in range(min(COVERING, int(free.sum()))):
        first.append(best)
        free[best] = False
        unwalked = unwalked * (1.0 - chance[best])
        best = int(np.argmax(np.where(free, chance @ unwalked, -1.0)))
    placed = np.array(first, dtype=np.int64)
    return np.concatenate([placed, order[~np.isin(order, placed)]])


def earliness(plainest: Floats, survival: Floats) -> Floats:
    """n less the place in that order, NaN where a candidate is not to be tried, [n]."""
    order = covering_order(plainest, survival)
    values = np.empty(len(order))
    values[order] = np.arange(len(order), 0, -1)
    return np.where(np.isnan(plainest), np.nan, values)
