"""Tuning problems from outside, the samplers that are compared on them, and their runs.

A *problem* is a Parquet file of `data/`: a pool of candidates, cheap features of each,
and its cost, which was computed once, or measured. Users of public packages tune these
problems, and chemists measured the yields; none was invented here. An *arm* of `ARMS`
is a way of choosing trials. All arms meet the same costs: ours propose rows of the
pool; Optuna's propose any point of the space and get the cost of the nearest row. A
*run* is one arm on one problem with one seed. A cache keeps a file of each run, which
is made again where the code, the packages or the numbers that made it have changed.
"""

import ast
import hashlib
import json
import logging
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import repeat
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import optuna
import scipy
from numpy.typing import ArrayLike, NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
    json_to_distribution,
)
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import (
    BaseSampler,
    CmaEsSampler,
    GPSampler,
    RandomSampler,
    TPESampler,
)
from tqdm import tqdm

from storage.commit import commit_json
from storage.inputs.reading import parse_json, reading
from storage.processes import Processes
from study.sampler.sampler import FeatureKernelSampler
from study.sampler.table import FeatureTable
from tools.page import ROOT, installed, versions

Floats = NDArray[np.float64]
Columns = dict[str, NDArray[Any]]
Settings = Mapping[str, float | int | str]  # one candidate: its parameters by name

# our defaults saw them
TUNING = ("digits-network", "transport-solver", "cluster-evolution")
# looked at once, at the end
REPORTED = ("tumour-boosting", "cart-pole", "stiff-reactions")
# Measured yields, with computed descriptors of each component: Shields et al. 2021,
# "Bayesian reaction optimization as a tool for chemical synthesis", Nature 590, 89;
# data of the EDBO repository, MIT licence. Features are three principal components of a
# component's descriptors.
MEASURED = ("suzuki", "amination")
PROBLEMS = (*TUNING, *REPORTED, *MEASURED)
GROUPS = {
    "tuning": TUNING,
    "reported": REPORTED,
    "all": (*TUNING, *REPORTED),
    "measured": MEASURED,
}

DATA = ROOT / "tools" / "data"
METADATA_KEY = b"outside"
COST = "cost"
# of a column's name: a feature may be called as a parameter is
FEATURE_PREFIX = "feature."
RANKING = "ranking"  # the feature that is the problem's mean rank, low is good
# packages, for every arm
DECIDING = ("numpy", "scipy", "scikit-learn", "optuna", "cmaes")
ENQUEUED = 3  # rows that are tried before a peer's own first trial


@dataclass(frozen=True)
class Feature:
    """A cheap number of each candidate.

    Attributes:
        good: the end that is preferred, "low" or "high"; None: nobody knows.
        meaning: in words, with the unit.
    """

    good: Literal["low", "high"] | None
    meaning: str


