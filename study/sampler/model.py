"""How good each candidate is, after some trials: the model, and the acquisition function on it."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from study.sampler import acquisition
from study.sampler.covariance import Covariance
from study.sampler.evidence import Evidence
from study.sampler.feasibility import log_all_kept
from study.sampler.gaussian_process import condition, learn
from study.sampler.kernels import Layout, feature_only, new_covariance
from study.sampler.one_dimension import Shared
from study.sampler.options import Options
from study.sampler.points import Points
from study.sampler.posterior import Posterior
from study.sampler.transforms import transformed

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

WORK = 1e10  # multiplications for the variance of all candidates; beyond, a random part of them
THOMPSON_CANDIDATES = 1000  # of one joint draw
CACHED_CONSTANTS = 8


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
    """The posterior after some trials, and what an acquisition function makes of it.

    Attributes:
        options: of the sampler.
        kernel: of this trial ("alternate" has been decided).
        parameters: d.
        evidence: at least one finished trial.
        constants: known so far.
    """

    options: Options
    kernel: str
    parameters: int
    evidence: Evidence
    constants: Constants

    def utility(
        self, points: Points, offered: Mask, log_weight: Floats | None, rng: np.random.Generator
    ) -> Floats:
        """How good each of m candidates is, [m]; minus infinity where not offered or not looked at.

        Args:
            points: the candidates.
            offered: which may be taken, [m].
            log_weight: of a prior, [m].
            rng: of this trial.
        """
        seen = self._looked_at(points, offered, rng)
        some = self._visible(points if len(seen) == len(points) else points.take(seen))
        log_weight = np.zeros(len(points)) if log_weight is None else log_weight
        utility = np.full(len(points), -np.inf)
        if self.options.acquisition == "thompson":
            drawn, values = self._thompson(some, rng)
            log_kept = log_all_kept(self.limits, some.take(drawn))
            utility[seen[drawn]] = _weighted(values, log_kept + log_weight[seen[drawn]])
        else:
            values, log_kept = self._values(some)
            utility[seen] = self._combined(values, log_kept + log_weight[seen])
        return np.where(offered, utility, -np.inf)

    @cached_property
    def posterior(self) -> Posterior:
        """Of the transformed cost, running trials taken to show what is expected of them."""
        posterior = self._after(self.evidence.points, self._cost)
        running = self._visible(self.evidence.running)
        return posterior.believing(running) if len(running) else posterior

    @cached_property
    def limits(self) -> list[Posterior]:
        """One posterior a constraint that has been reported."""
        posteriors = []
        for limit in self.evidence.limits.T:
            known = np.isfinite(limit)
            if known.any():
                posteriors.append(self._after(self.evidence.points.take(known), limit[known]))
        return posteriors

    @cached_property
    def one_dimensional(self) -> bool:
        """Whether candidates differ by one number only."""
        return feature_only(self.kernel) and self.evidence.points.features.shape[1] == 1

    @cached_property
    def _cost(self) -> Floats:
        """The costs as the process sees them, [n]."""
        return transformed(self.evidence.cost, self.options.cost_transform)

    def _after(self, points: Points, y: Floats) -> Posterior:
        """The posterior of something that finished trials showed."""
        seen = self._visible(points)
        x = seen.matrix()
        layout = Layout(seen.features.shape[1], seen.coordinates.shape[1], self.parameters)
        covariance = new_covariance(self.kernel, self._mean, layout)
        learned_from = _last_refit(len(y), self.options.refit_every)
        theta = self.constants.learned(covariance, x[:learned_from], y[:learned_from])
        noisy = feature_only(self.kernel)  # the spread of alike candidates is part of the next one
        return condition(covariance, theta, x, y, noisy=noisy, fast=self.options.fast)

    @property
    def _mean(self) -> str:
        """The mean to use: without features there is nothing that a linear one could follow."""
        return self.options.mean if self.evidence.points.features.shape[1] else "constant"

    def _visible(self, points: Points) -> Points:
        """The columns that the kernel and the mean look at."""
        return points.only(
            features=self.kernel != "euclidean" or self._mean == "linear",
            coordinates=not feature_only(self.kernel),
        )

    def _looked_at(
        self, points: Points, offered: Mask, rng: np.random.Generator
    ) -> NDArray[np.int64]:
        """Numbers of the candidates whose posterior is computed."""
        trials = len(self.evidence.cost) + len(self.evidence.running)
        most = max(int(WORK / trials**2), THOMPSON_CANDIDATES)
        free = np.flatnonzero(offered)
        if self.one_dimensional or (len(points) <= most and len(free) > len(points) // 2):
            return np.arange(len(points))  # leaving out a few would cost a copy of the others
        return free if len(free) <= most else np.sort(rng.choice(free, most, replace=False))

    def _values(self, points: Points) -> tuple[Floats, Floats]:
        """Acquisition without weights, and the log of the probability to hold, [m] each."""
        if not self.one_dimensional:
            return self._acquisition(points), log_all_kept(self.limits, points)
        shared = Shared.of(self.posterior, points)
        values = shared.spread(self._acquisition(shared.points))
        if not self.limits:
            return values, np.zeros(len(points))
        return values, shared.spread(log_all_kept(self.limits, shared.points))

    def _acquisition(self, points: Points) -> Floats:
        """Acquisition without weights, [m]; all alike where there is nothing to improve on."""
        options, feasible = self.options, self.evidence.feasible
        mean, variance = self.posterior.predict(points)
        sd = np.sqrt(variance)
        if options.acquisition == "ucb":
            return acquisition.confidence_bound(mean, sd, options.exploration)
        if not feasible.any():  # first find a candidate that holds
            return np.ones(len(points)) if options.acquisition == "ei" else np.zeros(len(points))
        best = float(self._cost[feasible].min())
        if options.acquisition == "ei":
            return acquisition.expected_improvement(mean, sd, best)
        return acquisition.log_expected_improvement(mean, sd, best)

    def _combined(self, values: Floats, log_weight: Floats) -> Floats:
        """Acquisition and log weights as one utility, on the acquisition's own scale, [m]."""
        if self.options.acquisition == "log_ei":
            return values + log_weight
        if self.options.acquisition == "ei":
            return np.asarray(values * np.exp(log_weight))
        return _weighted(values, log_weight)

    def _thompson(
        self, points: Points, rng: np.random.Generator
    ) -> tuple[NDArray[np.int64], Floats]:
        """One draw at some candidates, the most promising and random ones; their numbers first."""
        drawn = np.arange(len(points))
        if len(points) > THOMPSON_CANDIDATES:
            half = THOMPSON_CANDIDATES // 2
            promising = np.argpartition(self.posterior.mean(points), half)[:half]
            others = np.setdiff1d(drawn, promising)
            drawn = np.concatenate([promising, rng.choice(others, half, replace=False)])
        expected, covariance = self.posterior.joint(points.take(drawn))
        return drawn, acquisition.thompson(expected, covariance, rng)


def _weighted(values: Floats, log_weight: Floats) -> Floats:
    """Values of any sign, times a weight: above the least of them, so that more is better."""
    return np.asarray((values - values.min()) * np.exp(log_weight))


def _last_refit(trials: int, every: int) -> int:
    """How many of the first trials the constants are learned from."""
    return max(trials - trials % every, min(trials, every))
