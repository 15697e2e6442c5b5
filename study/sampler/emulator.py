"""What the worlds say between the rows of a table: an emulator of the store.

What is known of a row (the mean over the worlds, and what each world adds to it) is a
function of its parameters that was computed at the rows alone. Between them it is a
Gaussian process over the parameters, the same for all columns but for their size:

    k(u, u') = (1 - q) M(u, u'; l) + q M(u, u'; l / 4)

with Matern's shape M (nu = 5/2) and a length scale for each parameter. The second part
is what neighbours among the rows do not share, as where walkers fall: it is the noise of
the rows when l and q are learned, and smooth at a finer scale when points are placed.

Rows have what was computed at them. Elsewhere the emulator is not sure, and says by how
much: its own error is one more part of the model's covariance
(`covariance.new_covariance`). A place also counts as `PESSIMISM` of its errors worse
than the process expects, and rows that no world ran as the worst that is known, so that
points stay near rows where costs are jagged.
"""

from dataclasses import dataclass
from functools import cached_property
from math import exp, log

import numpy as np
import scipy

from study.sampler.arrays import Floats, Whole
from study.sampler.ascent import Pull
from study.sampler.covariance import (
    ROUGH_SCALE,
    SIGNAL,
    WORLD,
    Constant,
    Covariance,
    Term,
    fall,
)
from study.sampler.gp import learn
from study.sampler.transforms import Points

LEARNED_ROWS = 240  # of which the constants are learned
LEARNED_GAPS = 80  # and of the rows that no world ran
BEST_ROWS = 720  # among which these are
NEAR_ROWS = 64  # around each centre
SPREAD_ROWS = 128  # over the whole table
UNKNOWN_SCALE = 1e3  # of a parameter that all rows share, in ranges
FINER = 4.0  # times: the scale of what neighbours do not share
ROW_NOISE = Constant(log(0.1), 2.0, (1e-4, 1e1))
UNSHARED = 0.1  # of q: what not even the nearest share, since bred rows lie close
JITTER = 1e-6  # of the variance
# Standard errors by which a place is taken for worse than it seems: the best of many
# places seems better than it is, and where walkers fall most places are worse.
PESSIMISM = 2.0


@dataclass(frozen=True, eq=False)
class Shape:
    """How what is known of rows varies with their parameters.

    Attributes:
        scales: length scales of the parameters, in ranges, [e].
        share: of the variance, what neighbours among the rows do not share: q.
    """

    scales: Floats
    share: float

    @classmethod
    def learned(cls, unit: Floats, mean: Floats, gaps: Floats) -> "Shape":
        """The shape of the mean over the worlds, by some of the best rows.

        Args:
            unit: coordinates of the rows, [m, e].
            mean: over the worlds, [m].
            gaps: rows that no world ran, [g, e].
        """
        best = np.argsort(mean, kind="stable")[:BEST_ROWS]
        some = best[_evenly(len(best), LEARNED_ROWS)]
        failed = gaps[_evenly(len(gaps), LEARNED_GAPS)]
        x = np.vstack([unit[some], failed])
        y = np.concatenate([mean[some], np.full(len(failed), mean.max())])
        e = unit.shape[1]
        term = Term(range(e), SIGNAL, (ROUGH_SCALE,) * e, rough=True)
        covariance = Covariance((term,), ROW_NOISE)
        theta = learn(covariance, x, y, most=len(x))
        variance, noise = np.exp(theta[[0, -1]]).tolist()
        # What all rows share the worlds say nothing of, for better or worse.
        scales = np.where(
            np.ptp(unit, axis=0) > 0.0, np.exp(theta[1:-1]), UNKNOWN_SCALE
        )
        return cls(scales=scales, share=noise / (variance + noise))


def _evenly(count: int, most: int) -> Whole:
    """At most so many of the numbers below a count, evenly spaced."""
    return np.unique(
        np.linspace(0, max(count - 1, 0), most if count else 0).round().astype(np.int64)
    )


