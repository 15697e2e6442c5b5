"""A sampler that learns which simulated world a robot is like, and leaves its table near walkers.

A table has candidates, and what each of them costs in each of w simulated worlds. How the worlds
differ says which candidates go together: their mean and covariance over the worlds are a Gaussian
process before any trial (Wang, Kim, Kaelbling 2018), and each trial moves it towards the worlds
that the robot is like. Notation, costs being logarithms where all are positive, in units of their
standard deviation over the table:

    m(r)     mean over the worlds of the cost of candidate r
    d(r)     what the worlds add to it, [w], over the square root of w
    k(r, s)  a^2 d(r).d(s) + 1 + t^2 M(|u_r - u_s| / l) + noise; M: Matern 5/2; u in the unit cube

The 1 is a shift that all candidates share: a robot may be worse than all worlds. The next term is
for what no world knows, such as a better candidate between two rows. Weight a, size t and length l
are those of the greatest likelihood on a small grid, with a prior: nothing else is fitted. A point
off the table has the means of its nearest rows, by distance.

The first trial is the candidate of the least mean cost. Each next one has the greatest expected
improvement, among all rows and points near the best trials.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import optuna
import scipy
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from study.sampler.acquisition import log_expected_improvement
from study.sampler.draws import Purpose, generator, turn
from study.sampler.policy import one_thread
from study.sampler.random_sampler import ReproducibleRandomSampler
from study.sampler.space import nearby, not_among
from study.sampler.table import FeatureTable
from taichi_nmm import checks
from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]

NEAR_ROWS = 8  # whose means a point off the table has
CENTRES = 3  # best trials, near which points off the table are tried
NEAR_POINTS = 1500
WORLD_WEIGHTS = (0.15, 0.3, 0.6, 1.0)  # a
SIZES = (0.2, 0.4, 0.8)  # t, in standard deviations of the table's costs
LENGTHS = (0.3, 0.6, 1.2, 2.4)  # l, in ranges of a parameter
PRIOR = ((0.5, 0.7), (0.4, 0.7), (0.8, 0.7))  # median, and spread of the logarithm, of a, t, l
SHIFT = 1.0
NOISE = 0.1


@dataclass(frozen=True, eq=False)
class Worlds:
    """Costs of m candidates in w worlds, as the model takes them."""

    unit: Floats  # of the candidates, in the unit cube, [m, e]
    costs: Floats  # as given, [m, w]

    @cached_property
    def is_log(self) -> bool:
        """Whether costs are taken by their logarithm: all are positive."""
        return bool((self.costs > 0.0).all())

    @cached_property
    def scale(self) -> tuple[float, float]:
        """Mean and standard deviation of all costs, or of their logarithms."""
        values = np.log(self.costs) if self.is_log else self.costs
        return float(values.mean()), float(values.std()) or 1.0

    def standard(self, costs: Floats) -> Floats:
        """Costs in the model's units; what has no logarithm is far below the table's least."""
        values = np.log(np.maximum(costs, self.costs.min() * 1e-3)) if self.is_log else costs
        return np.asarray((values - self.scale[0]) / self.scale[1])

    @cached_property
    def mean(self) -> Floats:
        """m, of the candidates."""
        return np.asarray(self.standard(self.costs).mean(axis=1))

    @cached_property
    def parts(self) -> Floats:
        """d, of the candidates, [m, w]."""
        own = self.standard(self.costs)
        return np.asarray((own - own.mean(axis=1)[:, None]) / np.sqrt(own.shape[1]))

    def near(self, points: Floats) -> tuple[Floats, Floats]:
        """m and d of any points of the unit cube, [n, e], from the nearest candidates."""
        count = min(NEAR_ROWS, len(self.unit))
        distance = scipy.spatial.distance.cdist(points, self.unit)
        rows = np.argpartition(distance, count - 1, axis=1)[:, :count]
        weight = 1.0 / (np.take_along_axis(distance, rows, axis=1) + 1e-3) ** 2
        weight /= weight.sum(axis=1, keepdims=True)
        return (weight * self.mean[rows]).sum(axis=1), np.einsum(
            "nr,nrw->nw", weight, self.parts[rows]
        )


def posterior(
    worlds: Worlds, seen: Floats, values: Floats, points: Floats, own: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Mean and standard deviation at points [n, e], whose m and d are given, after trials.

    Args:
        worlds: of the table.
        seen: points of t trials, [t, e].
        values: their costs in the model's units, [t].
        points: of the candidates, [n, e].
        own: m [n] and d [n, w] of the candidates.
    """
    seen_mean, seen_parts = worlds.near(seen)
    between = seen_parts @ seen_parts.T
    apart = scipy.spatial.distance.cdist(seen, seen)
    rest, eye = values - seen_mean, np.eye(len(values))
    best, chosen = -np.inf, None
    for constants in product(WORLD_WEIGHTS, SIZES, LENGTHS):
        weight, size, length = constants
        covariance = weight**2 * between + SHIFT**2 + size**2 * matern(apart / length)
        factor = scipy.linalg.cholesky(covariance + NOISE**2 * eye, lower=True)
        solved = scipy.linalg.cho_solve((factor, True), rest)
        likelihood = -0.5 * rest @ solved - np.log(np.diag(factor)).sum()
        for value, (middle, spread) in zip(constants, PRIOR, strict=True):
            likelihood -= 0.5 * (np.log(value / middle) / spread) ** 2
        if likelihood > best:
            best, chosen = likelihood, (weight, size, length, factor, solved)
    assert chosen is not None
    weight, size, length, factor, solved = chosen
    mean, parts = own
    across = matern(scipy.spatial.distance.cdist(points, seen) / length)
    across = weight**2 * (parts @ seen_parts.T) + SHIFT**2 + size**2 * across
    known = scipy.linalg.solve_triangular(factor, across.T, lower=True)
    variance = weight**2 * (parts**2).sum(axis=1) + SHIFT**2 + size**2 - (known**2).sum(axis=0)
    return mean + across @ solved, np.sqrt(np.maximum(variance, 1e-12))


