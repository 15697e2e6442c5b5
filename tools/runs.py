"""Studies over pools of which every cost is known, and a cache of such runs that resumes.

A *pool* has candidates and what each costs. An *arm* is a way of choosing trials. All
arms meet the same costs: some propose candidates of the pool; Optuna's propose any
point of the space and get the cost of the nearest candidate. A *run* is one arm on one
pool with one seed, which draws half of the pool. A cache keeps a file of each run,
which is made again where the code, the packages or the data that made it have changed.
"""

import ast
import hashlib
import json
import sys
import time
import warnings
from abc import ABC, abstractmethod
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import repeat
from pathlib import Path
from typing import Any, ClassVar, Generic, NamedTuple, Self, TypeVar

import numpy as np
import optuna
import scipy
from numpy.typing import ArrayLike, NDArray
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler
from tqdm import tqdm

from storage.commit import commit_json, require_folder
from storage.inputs.errors import InputError
from storage.processes import Processes
from study.options import MOST_WORKERS, Options
from tools.page import ROOT, installed, versions

Floats = NDArray[np.float64]
Columns = dict[str, NDArray[Any]]
Settings = Mapping[str, float | int | str]  # one candidate: its parameters by name

MOST_SEEDS, MOST_TRIALS = 10_000, 100_000
BEHIND_P = 0.05  # below it an arm that is behind is said to be so
# packages, for every arm
DECIDING = ("numpy", "scipy", "scikit-learn", "optuna", "cmaes")


