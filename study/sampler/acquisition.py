"""How good each candidate is: expected improvement, kept limits, and the model behind both."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from study.sampler.arrays import Floats, Mask, Whole
from study.sampler.covariance import Covariance, Kernel, new_covariance
from study.sampler.gp import Posterior, condition, learn
from study.sampler.similarity import Relation
from study.sampler.transforms import (
    Columns,
    Points,
    log_excess,
    new_columns,
    of_log_excess,
    squarable,
)
from study.sampler.utility import Chance, Improvement, Utility
from study.sampler.worlds import Ensemble

# Of success: below, the likeliest candidate is any that is near the best one, and
# teaches nothing.
LEAST_LOG_CHANCE = np.log(0.01)
SOUGHT_AMONG_ROWS = (
    10  # trials, after which points off a table may be the first to succeed
)
# A squared exponential bends by 1 / (8 x 100^2) = 1.3e-5 of its height between two
# nodes.
NODES_A_LENGTH = 100
# Multiplications for the variance of all candidates; beyond, a part of them.
WORK = 1e10
LEAST_CANDIDATES = 1000
MOST_CANDIDATES = 4096  # of a kernel over features and parameters
MOST_IN_WORLDS = 2560  # with worlds, which are a hundred columns
CACHED_CONSTANTS = 8
# Up to so many trials, constants are learned anew after so many: they change ever more
# slowly.
REFITS = ((32, 1), (128, 4), (np.inf, 16))


Learned = dict[tuple[Covariance, bytes], Floats]
"""Constants by the covariance and the trials that they were learned from."""


@dataclass(frozen=True, eq=False)
class _Part:
    """What one quantity adds to the utility of m candidates.

    Attributes:
        posterior: of the cost, or of what a limit is exceeded by.
        utility: of its mean and variance.
        mean: what to expect of each, [m].
        variance: how sure that is, [m].
    """

    posterior: Posterior
    utility: Utility
    mean: Floats
    variance: Floats


@dataclass(eq=False)
class Model:
    """The posterior after some trials, and the improvement that it lets expect.

    Attributes:
        kernel: of this trial: the sampler's or, where features are doubted, one of the
            parameters alone.
        parameters: d, their number.
        trials: the n finished ones, at least one.
        costs: what these showed, lower is better, finite, [n].
        limits: c constraints of each, kept where <= 0, NaN where unknown, [n, c].
        running: trials of other workers whose parameters are known; they count with
            their expected costs.
        known: constants that were learned so far; new ones are added.
        ensemble: simulated worlds, whose mean cost is expected, or the likeness of a
            pool; None: neither.
        success: cost up to which a trial has succeeded; None: there is no such cost.
        elsewhere: e trials of other studies, whose limits alone count; None: none.
        limits_elsewhere: the constraints of these, [e, c]; None without them.
    """

    kernel: Kernel
    parameters: int
    trials: Points
    costs: Floats
    limits: Floats
    running: Points
    known: Learned
    ensemble: Relation | None = None
    success: float | None = None
    elsewhere: Points | None = None
    limits_elsewhere: Floats | None = None
    _in_sight: bool | None = field(default=None, init=False)  # a success; not yet asked

    @cached_property
    def feasible(self) -> Mask:
        """Finished trials that kept all their limits, [n]."""
        return np.asarray(~(self.limits > 0).any(axis=1))

    @property
    def seeks_success(self) -> bool:
        """Whether no trial that kept its limits has succeeded yet, where a success is defined."""
        kept = self.costs[self.feasible]
        return self.success is not None and not bool((kept <= self.success).any())

    @property
    def aims_at_success(self) -> bool:
        """Whether success is sought among rows: some have a chance, and few were tried."""
        is_early = len(self.costs) < SOUGHT_AMONG_ROWS
        return self.seeks_success and self._in_sight is True and is_early

    def utility(
        self, points: Points, offered: Mask, rng: np.random.Generator
    ) -> Floats:
        """How good each of m candidates is, [m]; minus infinity where not offered or not examined.

        The log of the expected improvement times the probability that all limits are
        kept; until a trial has succeeded, of the probability of success times that,
        while any has a chance.

        Args:
            points: the candidates.
            offered: which may be taken, [m].
            rng: of this trial.
        """
        seen = self._looked_at(points, offered, rng)
        some = points if len(seen) == len(points) else points.take(seen)
        utility = np.full(len(points), -np.inf)
        if self.one_dimensional:
            utility[seen] = along_feature(self.posterior, some, self._utility)
        else:
            utility[seen] = self._utility(some)
        return np.where(offered, utility, -np.inf)

    @cached_property
    def posterior(self) -> Posterior:
        """The posterior of the cost less what is expected; running trials cost what is expected."""

        def y(some: slice) -> Floats:
            cost = self.cost(some)
            return cost - self.expected(self.trials)[some]

        posterior = self._after(self.trials, y, standardised=self._in_costs is None)
        running = self.visible(self.running)
        return posterior.believing(running) if len(running) else posterior

    @property
    def told_limits(self) -> Floats:
        """Constraints of trials elsewhere and of those here, [e + n, c]."""
        if self.limits_elsewhere is None:
            return self.limits
        return np.vstack([self.limits_elsewhere, self.limits])

    @cached_property
    def limit_posteriors(self) -> list[Posterior]:
        """One posterior a constraint that has been reported."""
        posteriors, trials = [], self.trials
        if self.elsewhere is not None:
            trials = self.elsewhere.followed_by(trials)
        for limit in self.told_limits.T:
            known = np.isfinite(limit)
            if known.any():
                points = trials.take(known)
                posteriors.append(self._after(points, limit[known].__getitem__))
        return posteriors

    @cached_property
    def one_dimensional(self) -> bool:
        """Whether candidates differ by one number only."""
        return not self.kernel.of_parameters and self.trials.features.shape[1] == 1

    def cost(self, some: slice = slice(None)) -> Floats:
        """The costs of some trials as the process sees them, [n]."""
        return self.standard(self.costs[some], self.costs[some])

    def standard(self, values: Floats, costs: Floats) -> Floats:
        """Values [m] as the process sees them after costs [n]."""
        if self._in_costs is not None:
            return self._in_costs.standard(values)
        return log_excess(values, costs) if self.kernel.by_order else squarable(values)

    def in_units(self, cost: Floats) -> Floats:
        """The inverse of `cost`, [m]."""
        if self._in_costs is not None:
            return self._in_costs.costs(cost)
        return of_log_excess(cost, self.costs) if self.kernel.by_order else cost

    def expected(self, points: Points) -> Floats:
        """The mean over the worlds at points, [m], in the unit of the costs; 0 without worlds."""
        if self.ensemble is None:
            return np.zeros(len(points))
        return self._unit * self.world_mean(points)

    @property
    def _unit(self) -> float:
        """The unit of what the worlds say, in that of the costs as the process sees them."""
        return 1.0 if self._in_costs is not None else float(self.cost().std()) or 1.0

    def world_mean(self, points: Points) -> Floats:
        """The mean over the worlds at points, [m], as they have it."""
        (column,) = self.columns.mean
        return points.features[:, column]

    @cached_property
    def columns(self) -> Columns:
        """What the columns of points are."""
        return self._columns(self.trials)

    @property
    def in_table_units(self) -> bool:
        """Whether costs are those of a table's worlds, and infinity is beyond these."""
        return self._in_costs is not None

    @cached_property
    def knows_scale(self) -> bool:
        """Whether anything tells how far costs lie apart: the table's, or trials that differ."""
        if self._in_costs is not None:
            return self._in_costs.varies
        return bool(self.costs.min() < self.costs.max())

    @property
    def _in_costs(self) -> Ensemble | None:
        """Worlds whose outcomes are in the unit of the study's values."""
        found = self.ensemble
        return found if isinstance(found, Ensemble) and found.in_costs else None

    def _after(
        self, points: Points, y: Callable[[slice], Floats], *, standardised: bool = True
    ) -> Posterior:
        """The posterior of something that trials showed, y giving what some of them did."""
        seen = self.visible(points)
        x, columns = seen.matrix, self._columns(seen)
        covariance = new_covariance(
            self.kernel, columns, self.parameters, standardised=standardised
        )
        every = next(every for most, every in REFITS if len(x) <= most)
        first = len(x) - len(x) % every
        theta = self._learned(covariance, x[:first], y(slice(first)))
        # Over features alone, noise is the spread of alike candidates: the next one
        # shows it too.
        noisy = not self.kernel.of_parameters
        return condition(covariance, theta, x, y(slice(None)), noisy=noisy)

    def _columns(self, points: Points) -> Columns:
        features, coordinates = points.features.shape[1], points.coordinates.shape[1]
        if self.ensemble is None:
            return new_columns(features, coordinates)
        beside, worlds = self.ensemble.columns.shape[1], self.ensemble.parts.shape[1]
        between = 1 + coordinates if isinstance(self.ensemble, Ensemble) else 0
        own = features - beside - between
        return new_columns(own, coordinates, worlds, between)

    def _learned(self, covariance: Covariance, x: Floats, y: Floats) -> Floats:
        """The constants, computed once for the same covariance and trials."""
        key = (covariance, x.tobytes() + y.tobytes())
        if key not in self.known:
            if len(self.known) >= CACHED_CONSTANTS:
                self.known.pop(next(iter(self.known)))
            self.known[key] = learn(covariance, x, y)
        return self.known[key]

    def visible(self, points: Points) -> Points:
        """Points with the columns that the kernel uses; the same points where these are all."""
        k = points.features.shape[1] if self.kernel.of_features else 0
        e = points.coordinates.shape[1] if self.kernel.of_parameters else 0
        if k + e == points.features.shape[1] + points.coordinates.shape[1]:
            return points
        return Points(points.features[:, :k], points.coordinates[:, :e])

    def _looked_at(
        self, points: Points, offered: Mask, rng: np.random.Generator
    ) -> Whole:
        """Numbers of the candidates whose posterior is computed.

        Where they are too many, half of them are those that a straight line through the
        trials (`_merit`) ranks first, the others are drawn.
        """
        if self.one_dimensional:
            return np.arange(len(points))
        count = len(self.costs) + len(self.running)
        most = max(int(WORK / count**2), LEAST_CANDIDATES)
        if self.kernel.by_order:
            candidates = MOST_CANDIDATES if self.ensemble is None else MOST_IN_WORLDS
            most = min(most, candidates)
        free = np.flatnonzero(offered)
        if len(points) <= most and len(free) > len(points) // 2:
            # Leaving out a few would cost a copy of the others.
            return np.arange(len(points))
        if len(free) <= most:
            return free
        if not self.kernel.of_features:
            return np.sort(rng.choice(free, most, replace=False))
        split = len(free) - most // 2
        order = np.argpartition(self._merit(points)[free], split)
        drawn = rng.choice(order[:split], most - most // 2, replace=False)
        return np.sort(free[np.concatenate([order[split:], drawn])])

    def _merit(self, points: Points) -> Floats:
        """Minus the costs by a ridge regression on the features, unit slopes against unit noise."""
        linear = slice(self.columns.mean.stop if self.ensemble is not None else None)
        seen = self.trials.features[:, linear]
        n, k = seen.shape
        residual = self.posterior.y[:n]  # less what running trials are believed to show
        if k <= n:
            slopes = np.linalg.solve(seen.T @ seen + np.eye(k), seen.T @ residual)
        else:  # the same by fewer equations
            slopes = seen.T @ np.linalg.solve(seen @ seen.T + np.eye(n), residual)
        learned = self.posterior.cost_sd * (
            points.single[:, linear] @ slopes.astype(np.float32)
        )
        return np.asarray(-(learned + self.expected(points)))

    def _utility(self, points: Points) -> Floats:
        """The log of the expected improvement, and of the chance that limits are kept, [m]."""
        total = np.zeros(len(points))
        for part in self._parts(points):
            total += part.utility(part.mean, part.variance)
        return total

    def slopes(self, points: Points) -> tuple[Floats, Floats]:
        """The utility of few candidates, [m], and its derivatives by their columns, [m, p]."""
        total = np.zeros(len(points))
        slopes = np.zeros_like(points.matrix)
        visible = self.visible(points)
        for part in self._parts(points, few=True):
            total += part.utility(part.mean, part.variance)
            by_mean, by_variance = part.utility.slopes(part.mean, part.variance)
            slopes += part.posterior.slopes(visible, by_mean, by_variance)
            if part.posterior is self.posterior and self.ensemble is not None:
                slopes[:, self.columns.mean.start] += by_mean * self._unit
        return total, slopes

    def _parts(self, points: Points, *, few: bool = False) -> list[_Part]:
        """What the utility of points is the sum of; of few of them in 64 bits."""
        visible = self.visible(points)

        def seen(posterior: Posterior) -> tuple[Floats, Floats]:
            return posterior.exactly(visible) if few else posterior.predict(visible)

        parts = [
            _Part(posterior, Chance(0.0), *seen(posterior))
            for posterior in self.limit_posteriors
        ]
        if not self.feasible.any():
            return parts  # nothing to improve on: first find a candidate that holds
        mean, variance = seen(self.posterior)
        mean += self.expected(points)
        kept = sum(part.utility(part.mean, part.variance) for part in parts)
        utility = self._aim(mean, variance, kept)
        return [*parts, _Part(self.posterior, utility, mean, variance)]

    def _aim(self, mean: Floats, variance: Floats, log_chance_kept: Any) -> Utility:
        """Success, until a trial has had it, while any has a chance; else improvement."""
        cost, feasible = self.cost(), self.feasible
        if self.success is not None and self.seeks_success:
            (goal,) = self.standard(np.array([self.success]), self.costs)
            success = Chance(float(goal))
            # Rows come first, and decide for the points off the table too.
            if self._in_sight is None:
                chance = success(mean, variance) + log_chance_kept
                self._in_sight = bool(chance.max() >= LEAST_LOG_CHANCE)
            if self._in_sight:
                return success
        return Improvement(float(cost[feasible].min()))


def along_feature(
    posterior: Posterior, points: Points, computed: Callable[[Points], Floats]
) -> Floats:
    """A function of m candidates that differ by one feature alone, [m].

    It is computed once for each value or, where the posterior may be approximate and
    nodes are fewer, at evenly spaced nodes, between which it is all but straight.
    """
    values, place = points.distinct
    nodes = values
    lengths = float(values[-1] - values[0]) / posterior.shortest_scale
    count = int(min(np.ceil(lengths * NODES_A_LENGTH), len(values))) + 1
    if posterior.precision is np.float32 and count < len(values):
        nodes = np.linspace(values[0], values[-1], count)
    found = computed(Points(nodes[:, None], np.empty((len(nodes), 0))))
    if nodes is not values:
        found = np.interp(values, nodes, found)
    return found[place]
