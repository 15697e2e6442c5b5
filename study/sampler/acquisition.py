"""How good each candidate is: expected improvement, kept limits, and the model behind both."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property

import numpy as np
import scipy

from study.sampler.arrays import Floats, Mask, Whole
from study.sampler.covariance import (
    NEARNESS,
    WORLD,
    WORLD_NOISE,
    Constant,
    Covariance,
    GuessError,
    Kernel,
    new_covariance,
)
from study.sampler.evidence import Evidence
from study.sampler.gp import Posterior, condition, learn
from study.sampler.transforms import (
    Columns,
    Points,
    log_excess,
    new_columns,
    of_log_excess,
    squarable,
)
from study.sampler.worlds import Ensemble

TIE_TOLERANCE = 1e-9  # relative: below this, two candidates differ by rounding
LOG_SQRT_2PI = 0.5 * np.log(2.0 * np.pi)
SQRT_HALF = np.sqrt(0.5)
SQRT_HALF_PI = np.sqrt(0.5 * np.pi)
# Of success: below, the likeliest candidate is any that is near the best one, and
# teaches nothing.
LEAST_LOG_CHANCE = np.log(0.01)
FAR_BELOW, FAR_ABOVE = -1e3, 1e1  # standard deviations
# A squared exponential bends by 1 / (8 x 100^2) = 1.3e-5 of its height between two
# nodes.
NODES_A_LENGTH = 100
# Multiplications for the variance of all candidates; beyond, a part of them.
WORK = 1e10
LEAST_CANDIDATES = 1000
MOST_CANDIDATES = 4096  # of a kernel over features and parameters
MOST_IN_WORLDS = 2560  # with worlds, which are a hundred columns
CACHED_CONSTANTS = 16
# Where costs jump, chances of success are less extreme than a normal distribution says:
# log odds = a + b (log odds said). Round numbers near the best of 2,146 proposals for Ant and
# for made-up machines; those for Walker2d, not looked at before, gained as much.
ODDS = (-0.5, 0.7)
# What is likelier to fail, or to break a limit, is the last that a hurdle takes. Without this
# half of its proposals for walkers that limp had a chance below 0.05, and gained next to
# nothing; for Ant those below 0.7 gained a third of what others did.
LOG_EVEN = np.log(0.5)
LOG_LEAST_GAIN = -5e2  # of what is likely: less is as little
LOG_NO_GAIN = -1e3  # of what is unlikely: below all of these
# Up to so many trials, constants are learned anew after so many: they change ever more
# slowly.
REFITS = ((32, 1), (64, 4), (128, 8), (np.inf, 16))


Learned = dict[tuple[Covariance, bytes], Floats]
"""Constants by the covariance and the trials that they were learned from."""


class Aim(StrEnum):
    """What a candidate is proposed for, in words that are left in its trial."""

    BEGIN = "one of several to begin with"
    RANKING = "next in the ranking"
    PARAMETERS = "promising by the parameters of the trials alone"
    LIMITS = "likeliest to keep all limits"
    SUCCESS = "likeliest to succeed"
    IMPROVEMENT = "the largest improvement to be expected"


@dataclass(eq=False, kw_only=True)
class Model(Evidence):
    """The posterior after some trials, and the improvement that it lets expect.

    Attributes:
        kernel: of this trial: the sampler's or, where features are doubted, one of the
            parameters alone.
        parameters: d, their number.
        running: trials of other workers whose parameters are known; they count with
            their expected costs.
        known: constants that were learned so far; new ones are added.
        elsewhere: e trials of other studies, whose limits alone count; None: none.
        refits: up to how many trials constants are learned anew after how many.
    """

    kernel: Kernel
    parameters: int
    running: Points
    known: Learned
    elsewhere: Points | None = None
    refits: Sequence[tuple[float, int]] = REFITS
    _in_sight: bool | None = field(default=None, init=False)  # a success; not yet asked

    def utility(
        self, points: Points, offered: Mask, rng: np.random.Generator
    ) -> Floats:
        """How good each of m candidates is, [m]; minus infinity where not offered or not examined.

        The log of the expected improvement times the probability that all limits are
        kept; until a trial has succeeded, of the probability of success times that,
        while any has a chance; and then of all three, where `of_successes` tells the
        improvement.

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

    @property
    def aim(self) -> Aim:
        """What utility is, once it has been computed of some candidates."""
        if not self.feasible.any():
            return Aim.LIMITS
        if self._in_sight:
            return Aim.SUCCESS
        return Aim.PARAMETERS if self.kernel == NEARNESS else Aim.IMPROVEMENT

    @cached_property
    def posterior(self) -> Posterior:
        """The posterior of the cost less what is expected; running trials cost what is expected."""

        def y(some: slice) -> Floats:
            cost = self.cost(some)
            return cost - self.expected(self.trials, cost)[some]

        posterior = self._after(
            self.trials,
            y,
            standardised=self.of_table is None,
            likeness=self.likeness,
            noise=self.noise,
            guess_error=self.guess_error,
        )
        running = self.visible(self.running)
        return posterior.believing(running) if len(running) else posterior

    @cached_property
    def of_successes(self) -> "Model | None":
        """The model of the trials that cost no more than a success, in their own units, or None.

        Where costs jump, a failure lies so far above all successes that one process
        through both expects one a short step from any success, and steps stay too small
        to gain by. So a candidate counts by the chance that it succeeds times the
        improvement if it does (a hurdle model: Cragg 1971). What is likelier to fail, or to
        break a limit, counts by its chance alone, after all others, where that is shunned.
        What is expected of a success is told by the worlds in which a row is one
        (`Evidence.successes`). A trial that broke a limit is no success, but tells what
        success costs.
        """
        of_them = self.successes
        if of_them is None or self.success is None:
            return None
        own = self.costs <= self.success
        return replace(
            self,
            trials=self.trials.take(own),
            rows=self.rows[own],
            costs=self.costs[own],
            limits=self.limits[own],
            ensemble=of_them,
            familiar=None,
        )

    @cached_property
    def limit_posteriors(self) -> dict[int, Posterior]:
        """One posterior a constraint that has been reported, by its column."""
        posteriors, trials = dict[int, Posterior](), self.trials
        if self.elsewhere is not None:
            trials = self.elsewhere.followed_by(trials)
        for column, limit in enumerate(self.told_limits.T):
            known = np.isfinite(limit)
            if known.any():
                points = trials.take(known)
                told = limit[known].__getitem__
                posteriors[column] = self._after(points, told)
        return posteriors

    @cached_property
    def one_dimensional(self) -> bool:
        """Whether candidates differ by one number only."""
        return not self.kernel.of_parameters and self.trials.width == 1

    def cost(self, some: slice = slice(None)) -> Floats:
        """The costs of some trials as the process sees them, [n]."""
        return self.standard(self.costs[some], self.costs[some])

    def standard(self, values: Floats, costs: Floats) -> Floats:
        """Values [m] as the process sees them after costs [n]."""
        if self.of_table is not None:
            return self.of_table.standard(values)
        return log_excess(values, costs) if self.kernel.by_order else squarable(values)

    def in_units(self, cost: Floats) -> Floats:
        """The inverse of `cost`, [m]."""
        if self.of_table is not None:
            return self.of_table.costs(cost)
        if not self.kernel.by_order:
            return cost
        found = of_log_excess(cost, self.costs)
        if isinstance(self.ensemble, Ensemble) and self.ensemble.in_costs:
            return np.maximum(found, self.ensemble.floor)
        return found

    def expected(self, points: Points, cost: Floats) -> Floats:
        """The mean over the worlds at points, [m], in the unit of these costs; 0 without worlds."""
        if self.ensemble is None:
            return np.zeros(len(points))
        mean = self.world_mean(points)
        return mean if self.of_table is not None else (float(cost.std()) or 1.0) * mean

    def world_mean(self, points: Points) -> Floats:
        """The mean over the worlds at points, [m], as they have it."""
        (column,) = self.columns.mean
        return points.features[:, column]

    @cached_property
    def columns(self) -> Columns:
        """What the columns of points are."""
        return self._columns(self.trials)

    def _after(
        self,
        points: Points,
        y: Callable[[slice], Floats],
        *,
        standardised: bool = True,
        likeness: Constant = WORLD,
        noise: Constant = WORLD_NOISE,
        guess_error: GuessError | None = None,
    ) -> Posterior:
        """The posterior of something that trials showed, y giving what some of them did."""
        seen = self.visible(points)
        x, columns = seen.matrix, self._columns(seen)
        covariance = new_covariance(
            self.kernel,
            columns,
            self.parameters,
            standardised=standardised,
            is_familiar=self.is_familiar,
            likeness=likeness,
            noise=noise,
            guess_error=guess_error,
        )
        every = next(every for most, every in self.refits if len(x) <= most)
        first = len(x) - len(x) % every
        theta = self._learned(covariance, x[:first], y(slice(first)))
        # Over features alone, noise is the spread of alike candidates: the next one
        # shows it too.
        noisy = not self.kernel.of_parameters
        return condition(covariance, theta, x, y(slice(None)), noisy=noisy)

    def _columns(self, points: Points) -> Columns:
        features, coordinates = points.width, points.coordinates.shape[1]
        if self.ensemble is None:
            return new_columns(features, coordinates)
        features -= self.ensemble.columns.shape[1]
        return self.ensemble.layout(features, coordinates)

    def _learned(self, covariance: Covariance, x: Floats, y: Floats) -> Floats:
        """The constants, computed once for the same covariance and trials."""
        key = (covariance, x.tobytes() + y.tobytes())
        if key not in self.known:
            if len(self.known) >= CACHED_CONSTANTS:
                self.known.pop(next(iter(self.known)))
            self.known[key] = learn(covariance, x, y)
        return self.known[key]

    def visible(self, points: Points) -> Points:
        """Points with the columns that the kernel uses."""
        first = 0 if self.kernel.of_features else points.width
        end = None if self.kernel.of_parameters else points.width
        return Points(points.matrix[:, first:end], points.width - first)

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
        if self.kernel.by_order and not self.kernel.rough:
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
        # Of what successes cost this line knows nothing.
        parts = (
            slice(self.columns.features.stop),
            slice(self.columns.worlds.start, None),
        )
        seen = np.hstack([self.trials.features[:, part] for part in parts])
        n, k = seen.shape
        residual = self.posterior.y[:n]  # less what running trials are believed to show
        if k <= n:
            slopes = np.linalg.solve(seen.T @ seen + np.eye(k), seen.T @ residual)
        else:  # the same by fewer equations
            slopes = seen.T @ np.linalg.solve(seen @ seen.T + np.eye(n), residual)
        found = -self.expected(points, self.cost())
        own = self.posterior.cost_sd * slopes.astype(np.float32)
        for part, some in zip(parts, np.split(own, [parts[0].stop]), strict=True):
            found -= points.single[:, part] @ some
        return found

    def _utility(self, points: Points) -> Floats:
        """The utility of candidates that are looked at, [m]: see `utility`."""
        visible = self.visible(points)
        log_chance_kept = np.zeros(len(points))
        for posterior in self.limit_posteriors.values():
            log_chance_kept += log_chance_below_zero(*posterior.predict(visible))
        if not self.feasible.any():
            return log_chance_kept  # nothing to improve on: first find a candidate that holds
        mean, variance = self._costs_at(points)
        if self.of_successes is not None:
            log_chance = self._log_chance_of_success(mean, variance)
            log_chance = as_it_happens(log_chance) + log_chance_kept
            likely = log_chance >= (LOG_EVEN if self.shuns_failures else -np.inf)
            mean, variance = self.of_successes._costs_at(points.take(likely))
            gain = self.of_successes._log_improvement(mean, variance)
            log_gain: Floats = np.full(len(points), LOG_NO_GAIN)
            log_gain[likely] = np.maximum(gain, LOG_LEAST_GAIN)
            return log_chance + log_gain
        if self.success is not None and not self.succeeded.any():
            log_chance = self._log_chance_of_success(mean, variance) + log_chance_kept
            # Rows come first, and decide for the points off the table too.
            if self._in_sight is None:
                self._in_sight = bool(log_chance.max() >= LEAST_LOG_CHANCE)
            if self._in_sight:
                return log_chance
        return self._log_improvement(mean, variance) + log_chance_kept

    def _costs_at(self, points: Points) -> tuple[Floats, Floats]:
        """Mean and variance of the cost at points, as the process sees it, [m]."""
        mean, variance = self.posterior.predict(self.visible(points))
        mean += self.expected(points, self.cost())
        return mean, variance

    def _log_chance_of_success(self, mean: Floats, variance: Floats) -> Floats:
        """log P(cost <= success) of costs ~ N(mean, variance), [m]."""
        assert self.success is not None
        (goal,) = self.standard(np.array([self.success]), self.costs)
        return log_chance_below_zero(mean - goal, variance)

    def _log_improvement(self, mean: Floats, variance: Floats) -> Floats:
        """Their log expected improvement on the best trial that kept its limits, [m]."""
        best = float(self.cost()[self.feasible].min())
        return log_expected_improvement(mean, np.sqrt(variance), best)