class Emulator:
    """Columns of m rows as functions of their coordinates.

    Attributes:
        unit: coordinates of the rows, [m, e].
        columns: what is known of each, [m, c]: own features, worlds, a one, and last
            the mean over the worlds.
        parts: the columns of the worlds.
        shape: of the functions.
    """

    def __init__(
        self, unit: Floats, columns: Floats, parts: range, shape: Shape
    ) -> None:
        self.unit = unit
        self.columns = columns
        self.parts = parts
        self.shape = shape
        self._placed: dict[bytes, Floats] = {}

    def kernel(self, a: Floats, b: Floats) -> tuple[Floats, Floats]:
        """k of points [n, e] and [m, e] in length scales, and how it falls by r^2 / 2, [n, m]."""
        share = self.shape.share
        half = a @ b.T - 0.5 * (a**2).sum(axis=1)[:, None] - 0.5 * (b**2).sum(axis=1)
        wide, wide_bend = fall(half, rough=True)
        fine, fine_bend = fall(FINER**2 * half, rough=True)
        value = (1.0 - share) * wide + share * fine
        return value, (1.0 - share) * wide_bend + share * FINER**2 * fine_bend

    def around(self, centres: Floats) -> "Near":
        """The emulator near points of the unit cube, [c, e]."""
        count = min(NEAR_ROWS, len(self.unit))
        pools = [self._spread]
        for centre in centres / self.shape.scales:
            # |a - b|^2 / 2 less |b|^2 / 2, which all share.
            away = self._lengths - self.scaled @ centre
            pools.append(np.argpartition(away, count - 1)[:count])
        return Near(self, np.unique(np.concatenate(pools)))

    @cached_property
    def scaled(self) -> Floats:
        """Coordinates of the rows in length scales, [m, e]."""
        return self.unit / self.shape.scales

    @cached_property
    def _lengths(self) -> Floats:
        """Half of the squares of these, [m]."""
        return 0.5 * np.asarray(np.einsum("me,me->m", self.scaled, self.scaled))

    @cached_property
    def _spread(self) -> Whole:
        """Rows of all ranks, which say how bad most places are."""
        order = np.argsort(self.columns[:, -1], kind="stable")
        return order[_evenly(len(order), SPREAD_ROWS)]

    def at(self, place: Floats) -> Floats:
        """All columns at one place [e], by the rows around it; made once."""
        key = place.tobytes()
        if key not in self._placed:
            points, _ = self.around(place[None]).placed(place[None])
            self._placed[key] = points.features[0]
        return self._placed[key]


class Near:
    """The emulator by some of the rows; a `Chart` of the places near them."""

    def __init__(self, whole: Emulator, pool: Whole) -> None:
        self._whole = whole
        self._rows = whole.scaled[pool]
        gram = whole.kernel(self._rows, self._rows)[0]
        gram[np.diag_indices(len(gram))] += UNSHARED * whole.shape.share + JITTER
        factor = scipy.linalg.lapack.dpotrf(gram, lower=1)[0]
        lower = np.tril(scipy.linalg.lapack.dpotri(factor, lower=1)[0])
        self._solver = lower + np.tril(lower, -1).T  # the inverse
        columns = whole.columns[pool]
        ones = self._solver.sum(axis=1)
        # The mean of each column by generalised least squares.
        self._means = ones @ columns / ones.sum()
        away = columns - self._means
        self._weights = self._solver @ away
        sizes = np.einsum("nc,nc->c", away, self._weights) / len(pool)
        # Of y, with b . d as large as the trials are expected to find it.
        worlds = sizes[whole.parts.start : whole.parts.stop]
        variance = sizes[-1] + exp(WORLD.mode) * worlds.sum()
        self._variance = max(float(variance), 0.0)

    def placed(self, unit: Floats) -> tuple[Points, Pull]:
        """See `Chart`: columns by the emulator, its error, and coordinates in its scales."""
        scales, e = self._whole.shape.scales, unit.shape[1]
        scaled = unit / scales
        k, bend = self._whole.kernel(scaled, self._rows)
        solved = k @ self._solver
        left = np.maximum(1.0 - np.einsum("mn,mn->m", solved, k), JITTER)
        error = np.sqrt(self._variance * left)
        known = self._means + k @ self._weights
        known[:, -1] += PESSIMISM * error
        c = known.shape[1]

        def pull(slopes: Floats) -> Floats:
            by_error = slopes[:, c] + PESSIMISM * slopes[:, c - 1]
            by_left = 0.5 * by_error * error / left  # error^2 is variance * left
            pulls = slopes[:, :c] @ self._weights.T - 2.0 * by_left[:, None] * solved
            pulls *= bend
            towards = pulls @ self._rows - scaled * pulls.sum(axis=1)[:, None]
            own = slopes[:, c + 1 : c + 1 + e] + towards
            return np.asarray(own / scales + slopes[:, c + 1 + e :])

        return Points(np.column_stack([known, error, scaled]), unit), pull
