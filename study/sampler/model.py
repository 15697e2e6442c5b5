"""How good each candidate is, after some trials: the model, and what may be gained by it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from study.sampler.acquisition import log_expected_improvement
from study.sampler.covariance import Covariance
from study.sampler.evidence import Evidence
from study.sampler.feasibility import log_all_kept
from study.sampler.gaussian_process import condition, learn
from study.sampler.guess import Guess
from study.sampler.kernels import Kernel, Layout, new_covariance
from study.sampler.one_dimension import Shared
from study.sampler.points import Points
from study.sampler.posterior import Posterior
from study.sampler.transforms import log_excess, squarable

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

WORK = 1e10  # multiplications for the variance of all candidates; beyond, a part of them
LEAST_CANDIDATES = 1000
MOST_CANDIDATES = 4096  # of a kernel over features and parameters
CACHED_CONSTANTS = 8
REFITS = ((32, 1), (128, 4))  # up to so many trials, constants are learned anew after so many
LAST_EVERY = 16


@dataclass
class Constants:
    """Learned constants by the trials they were learned from: recomputed where they are missing."""

    known: dict[tuple[str, bytes], Floats] = field(default_factory=dict)

    def learned(self, covariance: Covariance, x: Floats, y: Floats) -> Floats:
        """What `learn` gives, computed once for the same covariance and trials."""
        key = (repr(covariance), x.tobytes() + y.tobytes())
        if key not in self.known:
            if len(self.known) >= CACHED_CONSTANTS:
                self.known.pop(next(iter(self.known)))
            self.known[key] = learn(covariance, x, y)
        return self.known[key]


@dataclass(frozen=True, eq=False)
class Model:
    """The posterior after some trials, and the improvement that it lets expect.

    Attributes:
        kernel: of this trial.
        guess: what the user says of a feature; None: nothing, or it is not believed.
        parameters: d.
        evidence: at least one finished trial.
        constants: known so far.
    """

    kernel: Kernel
    guess: Guess | None
    parameters: int
    evidence: Evidence
    constants: Constants

    def utility(self, points: Points, offered: Mask, rng: np.random.Generator) -> Floats:
        """How good each of m candidates is, [m]; minus infinity where not offered or not looked at.

        The log of the expected improvement times the probability that all limits are kept.

        Args:
            points: the candidates.
            offered: which may be taken, [m].
            rng: of this trial.
        """
        seen = self._looked_at(points, offered, rng)
        some = points if len(seen) == len(points) else points.take(seen)
        utility = np.full(len(points), -np.inf)
        utility[seen] = self._values(some)
        return np.where(offered, utility, -np.inf)

    @cached_property
    def posterior(self) -> Posterior:
        """Of the cost less what was guessed, running trials taken to show what is expected."""
        posterior = self._after(self.evidence.points, self._unguessed)
        running = self._visible(self.evidence.running)
        return posterior.believing(running) if len(running) else posterior

    @cached_property
    def limits(self) -> list[Posterior]:
        """One posterior a constraint that has been reported."""
        posteriors = []
        for limit in self.evidence.limits.T:
            known = np.isfinite(limit)
            if known.any():
                points = self.evidence.points.take(known)
                posteriors.append(self._after(points, limit[known].__getitem__))
        return posteriors

    @cached_property
    def one_dimensional(self) -> bool:
        """Whether candidates differ by one number only."""
        return not self.kernel.of_parameters and self.evidence.points.features.shape[1] == 1

    def cost(self, some: slice = slice(None)) -> Floats:
        """The costs of some trials as the process sees them, [n]."""
        cost = self.evidence.cost[some]
        return log_excess(cost) if self.kernel.by_order else squarable(cost)

    def _unguessed(self, some: slice) -> Floats:
        """The same less what was guessed."""
        cost = self.cost(some)
        return cost - self.guessed(self.evidence.points, cost)[some]

    def guessed(self, points: Points, cost: Floats) -> Floats:
        """What the user says of the costs of points, [m], in the unit of these costs."""
        if self.guess is None:
            return np.zeros(len(points))
        return (float(cost.std()) or 1.0) * self.guess.cost(points)

    def _after(self, points: Points, y: Callable[[slice], Floats]) -> Posterior:
        """The posterior of something that trials showed, y giving what some of them did."""
        seen = self._visible(points)
        x = seen.matrix()
        layout = Layout(seen.features.shape[1], seen.coordinates.shape[1], self.parameters)
        covariance = new_covariance(self.kernel, layout)
        first = last_refit(len(x))
        theta = self.constants.learned(covariance, x[:first], y(slice(first)))
        # Over features alone, noise is the spread of alike candidates: the next one shows it too.
        noisy = not self.kernel.of_parameters
        return condition(covariance, theta, x, y(slice(None)), noisy=noisy)

    def _visible(self, points: Points) -> Points:
        """The columns that the kernel looks at."""
        return points.only(features=self.kernel.of_features, coordinates=self.kernel.of_parameters)

    def _looked_at(
        self, points: Points, offered: Mask, rng: np.random.Generator
    ) -> NDArray[np.int64]:
        """Numbers of the candidates whose posterior is computed.

        Where they are too many, half of them are those that a straight line through the trials
        (`_merit`) thinks best, the others are drawn.
        """
        if self.one_dimensional:
            return np.arange(len(points))
        trials = len(self.evidence.cost) + len(self.evidence.running)
        most = max(int(WORK / trials**2), LEAST_CANDIDATES)
        if self.kernel.by_order:
            most = min(most, MOST_CANDIDATES)
        free = np.flatnonzero(offered)
        if len(points) <= most and len(free) > len(points) // 2:
            return np.arange(len(points))  # leaving out a few would cost a copy of the others
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
        seen, residual = self.evidence.points.features, self.posterior.y
        residual = residual[: len(seen)]  # less what running trials are believed to show
        slopes = np.linalg.solve(seen.T @ seen + np.eye(seen.shape[1]), seen.T @ residual)
        learned = self.posterior.cost_sd * (points.features @ slopes)
        return np.asarray(-(learned + self.guessed(points, self.cost())))

    def _values(self, points: Points) -> Floats:
        """The utility of candidates, [m]."""
        if not self.one_dimensional:
            return self._improvement(points) + log_all_kept(self.limits, self._visible(points))
        shared = Shared.of(self.posterior, points)
        values = self._improvement(shared.points) + log_all_kept(self.limits, shared.points)
        return shared.spread(values)

    def _improvement(self, points: Points) -> Floats:
        """log expected improvement, [m]; all alike where there is nothing to improve on."""
        feasible = self.evidence.feasible
        if not feasible.any():  # first find a candidate that holds
            return np.zeros(len(points))
        mean, variance = self.posterior.predict(self._visible(points))
        cost = self.cost()
        best = float(cost[feasible].min())
        mean += self.guessed(points, cost)
        return log_expected_improvement(mean, np.sqrt(variance), best)


def last_refit(trials: int) -> int:
    """How many of the first trials constants are learned from: they change ever more slowly."""
    for most, every in REFITS:
        if trials <= most:
            return trials - trials % every
    return trials - trials % LAST_EVERY