def as_it_happens(log_chance: Floats) -> Floats:
    """The log chance of what is said to have this one, [m]: see `ODDS`."""
    shift, slope = ODDS
    with np.errstate(divide="ignore"):  # what is sure stays sure
        log_odds = log_chance - np.log(-np.expm1(log_chance))
    return np.asarray(scipy.special.log_expit(shift + slope * log_odds))


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
    found = computed(Points(nodes[:, None], 1))
    if nodes is not values:
        found = np.interp(values, nodes, found)
    return found[place]


def log_expected_improvement(mean: Floats, sd: Floats, best: float) -> Floats:
    """log E[max(best - f, 0)] for f ~ N(mean, sd^2): how far below `best` a cost may come, [m].

    = log sd + log h(z), h(z) = phi(z) + z Phi(z), z = (best - mean) / sd: expected
    improvement (Jones, Schonlau, Welch 1998, eq. 15), which has the same maximum, but
    underflows; the logarithm does not (Ament et al. 2023, eq. 9 and appendix A.1).
    """
    gain = best - mean
    with np.errstate(divide="ignore", invalid="ignore"):
        log_improvement = np.log(sd) + _log_h(gain / sd)
        certain = sd <= 0
        if certain.any():
            log_improvement[certain] = np.log(np.maximum(gain[certain], 0.0))
    return np.asarray(log_improvement)


