"""Trials before there is a model: which end of the features is good, or what the user says it is.

| | first trials |
|---|---|
| a feature's good end is known (`prior`) | the best `RANKED` of that ranking, in its order |
| features, and nothing said | both ends of what they have in common |
| a kernel that takes features as they are, or none | `RANDOM`, at random |

What features have in common is their first principal component: candidates at its ends are extreme
by most of them at once. Of several guesses of a cost, the good end is one of the two.
"""

import numpy as np
from numpy.typing import NDArray

from study.sampler.options import Options
from study.sampler.transforms import Guess

Floats = NDArray[np.float64]

RANKED = 3
ENDS = 2
RANDOM = 3


def count(options: Options) -> int:
    """How many trials are to finish before the model is asked."""
    if options.prior is not None:
        return RANKED
    return ENDS if options.learns_trust else RANDOM


def merit(options: Options, guess: Guess | None, features: Floats, turn: int) -> Floats:
    """How much a first trial would like to have each candidate, [m]; equal where any will do.

    Args:
        options: of the sampler.
        guess: of the user.
        features: in standard units, [m, k].
        turn: of the trial; ends are taken by turns.
    """
    if guess is not None:
        return guess.merit(features)
    if not options.learns_trust:
        return np.zeros(len(features))
    return (1.0 if turn % ENDS == 0 else -1.0) * _common(features)


def _common(features: Floats) -> Floats:
    """Candidates [m, k] along their first principal component, more of most features first, [m]."""
    centred = features - features.mean(axis=0)
    _, directions = np.linalg.eigh(centred.T @ centred)
    first = directions[:, -1]
    return np.asarray(centred @ (first if first.sum() >= 0 else -first))
