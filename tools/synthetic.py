"""Synthetic problems in 16 dimensions: a rugged cost, and a feature of known worth.

A problem is a cost and one feature of a parameter set. The cost is a sum of 16 terms of a textbook
function, each at least zero, so that the least cost is known: it is zero.

| problem | cost | feature |
|---|---|---|
| informative | Schwefel | a cheap simulation: all but 3 of the 16 terms |
| misleading | Rastrigin | the same, folded at its best tenth: the best rows look mediocre |
| useless | Rastrigin | a rapid wave along a random direction, unrelated to the cost |
| informative-bowl | Rastrigin | as in informative |

Schwefel's function has no trend towards its optimum: 60 trials teach a model of the 16 parameters
little. Rastrigin's is a bowl with ripples, so they teach it much; a feature that is not worth
anything must not take that away.

Each seed is another instance: Schwefel's is mirrored in random parameters, Rastrigin's is shifted
and rotated at random. `ARMS` are the samplers that are compared on it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import scipy
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.samplers import BaseSampler

from study.sampler.sampler import FeatureKernelSampler
from study.sampler.table import FeatureTable
from taichi_nmm.errors import InputError
from tools.benchmark import Arm, Floats, ours, peer

Function = Callable[[Floats], Floats]

DIMENSION = 16
NAMES = tuple(f"p{number:02d}" for number in range(DIMENSION))
PROBLEMS = ("informative", "misleading", "useless", "informative-bowl")
GROUPS = {"all": PROBLEMS}
SOBOL_BITS = 12  # 4,096 rows in a table

# Schwefel 1981: sum of 418.98... - x sin sqrt|x|; the constant makes the least value zero.
SCHWEFEL_HALF_WIDTH = 500.0
SCHWEFEL_OPTIMUM = 420.968746359982
SCHWEFEL_CONSTANT = SCHWEFEL_OPTIMUM * float(np.sin(np.sqrt(SCHWEFEL_OPTIMUM)))

# Rastrigin 1974: sum of u^2 + 10 (1 - cos 2 pi u).
RASTRIGIN_HALF_WIDTH = 5.12
RASTRIGIN_RIPPLE = 10.0

TERMS_MISSED = 3  # by the cheap simulation: it explains 13/16 of the cost's variance
FOLDED_SHARE = 0.1  # of the space, the best by the cheap simulation
WAVES = 50.0  # across the width of the box
OFF_GRID = 256  # perturbations a trial, of the arm that may leave the table

_OF_COST, _OF_TABLE, _OF_FEATURE, _OF_FOLD = range(4)  # purposes of draws: spawn keys


@dataclass(frozen=True, eq=False)
class Problem:
    """A cost to minimise over a box, and a feature of every point of it."""

    name: str  # one of `PROBLEMS`
    seed: int  # of the instance
    half_width: float  # every parameter lies in [-half_width, half_width]
    terms: Function  # of the cost, [n, 16] -> [n, 16], each at least 0
    feature: Function  # [n, 16] -> [n]

    def cost(self, points: Floats) -> Floats:
        """Cost of points [n, 16], [n]; the least possible is 0, so it is the regret as well."""
        return np.asarray(self.terms(points).sum(axis=1))

    def features(self, points: Floats) -> Floats:
        """Feature of points [n, 16] in the order of `NAMES`, [n, 1]."""
        return self.feature(points)[:, None]

    @property
    def space(self) -> dict[str, BaseDistribution]:
        """The box, as Optuna has it."""
        return dict.fromkeys(NAMES, FloatDistribution(-self.half_width, self.half_width))

    def rows(self, bits: int = SOBOL_BITS) -> Floats:
        """2^bits scrambled Sobol points of the box, [2^bits, 16]: the rows of a table."""
        return _sobol(self.half_width, bits, _rng(self.seed, _OF_TABLE))

    def cost_at(self, settings: Mapping[str, float]) -> float:
        """The cost of a point of the box, by the names of its parameters."""
        return float(self.cost(np.array([[settings[name] for name in NAMES]]))[0])


def problem(name: str, seed: int) -> Problem:
    """An instance of a problem.

    Raises:
        InputError: no such problem.
    """
    if name not in PROBLEMS:
        raise InputError("problem", name, f"one of {', '.join(PROBLEMS)}")
    make, half_width = LANDSCAPES[shared(name)]
    terms = make(_rng(seed, _OF_COST))
    return Problem(name, seed, half_width, terms, _feature(name, seed, half_width, terms))


def shared(name: str) -> str:
    """The landscape, whose problems have one cost: the folder of runs without features."""
    return "schwefel" if name == "informative" else "rastrigin"


def digest(name: str) -> str:
    """Nothing: this file decides all numbers."""
    return ""


def _schwefel(rng: np.random.Generator) -> Function:
    """Schwefel's terms, mirrored in some of the parameters."""
    sign = rng.choice([-1.0, 1.0], DIMENSION)

    def terms(points: Floats) -> Floats:
        x = sign * points
        return np.asarray(SCHWEFEL_CONSTANT - x * np.sin(np.sqrt(np.abs(x))))

    return terms


