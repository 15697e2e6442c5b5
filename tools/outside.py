"""Tuning problems from outside, and the samplers that are compared on them.

A *problem* is a Parquet file of `data/`: a pool of candidates, cheap features of each,
and its cost, which was computed once. Users of public packages tune these problems;
none was invented here. `ARMS` has the ways of choosing trials.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray
from optuna.distributions import json_to_distribution
from optuna.samplers import (
    BaseSampler,
    CmaEsSampler,
    GPSampler,
    RandomSampler,
    TPESampler,
)

from storage.inputs.reading import parse_json, reading
from study.sampler.sampler import FeatureKernelSampler
from study.sampler.table import FeatureTable
from tools.page import ROOT
from tools.runs import Arm, Batches, Floats, Pool, Run, study_costs

# our defaults saw them
TUNING = ("digits-network", "transport-solver", "cluster-evolution")
# looked at once, at the end
REPORTED = ("tumour-boosting", "cart-pole", "stiff-reactions")
PROBLEMS = (*TUNING, *REPORTED)
GROUPS = {"tuning": TUNING, "reported": REPORTED, "all": PROBLEMS}

DATA = ROOT / "tools" / "data"
METADATA_KEY = b"outside"
COST = "cost"
# of a column's name: a feature may be called as a parameter is
FEATURE_PREFIX = "feature."
ENQUEUED = 3  # rows that are tried before a peer's own first trial


@dataclass(frozen=True)
class Feature:
    """A cheap number of each candidate.

    Attributes:
        good: the end that is preferred, "low" or "high".
        meaning: in words, with the unit.
    """

    good: Literal["low", "high"]
    meaning: str


@dataclass(frozen=True, eq=False)
class OutsideProblem(Pool):
    """A pool of n candidates, with cheap features of each.

    Attributes:
        purpose: "tuning" or "reported".
        field: of the problem, in words.
        cost_meaning: the quantity that is minimised, with its unit.
        feature_meanings: of the k features, by name.
        features: as they came, [n, k]; infinite or NaN where the cheap run failed.
    """

    purpose: str
    field: str
    cost_meaning: str
    feature_meanings: dict[str, Feature]
    features: Floats

    BY_ROW = ("cost", "features")

    @cached_property
    def ranks(self) -> Floats:
        """Rank of each candidate by each feature from its good end, [n, k]; 1 is best.

        Equal values share the mean of their ranks, and NaN ranks last.
        """
        signs = [
            -1.0 if each.good == "high" else 1.0
            for each in self.feature_meanings.values()
        ]
        badness = np.where(np.isnan(self.features), np.inf, self.features * signs)
        return np.asarray(scipy.stats.rankdata(badness, axis=0))

    @cached_property
    def ranking(self) -> Floats:
        """Mean rank of a candidate over the features, [n]: the simplest guess from features."""
        return np.asarray(self.ranks.mean(axis=1))


def file_of(name: str) -> Path:
    return DATA / f"{name}.parquet"


@cache
def outside_problem(name: str) -> OutsideProblem:
    """One of `PROBLEMS` with all its candidates; read once a process, and not to be written to.

    Raises:
        InputError: the file is missing, broken or of another kind.
    """
    import pyarrow.parquet as pq  # slow to load

    with reading("problem", file_of(name), "a file of tools/data") as file:
        table = pq.read_table(file)
        document = parse_json(table.schema.metadata[METADATA_KEY])
    column = {name: np.array(table[name].to_pylist()) for name in table.column_names}
    meanings = {
        name: Feature(**meaning) for name, meaning in document["features"].items()
    }
    space = {
        name: json_to_distribution(text) for name, text in document["space"].items()
    }
    return OutsideProblem(
        **{key: document[key] for key in ("name", "purpose", "field", "cost_meaning")},
        space=space,
        columns={name: column[name] for name in space},
        feature_meanings=meanings,
        features=np.column_stack(
            [column[FEATURE_PREFIX + name] for name in meanings]
        ).astype("f8"),
        cost=column[COST].astype("f8"),
    )


def rows_by_ranking(problem: OutsideProblem, seed: int) -> NDArray[np.int64]:
    """Row numbers, the best-ranked first, [n]; the seed decides among equals and nothing else."""
    among_equals = np.random.default_rng(np.random.SeedSequence(seed)).permutation(
        len(problem)
    )
    return np.lexsort((among_equals, problem.ranking))


def table(problem: OutsideProblem, ranking: bool = False) -> FeatureTable:
    """The pool with its features as they come; with `ranking`, that is an outcome of each row."""
    known: dict[str, Any] = {"features": problem.features, "space": problem.space}
    if ranking:
        known |= {"outcomes": problem.ranking, "better": "lower"}
    with warnings.catch_warnings(
        action="ignore", category=UserWarning
    ):  # of infinite features
        names = [*problem.feature_meanings]
        return FeatureTable.from_arrays(problem.columns, feature_names=names, **known)


Costs = Callable[[OutsideProblem, int, Batches], Floats]  # of a problem, a seed, trials


def of_optuna(sampler: Callable[..., BaseSampler], **options: Any) -> Costs:
    """Of a sampler of Optuna, with its defaults but for the options."""
    return lambda problem, seed, trials: study_costs(
        problem, sampler(seed=seed, **options), trials
    )


def of_ours(pool: Callable[[OutsideProblem], FeatureTable], **options: Any) -> Costs:
    """Of our sampler over a problem's pool, with its defaults but for the options."""
    return lambda problem, seed, trials: study_costs(
        problem, FeatureKernelSampler(pool(problem), seed=seed, **options), trials
    )


