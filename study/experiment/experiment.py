"""An experiment: a simulator, the robots, the cost that its studies share, and its stores.

What is written here holds of robots of any simulator. `study.experiment.walker` has the
walker's, `study.experiment.robots` those of a simulator that a configuration names. The
stores that arms read are checked before the work, and read once a process.
"""

import hashlib
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray
from optuna.distributions import BaseDistribution, CategoricalDistribution

from storage.inputs.config import Table
from storage.inputs.errors import InputError, listed
from storage.simulator import Simulator
from storage.store import MANIFEST_NAME, Manifest, Store, open_store
from storage.tables import file_hash
from study.experiment.features import feature_table
from study.experiment.objective import Objective
from study.sampler.draws import Purpose, generator, name_key, seed_64bit
from study.sampler.table import FeatureTable

NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9._-]*"
NAME_WORDS = "letters, digits, '.', '_' and '-', first a letter or digit"
MOST_RUNS = 10_000
# end of a study's name that has no trials and compares other studies
SUMMARY = "/summary"
MOST_TRIALS = 100_000
WALKED = "walked"  # column and attribute: whether a trial succeeded

Floats = NDArray[np.float64]
Rows = NDArray[np.void]
Space = dict[str, BaseDistribution]


@dataclass(frozen=True, kw_only=True)
class Experiment(ABC):
    """All that the studies of an experiment share. It pickles; processes draw the robots.

    From `runs` on, fields decide no trial: they may grow, or their content is known by
    digest.

    Attributes:
        name: a study is called name/arm/run-NNN.
        seed: of robots, noise and samplers: run r draws from (seed, purpose, r).
        objective: what a trial costs.
        noise: of a cost as samplers are told it, relative: standard deviation of its
            logarithm, 0 to 1.
        until_walker: whether a study ends with its first walker, where others have all
            trials.
        runs: their number, each a robot in its world.
        trials: of each arm in each run, at most.
        arms: that are compared, by name.
        stores: folders of scores, by the name that arms know them by.
    """

    name: str
    seed: int
    objective: Objective
    noise: float = 0.0
    until_walker: bool = False
    runs: int = 50
    trials: int = 100
    arms: tuple[str, ...] = ()
    stores: Mapping[str, Path] = field(default_factory=dict, hash=False)

    @property
    @abstractmethod
    def robot(self) -> Simulator:
        """The simulator that runs the trials, with its settings."""

    @property
    @abstractmethod
    def trial_s(self) -> float:
        """How long a trial may last, in s."""

    @property
    @abstractmethod
    def space(self) -> Space:
        """What a trial suggests, as Optuna has it."""

    @property
    @abstractmethod
    def columns_of_store(self) -> tuple[tuple[str, BaseDistribution], ...] | None:
        """The parameters that arms take of a store; None: those that the store has."""

    @property
    @abstractmethod
    def packages(self) -> tuple[str, ...]:
        """Packages whose versions decide the trials."""

    @property
    @abstractmethod
    def kept(self) -> tuple[str, ...]:
        """Numbers of a run that a table of trials keeps beside its cost."""

    @property
    @abstractmethod
    def attributes(self) -> tuple[str, ...]:
        """Attributes of a trial in a study database, for readers."""

    @property
    @abstractmethod
    def measures(self) -> tuple[str, ...]:
        """Those attributes that `outcome_text` takes."""

    @property
    @abstractmethod
    def row_type(self) -> np.dtype[np.void]:
        """Names and types of what a run gives."""

    @abstractmethod
    def document(self) -> dict[str, Any]:
        """All that decides trials but the arms, as JSON values."""

    @abstractmethod
    def require_store(self, key: str, store: Store) -> None:
        """Refuse a store of other parameters.

        Raises:
            InputError: naming the parameter.
        """

    @abstractmethod
    def simulate(self, runs: ArrayLike, points: Floats) -> Rows:
        """Rows of n trials, [n], without NaN.

        Args:
            runs: of each trial, [n].
            points: the parameters of each, as the simulator's numbers, [n, p].

        Raises:
            InputError: what the simulator refuses.
        """

    @abstractmethod
    def fell(self, rows: Rows) -> NDArray[np.bool_]:
        """Which runs did not last to the end, bool [n]."""

    @abstractmethod
    def outcome_text(self, shown: Mapping[str, Any]) -> str:
        """How a trial ended, in words, from its `attributes`."""

    @abstractmethod
    def on_one_thread(self) -> Self:
        """The same for one of several processes of a machine; no result depends on it."""

    def walked(self, rows: Rows) -> NDArray[np.bool_]:
        """Which runs succeeded, bool [n]."""
        return ~self.fell(rows)

    def words(self, rows: Rows) -> dict[str, Any]:
        """Columns of a table of trials beside `kept` and the fixed parameters, each [n]."""
        return {}

    @property
    def fixed_by_name(self) -> dict[str, float]:
        """Parameters that are fixed."""
        return {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the searched parameters."""
        return tuple(self.space)

    def sampler_seed(self, arm: str, run: int) -> int:
        """The seed of a study's sampler."""
        return seed_64bit(self.seed, Purpose.SAMPLER, name_key(arm), run)

    def rows_of(self, table: pa.Table) -> Rows:
        """The trials of a table as rows of the simulator, [n]; columns not kept are zero."""
        rows = np.zeros(len(table), self.row_type)
        for name in self.kept:
            rows[name] = table[name].to_numpy()
        return rows

    def attributes_of(self, row: np.void) -> dict[str, Any]:
        """`attributes` of a row, as plain values."""
        rows = np.array([row])
        known = {name: rows[name] for name in self.kept}
        known |= {WALKED: self.walked(rows), **self.words(rows)}
        return {name: known[name][0].item() for name in self.attributes}

    def told(self, costs: Floats, run: int, trial: int) -> list[float]:
        """The costs of a trial as its sampler is told them, [k]: with noise.

        A trial of a run has the same noise in all arms.
        """
        if self.noise:
            errors = generator(self.seed, Purpose.COST_NOISE, run)
            factors = np.exp(self.noise * errors.standard_normal(trial + 1))
            costs = costs * factors[trial]
        return [float(cost) for cost in costs]

    @property
    def objective_document(self) -> dict[str, Any]:
        """The table [objective]; noise that is none changes no digest of before there was any."""
        noise = {"noise": self.noise} if self.noise else {}
        return self.objective.document() | noise

    def require_run(self, run: int) -> None:
        """Refuse a run that the experiment does not have.

        Raises:
            InputError: naming the run.
        """
        if not 0 <= run < self.runs:
            raise InputError(
                "run", run, f"0 to {self.runs - 1}, the runs of {self.name}"
            )


def ends_of(distribution: BaseDistribution) -> list[Any]:
    """The bounds of a parameter, or its choices."""
    if isinstance(distribution, CategoricalDistribution):
        return list(distribution.choices)
    return [float(distribution.low), float(distribution.high)]  # type: ignore[attr-defined]


def study_name(experiment: str, arm: str, run: int) -> str:
    """The name of an arm's study in a run, live or exported."""
    return f"{experiment}/{arm}/run-{run:03d}"


def read_name(table: Table, name: str) -> str:
    """The name of an experiment, which becomes a part of studies' and folders' names."""
    name = table.text("name", name)
    if not re.fullmatch(NAME_PATTERN, name):
        raise InputError("name", name, NAME_WORDS)
    return name


def read_seed(table: Table, seed: int | None) -> int:
    """The seed of a configuration, or another one in its place."""
    configured = table.integer("seed")
    return configured if seed is None else Table({"seed": seed}).integer("seed")


def candidates(experiment: Experiment, store: str, feature: str) -> FeatureTable:
    """The rows of a store with a feature, for studies of an experiment.

    Raises:
        InputError: the configuration names no such store, or it cannot be read.
    """
    path = store_path(experiment, store)
    written = path / MANIFEST_NAME if path.is_dir() else path
    try:
        written_ns = written.stat().st_mtime_ns
    except OSError:
        written_ns = 0  # opening the store tells what is missing
    return _candidates(
        path, written_ns, feature, experiment.columns_of_store, experiment.objective
    )


@lru_cache(maxsize=16)
def _candidates(
    path: Path,
    _written_ns: int,
    feature: str,
    columns: tuple[tuple[str, BaseDistribution], ...] | None,
    objective: Objective,
) -> FeatureTable:
    space = None if columns is None else dict(columns)
    return feature_table(open_store(path), feature, space, objective)


def store_path(experiment: Experiment, store: str) -> Path:
    """Where the store of that name is.

    Raises:
        InputError: the configuration does not name it.
    """
    if store not in experiment.stores:
        known = listed(experiment.stores, store) or "none"
        allowed = f"a folder in the configuration's [stores], which has {known}"
        raise InputError(f"stores.{store}", "missing", allowed)
    return experiment.stores[store]


def check_store(experiment: Experiment, store: str) -> Store:
    """Open a store, and see that it has the experiment's parameters.

    Raises:
        InputError: no such store, not a finished store, or other parameters or bounds.
    """
    opened = open_store(store_path(experiment, store))
    experiment.require_store(store, opened)
    opened.require_bounds()
    return opened


def store_digest(path: Path) -> str:
    """SHA-256 of a store's content: of its manifest's hashes, or of the one file that it is."""
    if not path.is_dir():
        return file_hash(path)
    hashes = Manifest.read(path).hashes
    return hashlib.sha256("\n".join(hashes.values()).encode()).hexdigest()