@dataclass(frozen=True, eq=False)
class OutsideProblem:
    """A pool of n candidates, of which everything is known.

    Attributes:
        name: one of `PROBLEMS`.
        purpose: "tuning", "reported" or "measured".
        field: of the problem, in words.
        cost_meaning: the quantity that is minimised, with its unit.
        space: of the d parameters, as Optuna has it.
        columns: of the parameters, [n] each: floats, integers, or words.
        feature_meanings: of the k features, by name.
        features: as they came, [n, k]; infinite or NaN where the cheap run failed.
        cost: less is better, finite, [n].
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

    def __len__(self) -> int:
        return len(self.cost)

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

        Distance is Euclidean in a cube. A number is its place between the ends of its
        range, on its own scale (logarithmic where its distribution is). A choice is one
        coordinate a choice, of which one is 1: two choices are sqrt 2 apart, farther
        than the ends of a range, so that the proposed choice is kept unless everything
        else would have to change.
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
        return np.column_stack(
            [_cube(self.space[name], columns[name]) for name in self.space]
        )


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


@dataclass(frozen=True)
class Batches:
    """Trials of a run: so many at a time are proposed before any of them is told.

    Attributes:
        trials: of the whole run.
        size: so many are proposed at a time; the last batch may be smaller.
    """

    trials: int
    size: int = 1

    def __iter__(self) -> Iterator[int]:
        """The size of each batch; the last may be smaller."""
        for begun in range(0, self.trials, self.size):
            yield min(self.size, self.trials - begun)


def study_costs(
    problem: OutsideProblem,
    sampler: BaseSampler,
    batches: Batches,
    first: Iterable[Settings] = (),
) -> Floats:
    """Costs of the trials of a study in their order, [trials]; settings `first` are tried first."""
    study, costs = optuna.create_study(sampler=sampler), []
    for settings in first:
        study.enqueue_trial(dict(settings))
    for size in batches:
        for trial in [study.ask(problem.space) for _ in range(size)]:
            costs.append(problem.cost_at(trial.params))
            study.tell(trial, costs[-1])
    return np.array(costs)


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


def by_formula(problem: OutsideProblem) -> FeatureTable:
    """The pool if only the formulas of its components (SMILES) are known."""
    return FeatureTable.from_kernel(
        formula_similarity(problem.columns), problem.columns
    )


def formula_similarity(columns: Columns) -> Floats:
    """The mean over the columns of the share of common words of four letters, [n, n].

    LINGO: words of two molecules' texts, as a Tanimoto index (Vidal, Thormann, Pons
    2005).
    """
    similar = []
    for column in columns.values():
        kinds, place = np.unique(column, return_inverse=True)
        words = [
            {f"^{kind}$"[at : at + 4] for at in range(len(kind) - 1)} for kind in kinds
        ]
        shared = [
            [len(one & other) / len(one | other) for other in words] for one in words
        ]
        similar.append(np.array(shared)[np.ix_(place, place)])
    return np.asarray(np.mean(similar, axis=0))


def _ranking_alone(problem: OutsideProblem, seed: int, trials: Batches) -> Floats:
    return problem.cost[rows_by_ranking(problem, seed)[: trials.trials]]


def _tpe_after_ranking(problem: OutsideProblem, seed: int, trials: Batches) -> Floats:
    first = [
        problem.settings(int(row)) for row in rows_by_ranking(problem, seed)[:ENQUEUED]
    ]
    return study_costs(problem, TPESampler(seed=seed), trials, first)


def _baybe(problem: OutsideProblem, seed: int, trials: Batches) -> Floats:
    """BayBE over the rows, a descriptor table a component, as its user guide has it for chemistry.

    It is of problems whose parameters are choices, and whose features belong to one of
    them each.
    """
    import pandas
    from baybe import Campaign
    from baybe.parameters import CustomDiscreteParameter
    from baybe.searchspace import SearchSpace
    from baybe.targets import NumericalTarget
    from baybe.utils.random import set_random_seed

    set_random_seed(seed)
    rows, parameters = pandas.DataFrame(problem.columns), []
    for name, column in problem.columns.items():
        features = enumerate(problem.feature_meanings)
        own = np.array([place for place, of in features if of.startswith(f"{name}_")])
        kinds, first = np.unique(column, return_index=True)
        data = pandas.DataFrame(problem.features[np.ix_(first, own)], index=kinds)
        data.columns = [f"{name} {place}" for place in own]
        parameters.append(CustomDiscreteParameter(name, data=data))
    target = NumericalTarget(COST, mode="MIN").to_objective()
    campaign, costs = Campaign(SearchSpace.from_dataframe(rows, parameters), target), []
    for size in trials:
        tried = campaign.recommend(batch_size=size)
        found = [problem.cost_at(settings) for settings in tried.to_dict("records")]
        campaign.add_measurements(tried.assign(**{COST: found}))
        costs += found
    return np.array(costs)


def _ax(problem: OutsideProblem, seed: int, trials: Batches) -> Floats:
    """Ax's client with its defaults; it takes no descriptors."""
    from ax.api.client import Client
    from ax.api.configs import ChoiceParameterConfig

    logging.getLogger("ax").setLevel(logging.ERROR)
    client, costs = Client(random_seed=seed), list[float]()
    client.configure_experiment(
        parameters=[
            ChoiceParameterConfig(
                name=name, values=list(of.choices), parameter_type="str"
            )
            for name, of in problem.space.items()
            if isinstance(of, CategoricalDistribution)
        ]
    )
    client.configure_optimization(objective=f"-{COST}")
    for size in trials:
        for number, settings in client.get_next_trials(max_trials=size).items():
            costs.append(problem.cost_at(settings))
            client.complete_trial(trial_index=number, raw_data={COST: costs[-1]})
    return np.array(costs)


NOTHING, FEATURES, FORMULAS = "nothing", "features", "formulas"
RANKED = "features, and which end of each is good"


class Arm(NamedTuple):
    """A way of choosing trials that is compared with others.

    Attributes:
        label: for tables and plots.
        sees: its information beside the costs: `NOTHING`, `FEATURES`, `FORMULAS` or
            `RANKED`.
        costs: of the trials, by a problem, a seed and the batches.
        ours: whether its sampler is this project's.
        needs: a package that this project does not install; "": none.
    """

    label: str
    sees: str
    costs: Costs
    ours: bool = False
    needs: str = ""

    @property
    def runs(self) -> bool:
        """Whether this machine has what it needs."""
        return not self.needs or bool(installed(self.needs))

    def knows(self, problem: str) -> bool:
        """Whether a problem has what the arm sees: molecules have formulas, and no good ends."""
        return self.sees != (RANKED if problem in MEASURED else FORMULAS)


