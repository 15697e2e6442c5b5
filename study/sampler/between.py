"""What rows of a table tell of points between them: the nearest ones' mean, or kriging.

Worlds tell what each row costs, and nothing of a point beside it. Two guesses are made
from the rows near it:

- the mean of the nearest rows, weighted by 1 / distance^4. It is a safe guess where costs
  are jagged, as of walkers that fall, and it slanders all points near the best row: the
  rows around that are worse;
- ordinary kriging, the mean of a Gaussian process whose constants are learned from the
  rows (Matern 5/2; Rasmussen, Williams 2006, section 2.7 with a constant as the basis):
  mu + k^T K^-1 (c - mu), mu = 1^T K^-1 c / 1^T K^-1 1. Where costs are smooth it sees
  that the valley goes on between two rows.

The table decides which: its best rows are left out in turn, and guessed from the others.
Features that it has beside worlds are always the nearest rows' mean: kriging has learned
its constants from costs, and of other columns it would make wild ones.

Where the guess of the best rows is off by more than costs differ in the table, rows tell
nothing of points between them. The model then learns it as `covariance.GuessError` has it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import scipy

from study.sampler.arrays import Floats, Whole
from study.sampler.covariance import (
    EUCLIDEAN,
    Covariance,
    GuessError,
    fall,
    new_covariance,
)
from study.sampler.gp import LIKELIHOOD_TRIALS, cholesky, learn
from study.sampler.transforms import new_columns

Guess = Callable[[Floats, Floats, Floats], Floats]
"""Columns at points [n, e], [n, k], from rows x [r, e] that have the columns [r, k]."""

NEAR_ROWS = 8  # whose mean a point has
NEAR_POWER = 4  # of the distance, by which their weights fall
LEAST_DISTANCE = 1e-3  # in the unit cube: nearer rows count as if they were so far
NEAR_POOL = 128  # rows near a centre, from which points around it are guessed
KEPT_POOLS = 64  # at most: the best trials are centres again and again
BEST_ROWS = 64  # that are left out in turn
LEAST_TAUGHT = 32  # rows, from which kriging is learned
# Kriging's error on the best rows, as a share of the nearest rows' error, up to which it
# is used: half the error where costs are smooth (a plant: 0.2 to 0.35), most of it where
# walkers fall (0.75), and there the guess picks places that only seem to be good.
LARGEST_SHARE = 0.6
# Error on the best rows, in standard deviations of the table, from which on a guess tells
# nothing. Ant's is 1.4. With that error a hill climber was no longer ahead of ours; on a
# walker's tables (0.4), where rows are better than steps off the table, it did harm.
WORTHLESS = 1.0


def nearest_mean(x: Floats, columns: Floats, points: Floats) -> Floats:
    """The mean of each point's `NEAR_ROWS` nearest rows, weighted: a `Guess`.

    In many dimensions all rows but the nearest are about as far, so weights fall fast.
    """
    squares = _squares(points, x)
    count = min(NEAR_ROWS, len(x))
    # Of rows as far as the last one all count. To find how far is a third of finding
    # which.
    near = squares <= np.partition(squares, count - 1, axis=1)[:, count - 1 : count]
    distance = np.sqrt(np.maximum(squares[near], 0.0)) + LEAST_DISTANCE
    weight = 1.0 / distance**NEAR_POWER
    starts = np.append(0, near.sum(axis=1).cumsum())
    weight /= np.repeat(np.add.reduceat(weight, starts[:-1]), np.diff(starts))
    places = near.nonzero()[1]
    matrix = scipy.sparse.csr_array((weight, places, starts), squares.shape)
    return np.asarray(matrix @ columns)


@dataclass(frozen=True, eq=False)
class Between:
    """m rows in the unit cube, and a guess of what they tell of points between them.

    Attributes:
        unit: the rows, [m, e].
        guess: how columns at points follow from rows near them.
        beside: the last columns, so many, are of worlds, which the guess is of; those
            before are features.
        error: what the guess of worlds may be off by; None: it is believed.
    """

    unit: Floats
    guess: Guess = nearest_mean
    beside: int = 0
    error: GuessError | None = None

    def at(self, columns: Floats, points: Floats, centres: Floats) -> Floats:
        """Columns [m, k] of the rows at other points of the unit cube, [n, k].

        Each point [e] is guessed from the rows near the centre [c, e] that is nearest to
        it.
        """
        found = np.empty((len(points), columns.shape[1]))
        features = columns.shape[1] - self.beside
        nearest = _squares(points, centres).argmin(axis=1)
        for place, centre in enumerate(centres):
            own = nearest == place
            if own.any():
                pool = self.pool(centre)
                x, known, asked = self.unit[pool], columns[pool], points[own]
                found[own, features:] = self.guess(x, known[:, features:], asked)
                if self.error is not None:
                    found[own, -1] = _gap(asked, x, self.error.length)
                if features:
                    found[own, :features] = nearest_mean(x, known[:, :features], asked)
        return found

    @cached_property
    def _lengths(self) -> Floats:
        """|u|^2 of the rows, [m]."""
        return np.asarray(np.einsum("me,me->m", self.unit, self.unit))

    @cached_property
    def _pools(self) -> dict[bytes, Whole]:
        """Some that were found before, by their centre."""
        return {}

    def pool(self, centre: Floats) -> Whole:
        """Places of the rows that are nearest to a point of the unit cube [e], ascending."""
        key = centre.tobytes()
        found = self._pools.get(key)
        if found is None:
            # Less |centre|^2, which all share.
            squares = self._lengths - 2.0 * (self.unit @ centre)
            count = min(NEAR_POOL, len(squares))
            found = np.sort(np.argpartition(squares, count - 1)[:count])
            if len(self._pools) >= KEPT_POOLS:
                self._pools.clear()
            self._pools[key] = found
        return found


def kriged(
    covariance: Covariance, theta: Floats, x: Floats, columns: Floats, points: Floats
) -> Floats:
    """Ordinary kriging of all columns at once, with these constants: a `Guess`."""
    noise = float(np.exp(theta[-1]))
    factor, failed = cholesky(covariance.gram(theta, x)[0], noise)
    if failed:
        return nearest_mean(x, columns, points)
    solved = partial(scipy.linalg.cho_solve, (factor, True))
    ones = solved(np.ones(len(x)))
    middle = ones @ columns / ones.sum()
    weights = solved(columns - middle)
    towards = covariance.towards(theta, x, np.float64)(points)
    return np.asarray(middle + towards.T @ weights)


def chosen_guess(unit: Floats, mean: Floats) -> Guess:
    """Kriging, where it guesses the best rows better by far; else the nearest rows' mean.

    Args:
        unit: the rows, [m, e].
        mean: what decides which are the best ones, and what is guessed, [m]: low is
            good.
    """
    order = np.argsort(mean, kind="stable")
    if len(order) < LEAST_TAUGHT or mean[order[0]] == mean[order[-1]]:
        return nearest_mean
    # The best rows, and others of all ranks: valleys and their surroundings.
    best, others = np.split(order, [min(LIKELIHOOD_TRIALS, len(order)) // 2])
    count = min(LIKELIHOOD_TRIALS // 2, len(others))
    spread = np.linspace(0, len(others) - 1, count).astype(np.int64)
    taught = np.sort(np.concatenate([best, others[spread]]))
    parameters = unit.shape[1]
    covariance = new_covariance(EUCLIDEAN, new_columns(0, parameters), parameters)
    theta = learn(covariance, unit[taught], mean[taught])
    kriging = partial(kriged, covariance, theta)
    errors = [
        _left_out_error(guess, unit, mean, order[:BEST_ROWS])
        for guess in (kriging, nearest_mean)
    ]
    return kriging if errors[0] < LARGEST_SHARE * errors[1] else nearest_mean


def error_of_guess(unit: Floats, mean: Floats) -> GuessError | None:
    """What the nearest rows' mean may be off by; None where it tells something of the best rows.

    Args:
        unit: the rows, [m, e].
        mean: what is guessed, in standard deviations of the table, [m].
    """
    if len(mean) < LEAST_TAUGHT:
        return None
    best = np.argsort(mean, kind="stable")[:BEST_ROWS]
    error = _left_out_error(nearest_mean, unit, mean, best)
    if error < WORTHLESS:
        return None
    squares = _squares(unit[best], unit)
    squares[np.arange(len(best)), best] = np.inf
    distance = float(np.sqrt(np.median(squares.min(axis=1)).clip(LEAST_DISTANCE**2)))
    # It was off by so much at this distance; halfway there it is off by most of it.
    return GuessError(error**2, distance / 2.0)


def _gap(points: Floats, rows: Floats, length: float) -> Floats:
    """How little the row nearest to each point tells of it, [n]: `Columns.gap`.

    With correlation k to that row, 1 - k^2 of the variance is left.
    """
    nearest = _squares(points, rows).min(axis=1).clip(0.0)
    k = fall(-0.5 * nearest / length**2, rough=True)
    return np.asarray(np.sqrt(1.0 - k**2))


def _left_out_error(guess: Guess, unit: Floats, mean: Floats, some: Whole) -> float:
    """Root mean square error of the guess of some rows, each from the rows near it."""
    rows, errors = Between(unit, guess), np.empty(len(some))
    for place, row in enumerate(some.tolist()):
        pool = rows.pool(unit[row])
        others = pool[pool != row]
        guessed = guess(unit[others], mean[others, None], unit[row][None])
        errors[place] = float(guessed[0, 0]) - mean[row]
    return float(np.sqrt(np.mean(errors**2)))


def _squares(points: Floats, others: Floats) -> Floats:
    """Squared distances [n, r], with one product of matrices: |a|^2 + |b|^2 - 2 a . b."""
    lengths = (points**2).sum(axis=1)[:, None] + (others**2).sum(axis=1)
    return np.asarray(lengths - 2.0 * points @ others.T)