def matern(distance: Floats) -> Floats:
    """Matern's correlation with smoothness 5/2 (Rasmussen, Williams 2006, eq. 4.17)."""
    scaled = np.sqrt(5.0) * distance
    return np.asarray((1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled))


def _finite(values: Floats) -> Floats:
    """Costs, infinite ones as the worst or the best of the others."""
    known = values[np.isfinite(values)]
    low, high = (known.min(), known.max()) if len(known) else (0.0, 0.0)
    return np.nan_to_num(values, posinf=high, neginf=low)


class WorldSampler(ReproducibleRandomSampler):
    """Proposes rows of a table of costs in worlds, and points near the best trials.

    Args:
        table: whose features are costs of each row in each simulated world, in the units of the
            study's values: low costs are good where the study minimises, and high ones where it
            maximises. Rows with a gap are not proposed, and not learned from.
        seed: of all draws; None takes one from the machine's entropy.

    Raises:
        InputError: a table with fewer than two worlds, or without a row that has all of them.
    """

    @checks.checked(
        table=checks.instance(FeatureTable),
        seed=checks.optional(checks.whole(0, checks.LARGEST_SEED)),
    )
    def __init__(self, table: FeatureTable, *, seed: int | None = None) -> None:
        super().__init__(seed=seed)
        self._table = table
        if len(table.rows.feature_names) < 2:
            raise InputError("table", len(table.rows.feature_names), "costs in 2 worlds or more")
        _ = self._candidates

    def __repr__(self) -> str:
        """A call that makes an equal sampler."""
        return f"WorldSampler({self._table!r}, seed={self._seed})"

    def __getstate__(self) -> dict[str, Any]:
        """Without what is computed from the table."""
        return {name: value for name, value in vars(self).items() if name != "_candidates"}

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """The table's parameters."""
        return self._table.rows.space.as_dict()

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """The parameters of the next candidate."""
        self._raise_error_if_multi_objective(study)
        space, (numbers, worlds) = self._table.rows.space, self._candidates
        sign = 1.0 if study.direction is StudyDirection.MINIMIZE else -1.0
        worlds = worlds if sign > 0 else Worlds(worlds.unit, -worlds.costs)
        finished, tried = self._points(study, trial, TrialState.COMPLETE)
        running, under_way = self._points(study, trial, TrialState.RUNNING)
        taken = np.vstack([tried, under_way])
        points, merit = self._table.rows.parameters[numbers], -worlds.mean
        if finished:
            costs = np.array([sign * each.values[0] for each in finished])
            values = worlds.standard(_finite(costs))
            best = tried[np.argsort(values, kind="stable")[:CENTRES]]
            rng = generator(self._seed, Purpose.OFF_GRID, turn(study, trial))
            off_table = nearby(space, best, NEAR_POINTS, rng)
            points = np.vstack([points, off_table])
            with one_thread():
                seen, unit = space.unit(tried), space.unit(off_table)
                if running:  # as if they showed what is expected of them
                    there = space.unit(under_way)
                    told, _ = posterior(worlds, seen, values, there, worlds.near(there))
                    seen, values = np.vstack([seen, there]), np.concatenate([values, told])
                mean, parts = worlds.near(unit)
                own = np.concatenate([worlds.mean, mean]), np.vstack([worlds.parts, parts])
                unit = np.vstack([worlds.unit, unit])
                expected, deviation = posterior(worlds, seen, values, unit, own)
            merit = log_expected_improvement(expected, deviation, float(values.min()))
        merit = np.where(not_among(points, taken), merit, -np.inf)
        return space.values(points[int(np.argmax(merit))])

    @cached_property
    def _candidates(self) -> tuple[NDArray[np.int64], Worlds]:
        """Rows with a cost in every world, and these costs."""
        rows = self._table.rows
        numbers = np.flatnonzero(rows.offered & np.isfinite(rows.features).all(axis=1))
        if not len(numbers):
            raise InputError("table", "gaps in all rows", "a row with its cost in every world")
        return numbers, Worlds(rows.space.unit(rows.parameters[numbers]), rows.features[numbers])

    def _points(
        self, study: optuna.Study, trial: FrozenTrial, state: TrialState
    ) -> tuple[list[FrozenTrial], Floats]:
        """Other trials in a state that lie in the table's space, and their points [t, d]."""
        space = self._table.rows.space
        others = study.get_trials(deepcopy=False, states=(state,))
        rows = [(each, space.row(each.params)) for each in others if each.number != trial.number]
        found = [(each, row) for each, row in rows if row is not None]
        points = np.array([row for _, row in found]).reshape(-1, len(space))
        return [each for each, _ in found], points

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """Parameters that the table does not have are uniform."""
        self._raise_error_if_multi_objective(study)
        return super().sample_independent(study, trial, param_name, param_distribution)
