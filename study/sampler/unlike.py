"""Whether a machine is like none of the worlds, as far as its first trials tell.

After each of its first trials the readings y_1 ... y_t are compared with what w worlds
cost there, of mean m and covariance S:

    T = (y - m)^T ((1 + 1 / w) S + e^2 I)^-1 (y - m),

with e what a reading may be off anyway. Each world in turn is left out and takes the
machine's place, with an error of its own. If the machine is one more of them, its T is
the largest of all w + 1 in one of w + 1 cases. So it is called unlike where as few
worlds are as far as a given share of false alarms allows; with few worlds where its T is
above the largest by so much that this happens in that share of cases, the tail of T
being exponential.

What is caught are costs that no world has, or that go together as in no world, at the
places that were tried: a machine that is strange elsewhere is not.
"""

from dataclasses import dataclass
from math import log

import numpy as np

from study.sampler.arrays import Floats, Whole
from study.sampler.history import OFF_TABLE
from study.sampler.similarity import Relation
from study.sampler.worlds import Ensemble

# Of machines like the worlds, the share that is called unlike after each of the first
# trials, together about 5 % since mostly the same are. The first one tells most: the best
# row of all worlds, which nobody has chosen by what the machine did.
FALSE_ALARMS = (0.04, 0.01, 0.01)
UNLIKE = "Unlike all "  # begins the line that says so
LEAST_WORLDS = 5
READING = 0.2  # e, in standard deviations of the table
OFF_ROW = 0.3  # likewise, of what rows near a point off the table tell


@dataclass(frozen=True)
class Unlike:
    """What speaks against all worlds.

    Attributes:
        trials: after how many it was clear.
        worlds: how many there are.
        reading: of these trials the one that is farthest from the worlds.
        low: the least cost of a world there.
        high: the largest one.
    """

    trials: int
    worlds: int
    reading: float
    low: float
    high: float

    def __str__(self) -> str:
        """One line."""
        after = "1 trial" if self.trials == 1 else f"{self.trials} trials"
        why = f"{self.reading:.4g} was read where they say {self.low:.4g} to {self.high:.4g}"
        if self.low <= self.reading <= self.high:
            why = "its readings go together as in none of them"
        return (
            f"{UNLIKE}{self.worlds} worlds after {after}: {why}. Intervals are wider; "
            "what rests on worlds (first proposals, risks) may not hold."
        )


def unlike(
    ensemble: Relation | None, features: Floats, costs: Floats, rows: Whole, sign: float
) -> Unlike | None:
    """What speaks against all worlds; None where nothing does, or worlds do not tell.

    Args:
        ensemble: the worlds, if there are any.
        features: of n trials, [n, k], those of the ensemble last.
        costs: that these showed, [n].
        rows: of the table that they were, [n]; OFF_TABLE off it.
        sign: of costs in the study's values.
    """
    if not isinstance(ensemble, Ensemble) or not ensemble.in_costs:
        return None
    if len(ensemble.names) < LEAST_WORLDS or ensemble.is_drawn:
        return None
    first = slice(min(len(costs), len(FALSE_ALARMS)))
    cost = ensemble.standard(costs[first])
    told = ensemble.told(features[first])  # [t, w]
    doubt = READING**2 + np.where(rows[first] == OFF_TABLE, OFF_ROW**2, 0.0)
    for count, share in enumerate(FALSE_ALARMS[: len(cost)], start=1):
        some = slice(count)
        if not _is_farther(cost[some], told[some], doubt[some], share):
            continue
        away = np.maximum(told.min(axis=1) - cost, cost - told.max(axis=1))[some]
        worst = int(away.argmax())
        ends = sign * ensemble.costs(told[worst])
        return Unlike(
            trials=count,
            worlds=len(ensemble.names),
            reading=float(sign * costs[worst]),
            low=float(ends.min()),
            high=float(ends.max()),
        )
    return None


def _is_farther(cost: Floats, told: Floats, doubt: Floats, share: float) -> bool:
    """Whether costs [t] are farther from worlds [t, w] than a world is in this share of cases."""
    count = told.shape[1]
    mean = told.mean(axis=1)
    apart = (told - mean[:, None]).T  # [w, t]
    squares = apart.T @ apart
    # A world that is left out takes its own part of mean and squares along.
    own = np.einsum("wt,wu->wtu", apart, apart)
    grown = count / (count - 1.0)
    theirs, noise = _distance(
        grown * apart, (squares - grown * own) / (count - 2.0), count - 1, doubt
    )
    theirs += noise  # which readings have, and worlds have not
    away, covariance = (cost - mean)[None], squares[None] / (count - 1.0)
    distance = _distance(away, covariance, count, doubt)[0][0]
    farther = int(share * (count + 1))  # how many of them may be as far
    if farther:
        return bool(distance > np.sort(theirs)[-farther])
    beyond = log(1.0 / (share * (count + 1.0)))
    return bool(distance > theirs.max() + beyond * theirs.mean())


def _distance(
    away: Floats, covariance: Floats, worlds: int, doubt: Floats
) -> tuple[Floats, Floats]:
    """T of costs that are away [k, t] from the mean of worlds, and the share of e in it, [k].

    Args:
        away: see above.
        covariance: of these worlds, [k, t, t].
        worlds: how many they are.
        doubt: e^2 of each trial, [t].
    """
    inverse = np.linalg.inv((1.0 + 1.0 / worlds) * covariance + np.diag(doubt))
    distance = np.einsum("kt,ktu,ku->k", away, inverse, away)
    return distance, np.einsum("ktt,t->k", inverse, doubt)