@dataclass(frozen=True, eq=False)
class Pool:
    """n candidates, of which everything is known.

    Attributes:
        name: of the problem.
        space: of the d parameters, as Optuna has it.
        columns: of the parameters, [n] each: floats, integers, or words.
        cost: less is better, [n].
    """

    name: str
    space: dict[str, BaseDistribution]
    columns: Columns
    cost: Floats

    # arrays with a row a candidate
    BY_ROW: ClassVar[tuple[str, ...]] = ("cost",)

    def __len__(self) -> int:
        return len(self.cost)

    def drawn(self, seed: int) -> Self:
        """The same problem with half of the candidates, which the seed draws."""
        rng = np.random.default_rng(np.random.SeedSequence(seed))
        rows = np.sort(rng.choice(len(self), len(self) // 2, replace=False))
        columns = {name: column[rows] for name, column in self.columns.items()}
        arrays = {name: getattr(self, name)[rows] for name in self.BY_ROW}
        return replace(self, columns=columns, **arrays)

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
        return int(np.argmin(((self.points - point) ** 2).sum(axis=1)))

    def cost_at(self, settings: Settings) -> float:
        """The cost of the candidate nearest to any point of the space."""
        return float(self.cost[self.row_nearest_to(settings)])

    @cached_property
    def points(self) -> Floats:
        """The candidates in the unit cube, [n, coordinates]."""
        return self._coordinates(self.columns)

    def _coordinates(self, columns: Mapping[str, ArrayLike]) -> Floats:
        """Columns [n] as points of the cube, [n, coordinates]."""
        return np.column_stack(
            [_cube(self.space[name], columns[name]) for name in self.space]
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
    pool: Pool, sampler: BaseSampler, batches: Batches, first: Iterable[Settings] = ()
) -> Floats:
    """Costs of the trials of a study in their order, [trials]; settings `first` are tried first."""
    study, costs = optuna.create_study(sampler=sampler), []
    for settings in first:
        study.enqueue_trial(dict(settings))
    for size in batches:
        for trial in [study.ask(pool.space) for _ in range(size)]:
            costs.append(pool.cost_at(trial.params))
            study.tell(trial, costs[-1])
    return np.array(costs)


P = TypeVar("P", bound=Pool)


class Arm(NamedTuple, Generic[P]):
    """A way of choosing trials that is compared with others.

    Attributes:
        label: for tables and plots.
        costs: of the trials, by a pool, a seed and the batches.
        ours: whether its sampler is this project's.
        sees: its information beside the costs.
        needs: a package that this project does not install; "": none.
        lacks: what else is missing on this machine, in words; "": nothing.
    """

    label: str
    costs: Callable[[P, int, Batches], Floats]
    ours: bool = False
    sees: str = ""
    needs: str = ""
    lacks: Callable[[], str] = str

    @property
    def lacking(self) -> str:
        """What is missing on this machine, in words; "": nothing."""
        if self.needs and not installed(self.needs):
            return f"it needs {self.needs} (pip install {self.needs})"
        return self.lacks()


@dataclass(frozen=True)
class Run(ABC):
    """One study.

    Attributes:
        problem: its name.
        arm: its name.
        seed: of the sampler, and of the half of the pool that it is given.
        trials: in their batches.
    """

    problem: str
    arm: str
    seed: int
    trials: Batches

    @property
    @abstractmethod
    def pool(self) -> Pool:
        """The whole pool of the problem."""

    @property
    @abstractmethod
    def way(self) -> Arm[Any]:
        """The arm of that name."""

    @property
    @abstractmethod
    def data(self) -> tuple[Path, ...]:
        """Files that the pool was read from."""

    # of pools and arms
    SOURCES: ClassVar[tuple[Path, ...]]

    def file(self, cache: Path) -> Path:
        """The file of its costs."""
        size = f"-by-{self.trials.size}" if self.trials.size > 1 else ""
        name = f"{self.trials.trials}-trials{size}-seed-{self.seed:03d}.json"
        return cache / self.problem / self.arm / name

    @property
    def code(self) -> str:
        """Fingerprint of all that decides its costs: data, packages and sources."""
        own = sys.modules[self.way.costs.__module__].__file__
        assert own is not None  # an arm is defined in a file
        sources = (Path(__file__), Path(own), *self.SOURCES)
        if self.way.ours:
            sources += (*sorted((ROOT / "study" / "sampler").glob("*.py")),)
        needed = (self.way.needs,) if self.way.needs else ()
        return _fingerprint(self.data, sources, (*DECIDING, *needed))

    def kept(self, cache: Path) -> list[float] | None:
        """Its costs in the cache; None if it is not there, or was made by other code."""
        try:
            known = json.loads(self.file(cache).read_text())
            return known["costs"] if known["code"] == self.code else None
        except (OSError, ValueError, KeyError):
            return None

    def seconds(self, cache: Path) -> float:
        """The processor's time that it took; its costs are in the cache."""
        return float(json.loads(self.file(cache).read_text())["seconds"])

    def execute(self, cache: Path) -> list[float]:
        """Run it, and keep its costs."""
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        warnings.simplefilter("ignore", ExperimentalWarning)
        half = self.pool.drawn(self.seed)
        started = time.process_time()
        costs = self.way.costs(half, self.seed, self.trials).tolist()
        known = {"code": self.code, "costs": costs}
        self.file(cache).parent.mkdir(parents=True, exist_ok=True)
        commit_json(
            self.file(cache), known | {"seconds": time.process_time() - started}
        )
        return list(costs)


@cache
def _fingerprint(
    data: tuple[Path, ...], sources: tuple[Path, ...], packages: tuple[str, ...]
) -> str:
    digest = hashlib.sha256(versions(*packages).encode())
    for file in data:
        digest.update(file.read_bytes())
    for file in sources:
        # The syntax tree leaves out layout and comments, which do not decide a run.
        digest.update(ast.dump(ast.parse(file.read_text(encoding="utf-8"))).encode())
    return digest.hexdigest()[:16]


def execute(runs: Sequence[Run], cache: Path, processes: int) -> tuple[Floats, Floats]:
    """Costs [runs, trials] and seconds [runs]; runs that the cache lacks are made.

    So many processes make one each at a time.
    """
    found = {run: costs for run in runs if (costs := run.kept(cache)) is not None}
    missing = [run for run in runs if run not in found]
    with Processes(processes) as pool:
        done = pool.map(Run.execute, missing, repeat(cache))
        done = tqdm(done, total=len(missing), unit="run", disable=not missing)
        found |= zip(missing, done, strict=True)
    return (
        np.array([found[run] for run in runs]),
        np.array([run.seconds(cache) for run in runs]),
    )


class Versus(NamedTuple):
    """One arm against another, case by case.

    Attributes:
        won: cases.
        lost: cases.
        p: of the sign test over these cases, two-sided, not corrected for the number of
            tests.
    """

    won: int
    lost: int
    p: float

    @classmethod
    def of(cls, leads: Sequence[float]) -> "Versus":
        """Of seeds won less seeds lost, one a case."""
        won, lost = sum(lead > 0 for lead in leads), sum(lead < 0 for lead in leads)
        p = scipy.stats.binomtest(won, won + lost).pvalue if won + lost else 1.0
        return cls(won, lost, float(p))

    def cells(self) -> str:
        """Two cells of a table; p is bold where the first arm is behind."""
        is_behind = self.lost > self.won and self.p < BEHIND_P
        p = f"**{self.p:.2g}**" if is_behind else f"{self.p:.2g}"
        return f"{self.won}:{self.lost} | {p}"


class RunOptions(Options):
    """Options of a comparison: how many runs of how many trials, and where they are kept."""

    def __init__(self, file: str, seeds: int, trials: int, cache: str) -> None:
        super().__init__(file)
        text = "of each arm; %(default)s"
        self.whole("--seeds", 1, MOST_SEEDS, default=seeds, help=text)
        text = "of a run; %(default)s"
        self.whole("--trials", 2, MOST_TRIALS, default=trials, help=text)
        text = "trials at a time; %(default)s"
        self.whole("--batch", 1, MOST_TRIALS, default=1, help=text)
        text = "runs at a time; %(default)s"
        self.whole("--processes", 1, MOST_WORKERS, default=2, help=text)
        out = ROOT / "out"
        self.path("--out", "of the page; out/benchmarks", default=out / "benchmarks")
        self.path("--cache", f"of the runs; out/{cache}", default=out / cache)

    def parse_args(self, words: Sequence[str] | None = None) -> Namespace:  # type: ignore[override]
        """The options, with `batches`; the folders can be written.

        Raises:
            InputError: as of `Options`, or they cannot.
        """
        found = super().parse_args(words)
        require_folder(found.out)
        require_folder(found.cache, "cache")
        found.batches = Batches(found.trials, found.batch)
        return found


def chosen(field: str, listed: str, known: Sequence[str]) -> list[str]:
    """The comma-separated names, each once, in the order of `known`."""
    names = set(listed.split(","))
    for name in sorted(names.difference(known)):
        raise InputError(field, name, f"some of {','.join(known)}")
    return [name for name in known if name in names]


def runnable(names: list[str], arms: Mapping[str, Arm[Any]]) -> list[str]:
    """The arms that have what they need; a line says of each other what it lacks."""
    found = []
    for name in names:
        if lacking := arms[name].lacking:
            print(f"{arms[name].label} is left out: {lacking}", file=sys.stderr)
        else:
            found.append(name)
    if found:
        return found
    raise InputError("arms", ",".join(names), "an arm whose package is installed")
