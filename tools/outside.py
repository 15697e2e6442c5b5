"""Tuning problems from outside: pools of candidates whose costly objective was computed once.

Users of public packages tune them; none was invented here. A problem is a Parquet file of `data/`:
candidates, cheap features and the cost of each. All arms of `ARMS` meet the same objective: ours
propose rows of the pool; Optuna's propose any point of the space and get the cost of the nearest
row.
"""

import hashlib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
    json_to_distribution,
)
from optuna.samplers import BaseSampler

from study.sampler.sampler import FeatureKernelSampler
from study.sampler.table import FeatureTable
from taichi_nmm.errors import InputError
from taichi_nmm.reading import parse_json, reading
from tools.benchmark import PEERS, Arm, Floats, ours, peer, study_costs

Columns = dict[str, NDArray[Any]]
Settings = Mapping[str, float | int | str]  # one candidate: its parameters by name

TUNING = ("digits-network", "transport-solver", "cluster-evolution")  # our defaults saw them
REPORTED = ("tumour-boosting", "cart-pole", "stiff-reactions")  # looked at once, at the end
PROBLEMS = (*TUNING, *REPORTED)
GROUPS = {"tuning": TUNING, "reported": REPORTED, "all": PROBLEMS}

DATA = Path(__file__).parent / "data"
METADATA_KEY = b"outside"
COST = "cost"
FEATURE_PREFIX = "feature."  # of a column's name: a feature may be called as a parameter is
RANKING = "ranking"  # the feature that is the problem's mean rank, low is good
ENQUEUED = 3  # rows that are tried before a peer's own first trial


@dataclass(frozen=True)
class Feature:
    """A cheap number of each candidate: the preferred end, and a meaning that names the unit."""

    good: Literal["low", "high"]
    meaning: str


