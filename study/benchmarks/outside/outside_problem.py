"""The reader of a problem's file: candidates, features and costs, as an Optuna study meets them."""

import hashlib
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
    json_to_distribution,
)
from scipy.stats import rankdata

from study.benchmarks.outside.catalogue import require_known
from study.benchmarks.outside.definition import Feature, Settings
from study.benchmarks.outside.nearest import Nearest
from taichi_nmm.reading import parse_json, reading

Floats = NDArray[np.float64]
Columns = dict[str, NDArray[Any]]

DATA = Path(__file__).parent / "data"
METADATA_KEY = b"outside"
COST = "cost"
FEATURE_PREFIX = "feature."  # of a column's name: a feature may be called as a parameter is


@dataclass(frozen=True, eq=False)
class OutsideProblem:
    """A pool of n candidates, of which everything is known.

    Attributes:
        name: one of `catalogue.PROBLEMS`.
        purpose: "tuning" or "reported".
        field: whose problem it is.
        cost_meaning: what is minimised, with its unit.
        space: of the parameters, d of them, as Optuna has it.
        columns: of the parameters, [n] each: floats, integers, or words.
        feature_meanings: of k features by name: the good end, and what the numbers are.
        features: as they came, [n, k]; infinite or NaN where the cheap run failed.
        cost: [n], finite; less is better.
        made_by: the command that computed the file.
    """

    name: str
    purpose: str
    field: str
    cost_meaning: str
    space: dict[str, BaseDistribution]
    columns: Columns
    feature_meanings: dict[str, Feature]
    features: Floats
    cost: Floats
    made_by: str

    def __len__(self) -> int:
        """Number of candidates, n."""
        return len(self.cost)

    @property
    def best(self) -> float:
        """The least cost of the pool: nobody gets below it."""
        return float(self.cost.min())

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Of the columns of `features`, k."""
        return tuple(self.feature_meanings)

    @cached_property
    def ranks(self) -> Floats:
        """Rank of each candidate by each feature from its good end, [n, k]; 1 is best.

        Equal values share the mean of their ranks, and NaN ranks last.
        """
        signs = [1.0 if each.good == "low" else -1.0 for each in self.feature_meanings.values()]
        badness = np.where(np.isnan(self.features), np.inf, self.features * signs)
        return np.asarray(rankdata(badness, axis=0))

    @cached_property
    def ranking(self) -> Floats:
        """Mean rank of a candidate over the features, [n]: a guess of anybody who has them."""
        return np.asarray(self.ranks.mean(axis=1))

    def drawn(self, seed: int) -> "OutsideProblem":
        """The same problem with half of the candidates, drawn by the seed: a sample of problems."""
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
        """The candidate nearest to any point of the space, as `nearest.Nearest` measures."""
        return self._nearest.row(settings)

    def objective(self, trial: optuna.Trial) -> float:
        """The cost of the candidate nearest to what is suggested; the row itself costs its own."""
        settings = {name: _suggest(trial, name, self.space[name]) for name in self.space}
        return float(self.cost[self.row_nearest_to(settings)])

    @cached_property
    def _nearest(self) -> Nearest:
        return Nearest(self.space, self.columns)


def file_of(name: str) -> Path:
    """Where a problem's file is.

    Raises:
        InputError: no such problem.
    """
    require_known(name)
    return DATA / f"{name}.parquet"


def digest(name: str) -> str:
    """SHA-256 of a problem's file: other numbers are another problem."""
    return hashlib.sha256(file_of(name).read_bytes()).hexdigest()


@cache
def outside_problem(name: str) -> OutsideProblem:
    """A problem by its name; read once a process, and not to be written to.

    Raises:
        InputError: no such problem, or its file is missing or broken.
    """
    return read(file_of(name))


def read(path: Path) -> OutsideProblem:
    """A problem from a file that `making.make` wrote.

    Raises:
        InputError: the file is missing, broken or another's.
    """
    import pyarrow.parquet as pq  # slow to load

    with reading("problem", path, "a file of tools/make_outside.py") as file:
        table = pq.read_table(file)
        said = parse_json(table.schema.metadata[METADATA_KEY])
    column = {name: np.array(table[name].to_pylist()) for name in table.column_names}
    meanings = {name: Feature(**meaning) for name, meaning in said["features"].items()}
    stacked = [column[FEATURE_PREFIX + name].astype(np.float64) for name in meanings]
    space = {name: json_to_distribution(text) for name, text in said["space"].items()}
    return OutsideProblem(
        name=said["name"],
        purpose=said["purpose"],
        field=said["field"],
        cost_meaning=said["cost_meaning"],
        space=space,
        columns={name: column[name] for name in space},
        feature_meanings=meanings,
        features=np.column_stack(stacked),
        cost=column[COST].astype(np.float64),
        made_by=said["command"],
    )


def _suggest(trial: optuna.Trial, name: str, distribution: BaseDistribution) -> float | int | str:
    """A parameter of the trial, as an objective asks for it."""
    if isinstance(distribution, CategoricalDistribution):
        return str(trial.suggest_categorical(name, distribution.choices))
    if isinstance(distribution, IntDistribution):
        return trial.suggest_int(name, distribution.low, distribution.high, log=distribution.log)
    assert isinstance(distribution, FloatDistribution)
    return trial.suggest_float(name, distribution.low, distribution.high, log=distribution.log)