def _log_h(z: Floats) -> Floats:
    """log h(z) as log phi(z) + log(1 + z Phi(z) / phi(z)), [m].

    Phi(z) / phi(z) = sqrt(pi/2) erfcx(-z / sqrt 2). Far below, 1 + ... is a difference
    of equals, and its series 1/z^2 - 3/z^4 takes over; far above, h(z) is z.
    """
    middle = np.clip(z, FAR_BELOW, FAR_ABOVE)
    ratio = SQRT_HALF_PI * middle * scipy.special.erfcx(-SQRT_HALF * middle)
    log_h = np.asarray(np.log(1.0 + ratio) - 0.5 * middle**2 - LOG_SQRT_2PI)
    far = z > FAR_ABOVE
    log_h[far] = np.log(z[far])
    far = z < FAR_BELOW
    square = z[far] ** 2
    log_h[far] = np.log1p(-3.0 / square) - np.log(square) - 0.5 * square - LOG_SQRT_2PI
    return log_h


def argmax_random_tie(values: Floats, rng: np.random.Generator) -> int:
    """Index of the largest value; one of them at random where several are equal."""
    largest = float(values.max())
    if np.isinf(largest):
        return int(rng.choice(np.flatnonzero(values == largest)))
    tied = np.flatnonzero(values >= largest - TIE_TOLERANCE * abs(largest))
    return int(rng.choice(tied))


def log_chance_below_zero(mean: Floats, variance: Floats) -> Floats:
    """log P(limit <= 0) of a limit, or of a cost above its goal, ~ N(mean, variance), [m].

    Gelbart, Snoek, Adams 2014, section 3. Of limits that are 1 (failed) or -1, it is
    the least-squares classifier (Rasmussen, Williams 2006, section 6.5).
    """
    sd = np.sqrt(np.maximum(variance, 1e-24))
    return np.asarray(scipy.special.log_ndtr(-mean / sd))