@dataclass(frozen=True, eq=False)
class OutsideProblem:
    """A pool of n candidates, of which everything is known."""

    name: str  # one of `PROBLEMS`
    purpose: str  # "tuning" or "reported"
    field: str  # of the problem, in words
    cost_meaning: str  # the minimised quantity, with its unit
    space: dict[str, BaseDistribution]  # of the d parameters, as Optuna has it
    columns: Columns  # of the parameters, [n] each: floats, integers, or words
    feature_meanings: dict[str, Feature]  # of k features by name
    features: Floats  # as they came, [n, k]; infinite or NaN where the cheap run failed
    cost: Floats  # [n], finite; less is better
    made_by: str  # the command that computed the file

    def __len__(self) -> int:
        return len(self.cost)

    @property
    def best(self) -> float:
        """The least cost of the pool: no arm gets below it."""
        return float(self.cost.min())

    @cached_property
    def ranks(self) -> Floats:
        """Rank of each candidate by each feature from its good end, [n, k]; 1 is best.

        Equal values share the mean of their ranks, and NaN ranks last.
        """
        signs = [1.0 if each.good == "low" else -1.0 for each in self.feature_meanings.values()]
        badness = np.where(np.isnan(self.features), np.inf, self.features * signs)
        return np.asarray(scipy.stats.rankdata(badness, axis=0))

    @cached_property
    def ranking(self) -> Floats:
        """Mean rank of a candidate over the features, [n]: the simplest guess from features."""
        return np.asarray(self.ranks.mean(axis=1))

    def drawn(self, seed: int) -> "OutsideProblem":
        """The same problem with half of the candidates, which the seed draws."""
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        rows = np.sort(rng.choice(len(self), len(self) // 2, replace=False))
        return replace(
            self,
            columns={name: column[rows] for name, column in self.columns.items()},
            features=self.features[rows],
            cost=self.cost[rows],
        )

    def settings(self, row: int) -> dict[str, float | int | str]:
        """The parameters of a candidate, as plain Python values."""
        return {name: column[row].item() for name, column in self.columns.items()}

    def row_nearest_to(self, settings: Settings) -> int:
        """The candidate nearest to any point of the space; of several, the first.

        Distance is Euclidean in a cube. A number is its place between the ends of its range, on its
        own scale (logarithmic where its distribution is). A choice is one coordinate a choice, of
        which one is 1: two choices are sqrt 2 apart, farther than the ends of a range, so that the
        proposed choice is kept unless everything else would have to change.
        """
        point = self._coordinates({name: [settings[name]] for name in self.space})
        return int(np.argmin(((self._points - point) ** 2).sum(axis=1)))

    def cost_at(self, settings: Settings) -> float:
        """The cost of the candidate nearest to any point of the space."""
        return float(self.cost[self.row_nearest_to(settings)])

    @cached_property
    def _points(self) -> Floats:
        return self._coordinates(self.columns)

    def _coordinates(self, columns: Mapping[str, ArrayLike]) -> Floats:
        """Columns [n] as points of the cube, [n, coordinates]."""
        return np.column_stack([_cube(self.space[name], columns[name]) for name in self.space])


def problem(name: str, seed: int) -> OutsideProblem:
    """Half of a problem's candidates, which the seed draws."""
    return outside_problem(name).drawn(seed)


def digest(name: str) -> str:
    """SHA-256 of a problem's file: other numbers are another problem."""
    return hashlib.sha256(file_of(name).read_bytes()).hexdigest()


def file_of(name: str) -> Path:
    """The file of a problem; an unknown one is an `InputError`."""
    if name not in PROBLEMS:
        raise InputError("problem", name, f"one of {', '.join(PROBLEMS)}")
    return DATA / f"{name}.parquet"


@cache
def outside_problem(name: str) -> OutsideProblem:
    """A problem with all its candidates; read once a process, and not to be written to.

    Raises:
        InputError: no such problem, or its file is missing or broken.
    """
    return read(file_of(name))


def read(path: Path) -> OutsideProblem:
    """A problem from its file.

    Raises:
        InputError: the file is missing, broken or of another kind.
    """
    import pyarrow.parquet as pq  # slow to load

    with reading("problem", path, "a file of tools/data") as file:
        table = pq.read_table(file)
        document = parse_json(table.schema.metadata[METADATA_KEY])
    column = {name: np.array(table[name].to_pylist()) for name in table.column_names}
    meanings = {name: Feature(**meaning) for name, meaning in document["features"].items()}
    space = {name: json_to_distribution(text) for name, text in document["space"].items()}
    return OutsideProblem(
        **{key: document[key] for key in ("name", "purpose", "field", "cost_meaning")},
        space=space,
        columns={name: column[name] for name in space},
        feature_meanings=meanings,
        features=np.column_stack([column[FEATURE_PREFIX + name] for name in meanings]).astype("f8"),
        cost=column[COST].astype("f8"),
        made_by=document["command"],
    )


def _cube(distribution: BaseDistribution, values: ArrayLike) -> Floats:
    """A column [n] as coordinates, [n, 1] or, of a choice, [n, choices]."""
    if isinstance(distribution, CategoricalDistribution):
        equal = np.asarray(values)[:, None] == np.array(distribution.choices)
        return np.asarray(equal, dtype=np.float64)
    assert isinstance(distribution, FloatDistribution | IntDistribution)
    numbers = np.asarray(values, dtype=np.float64)
    low, high = float(distribution.low), float(distribution.high)
    if distribution.log:
        numbers, low, high = np.log(numbers), np.log(low), np.log(high)
    return np.asarray(((numbers - low) / (high - low))[:, None])


def rows_by_ranking(problem: OutsideProblem, seed: int) -> NDArray[np.int64]:
    """Row numbers, the best-ranked first, [n]; the seed decides among equals and nothing else."""
    among_equals = np.random.default_rng(np.random.SeedSequence(seed)).permutation(len(problem))
    return np.lexsort((among_equals, problem.ranking))


def table(problem: OutsideProblem, ranking: bool) -> FeatureTable:
    """The pool with its features as they come; with `ranking`, the ranking is one more."""
    features, names = problem.features, [*problem.feature_meanings]
    if ranking:
        features, names = np.column_stack([features, problem.ranking]), [*names, RANKING]
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # of infinite features
        return FeatureTable.from_arrays(problem.columns, features, names, space=problem.space)


def _ours(problem: OutsideProblem, seed: int) -> BaseSampler:
    return FeatureKernelSampler(table(problem, ranking=False), seed=seed)


def _ours_with_prior(problem: OutsideProblem, seed: int) -> BaseSampler:
    return FeatureKernelSampler(table(problem, ranking=True), seed=seed, prior=f"-{RANKING}")


def _ranking_alone(problem: OutsideProblem, seed: int, trials: int) -> Floats:
    return problem.cost[rows_by_ranking(problem, seed)[:trials]]


def _tpe_after_ranking(problem: OutsideProblem, seed: int, trials: int) -> Floats:
    first = [problem.settings(int(row)) for row in rows_by_ranking(problem, seed)[:ENQUEUED]]
    return study_costs(problem, PEERS["tpe"][1](seed), trials, first)


_NOTHING = "nothing"
_FEATURES = "features"
_RANKED = "features, and which end of each is good"

ARMS = {
    "ours": ours("ours", _FEATURES, _ours, features=True),
    "ours-prior": ours("ours, ranking as prior", _RANKED, _ours_with_prior, features=True),
    "ranking": Arm("the ranking alone", _RANKED, "control", _ranking_alone, features=True),
    "tpe-ranking": Arm(
        f"TPESampler, {ENQUEUED} best-ranked rows first", _RANKED, "peer", _tpe_after_ranking,
        features=True,
    ),
    **{name: peer(name, _NOTHING) for name in ("tpe", "gp", "cmaes", "random")},
}  # fmt: skip