# A cost was computed for the rows of the pool alone: no other point is proposed.
OURS_RANKED = of_ours(partial(table, ranking=True), off_grid=0)

# CmaEsSampler draws choices at random, as always in Optuna.
ARMS = {
    "ours": Arm("ours", FEATURES, of_ours(table), ours=True),
    "ours-ranked": Arm("ours, with the ranking", RANKED, OURS_RANKED, ours=True),
    "ours-formulas": Arm(
        "ours, formulas alone", FORMULAS, of_ours(by_formula), ours=True
    ),
    "ranking": Arm("the ranking alone", RANKED, _ranking_alone),
    "tpe-ranking": Arm(
        f"TPESampler, {ENQUEUED} best-ranked rows first", RANKED, _tpe_after_ranking
    ),
    "tpe": Arm("TPESampler", NOTHING, of_optuna(TPESampler)),
    "gp": Arm("GPSampler", NOTHING, of_optuna(GPSampler), needs="torch"),
    "baybe": Arm("BayBE", FEATURES, _baybe, needs="baybe"),
    "ax": Arm("Ax", NOTHING, _ax, needs="ax-platform"),
    "cmaes": Arm(
        "CmaEsSampler",
        NOTHING,
        of_optuna(CmaEsSampler, warn_independent_sampling=False),
    ),
    "random": Arm("RandomSampler", NOTHING, of_optuna(RandomSampler)),
}


class Run(NamedTuple):
    """One study.

    Attributes:
        problem: its name, one of `PROBLEMS`.
        arm: its name, one of `ARMS`.
        seed: of the sampler, and of the half of the pool that it is given.
        trials: in their batches.
    """

    problem: str
    arm: str
    seed: int
    trials: Batches

    def file(self, cache: Path) -> Path:
        """The file of its costs."""
        size = f"-by-{self.trials.size}" if self.trials.size > 1 else ""
        name = f"{self.trials.trials}-trials{size}-seed-{self.seed:03d}.json"
        return cache / self.problem / self.arm / name

    def kept(self, cache: Path) -> list[float] | None:
        """Its costs in the cache; None if it is not there, or was made by other code."""
        try:
            known = json.loads(self.file(cache).read_text())
            return (
                known["costs"]
                if known["code"] == code(self.problem, self.arm)
                else None
            )
        except (OSError, ValueError, KeyError):
            return None

    def seconds(self, cache: Path) -> float:
        """The time that it took; its costs are in the cache."""
        return float(json.loads(self.file(cache).read_text())["seconds"])

    def execute(self, cache: Path) -> list[float]:
        """Run it, and keep its costs."""
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        warnings.simplefilter("ignore", ExperimentalWarning)
        half = outside_problem(self.problem).drawn(self.seed)
        started = time.perf_counter()
        costs = ARMS[self.arm].costs(half, self.seed, self.trials).tolist()
        known = {"code": code(self.problem, self.arm), "costs": costs}
        self.file(cache).parent.mkdir(parents=True, exist_ok=True)
        commit_json(
            self.file(cache), known | {"seconds": time.perf_counter() - started}
        )
        return list(costs)


@cache
def code(problem: str, arm: str) -> str:
    """Fingerprint of all that decides an arm's costs: the problem's file, packages and sources."""
    packages = versions(*DECIDING, *([ARMS[arm].needs] if ARMS[arm].needs else []))
    digest = hashlib.sha256(file_of(problem).read_bytes() + packages.encode())
    sampler = (
        sorted((ROOT / "study" / "sampler").glob("*.py")) if ARMS[arm].ours else []
    )
    for file in (Path(__file__), *sampler):
        # The syntax tree leaves out layout and comments, which do not decide a run.
        digest.update(ast.dump(ast.parse(file.read_text(encoding="utf-8"))).encode())
    return digest.hexdigest()[:16]


def execute(runs: Sequence[Run], cache: Path, processes: int) -> list[list[float]]:
    """Costs of each run; those that the cache lacks are run, some at a time."""
    found = {run: costs for run in runs if (costs := run.kept(cache)) is not None}
    missing = [run for run in runs if run not in found]
    with Processes(processes) as pool:
        done = pool.map(Run.execute, missing, repeat(cache))
        done = tqdm(done, total=len(missing), unit="run", disable=not missing)
        found |= zip(missing, done, strict=True)
    return [found[run] for run in runs]