def _ranking_alone(problem: OutsideProblem, seed: int, trials: Batches) -> Floats:
    return problem.cost[rows_by_ranking(problem, seed)[: trials.trials]]


def _tpe_after_ranking(problem: OutsideProblem, seed: int, trials: Batches) -> Floats:
    first = [
        problem.settings(int(row)) for row in rows_by_ranking(problem, seed)[:ENQUEUED]
    ]
    return study_costs(problem, TPESampler(seed=seed), trials, first)


NOTHING, FEATURES = "nothing", "features"
RANKED = "features, and which end of each is good"

# A cost was computed for the rows of the pool alone: no other point is proposed.
OURS_RANKED = of_ours(partial(table, ranking=True), off_grid=0)

# CmaEsSampler draws choices at random, as always in Optuna.
ARMS = {
    "ours": Arm("ours", of_ours(table), ours=True, sees=FEATURES),
    "ours-ranked": Arm("ours, with the ranking", OURS_RANKED, ours=True, sees=RANKED),
    "ranking": Arm("the ranking alone", _ranking_alone, sees=RANKED),
    "tpe-ranking": Arm(
        f"TPESampler, {ENQUEUED} best-ranked rows first",
        _tpe_after_ranking,
        sees=RANKED,
    ),
    "tpe": Arm("TPESampler", of_optuna(TPESampler), sees=NOTHING),
    "gp": Arm("GPSampler", of_optuna(GPSampler), sees=NOTHING, needs="torch"),
    "cmaes": Arm(
        "CmaEsSampler",
        of_optuna(CmaEsSampler, warn_independent_sampling=False),
        sees=NOTHING,
    ),
    "random": Arm("RandomSampler", of_optuna(RandomSampler), sees=NOTHING),
}


class OutsideRun(Run):
    """One study on a problem from outside."""

    SOURCES = (Path(__file__),)

    @property
    def pool(self) -> OutsideProblem:
        """The problem of that name."""
        return outside_problem(self.problem)

    @property
    def way(self) -> Arm[OutsideProblem]:
        """The arm of that name."""
        return ARMS[self.arm]

    @property
    def data(self) -> tuple[Path, ...]:
        """The problem's file."""
        return (file_of(self.problem),)