def _rastrigin(rng: np.random.Generator) -> Function:
    """Rastrigin's terms about a point of the box's inner half, in turned coordinates."""
    optimum = rng.uniform(-0.5, 0.5, DIMENSION) * RASTRIGIN_HALF_WIDTH
    rotation = scipy.stats.ortho_group.rvs(DIMENSION, random_state=rng)

    def terms(points: Floats) -> Floats:
        u = (points - optimum) @ rotation
        return np.asarray(u**2 + RASTRIGIN_RIPPLE * (1.0 - np.cos(2.0 * np.pi * u)))

    return terms


LANDSCAPES = {
    "schwefel": (_schwefel, SCHWEFEL_HALF_WIDTH),
    "rastrigin": (_rastrigin, RASTRIGIN_HALF_WIDTH),
}


def _feature(name: str, seed: int, half_width: float, terms: Function) -> Function:
    """The feature of a problem, by its name."""
    rng = _rng(seed, _OF_FEATURE)
    if name == "useless":  # a sine along a random direction, `WAVES` periods across the box
        direction = rng.standard_normal(DIMENSION)
        direction *= np.pi * WAVES / (half_width * np.linalg.norm(direction))
        return lambda points: np.sin(points @ direction)
    known = rng.permutation(DIMENSION)[TERMS_MISSED:]

    def cheap(points: Floats) -> Floats:
        return np.asarray(terms(points)[:, known].sum(axis=1))

    if name != "misleading":
        return cheap
    space = _sobol(half_width, SOBOL_BITS, _rng(seed, _OF_FOLD))
    fold = float(np.quantile(cheap(space), FOLDED_SHARE))
    return lambda points: np.abs(cheap(points) - fold)


def _sobol(half_width: float, bits: int, rng: np.random.Generator) -> Floats:
    """2^bits scrambled Sobol points of the box, [2^bits, 16]."""
    unit = scipy.stats.qmc.Sobol(DIMENSION, rng=rng).random_base2(bits)
    return np.asarray(half_width * (2.0 * unit - 1.0))


def _rng(seed: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(purpose,)))


def _table(found: Problem) -> FeatureTable:
    """The problem's rows with their feature."""
    rows = found.rows()
    columns = dict(zip(NAMES, rows.T, strict=True))
    return FeatureTable.from_arrays(columns, found.features(rows), space=found.space)


def _over_rows(kernel: str | None = None) -> Callable[[Problem, int], BaseSampler]:
    """Our sampler over the rows of the table; None: the kernel that it has by default."""
    return lambda found, seed: FeatureKernelSampler(_table(found), seed=seed, kernel=kernel)


def _euclidean(found: Problem, seed: int) -> BaseSampler:
    return FeatureKernelSampler(None, seed=seed, space=found.space)


def _off_grid(found: Problem, seed: int) -> BaseSampler:
    return FeatureKernelSampler(
        _table(found), seed=seed, feature_function=found.features, off_grid=OFF_GRID
    )


def _random_rows(found: Problem, seed: int, trials: int) -> Floats:
    rows = found.rows()
    return found.cost(rows[np.random.default_rng(seed).permutation(len(rows))[:trials]])


def _score_first(found: Problem, _: int, trials: int) -> Floats:
    """Costs of the rows, the least feature first."""
    rows = found.rows()
    return found.cost(rows[np.argsort(found.features(rows)[:, 0], kind="stable")[:trials]])


_SPACE = "the space"
_ROWS = "4,096 rows"
_FEATURE = "4,096 rows and their feature"
_MORE = "4,096 rows, points near the best of them, the feature of each"

ARMS = {
    **{name: peer(name, _SPACE) for name in ("random", "tpe", "gp", "cmaes")},
    "random-rows": Arm("random rows", _ROWS, "control", _random_rows),
    "score-first": Arm("least feature first", _FEATURE, "control", _score_first, features=True),
    "euclidean": ours("ours, Euclidean", _SPACE, _euclidean),
    "euclidean-rows": ours("ours, Euclidean, rows", _ROWS, _over_rows("euclidean")),
    "ours": ours("ours", _FEATURE, _over_rows(), features=True),
    "paper": ours("ours, the paper's kernel", _FEATURE, _over_rows("rbf"), features=True),
    "off-grid": ours("ours, off the table", _MORE, _off_grid, features=True),
}
