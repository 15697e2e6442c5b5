"""An experiment: the bodies, the grounds and the cost that its studies share, and its stores.

This is the one reader of experiments' configurations: one study, many, and a single
walk all take the same file. The stores that its arms read are checked before the work,
and read once a process.
"""

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from optuna.distributions import FloatDistribution

from storage.inputs.config import Table, read_toml, read_whole
from storage.inputs.errors import InputError, listed
from storage.simulator import SURVIVED
from storage.store import MANIFEST_NAME, Manifest, Store, open_store
from storage.tables import file_hash
from study.experiment.features import feature_table
from study.experiment.objective import Objective, read_objective
from study.sampler.draws import Purpose, stream
from study.sampler.table import FeatureTable
from taichi_nmm.body import GRAVITY_MPS2, Bodies
from taichi_nmm.conditions import Conditions, read_conditions
from taichi_nmm.parameters import (
    ASYMMETRIES,
    DEVICE,
    GAIN_NAMES,
    GAINS,
    Parameter,
    read_fixed,
    searched_parameters,
)
from taichi_nmm.result import RESULT_DTYPE
from taichi_nmm.terrain import Terrain
from taichi_nmm.world import Worlds

NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9._-]*"
NAME_WORDS = "letters, digits, '.', '_' and '-', first a letter or digit"
MOST_RUNS = 10_000
SUMMARY = (
    "/summary"  # end of a study's name that has no trials and compares other studies
)
MOST_TRIALS = 100_000
ADDED = tuple(
    each.name for each in (*DEVICE, *ASYMMETRIES)
)  # none, unless they are searched
PAID = tuple(
    name for name in RESULT_DTYPE.names or () if name not in ("end_reason", SURVIVED)
)


@dataclass(frozen=True)
class Experiment:
    """All that the studies of an experiment share. It pickles; processes draw bodies and grounds.

    From `runs` on, fields decide no trial: they may grow, or their content is known by
    digest (`as_written`).

    Attributes:
        name: a study is called name/arm/run-NNN.
        seed: of bodies, grounds and samplers: run r draws from (seed, purpose, r).
        searched: names of the low-level gains that are searched beside the 16 gains.
        objective: what a trial costs.
        conditions: of every trial: its length, the simulation, and what bodies, grounds
            and worlds are drawn from.
        fixed: the 16 gains, where none of them is searched; () where they are.
        until_walker: whether a study ends with its first walker, where others have all
            trials.
        runs: their number, each a body and a ground.
        trials: of each arm in each run, at most.
        arms: that are compared, by name.
        stores: folders of scores, by the name that arms know them by.
    """

    name: str
    seed: int
    searched: tuple[str, ...]
    objective: Objective
    conditions: Conditions
    fixed: tuple[float, ...] = ()
    until_walker: bool = False
    runs: int = 50
    trials: int = 100
    arms: tuple[str, ...] = ()
    stores: Mapping[str, Path] = field(default_factory=dict, hash=False)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The searched parameters: the 16 gains, if not fixed, and the low-level ones asked for."""
        low_level = searched_parameters(self.searched)
        return low_level if self.fixed else (*GAINS, *low_level)

    @cached_property
    def fixed_by_name(self) -> dict[str, float]:
        """The gains that are fixed."""
        return dict(zip(GAIN_NAMES, self.fixed, strict=True)) if self.fixed else {}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the searched parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def space(self) -> dict[str, FloatDistribution]:
        """The search space as Optuna has it."""
        return search_space(self.parameters)

    def body(self, run: int) -> Bodies:
        """The one body of a run."""
        return self.conditions.build.draw([stream(self.seed, Purpose.BODY, run)])

    def world(self, run: int) -> Worlds:
        """The one world of a run."""
        return self.conditions.world_ranges.draw(
            [stream(self.seed, Purpose.WORLD, run)]
        )

    def terrain(self, run: int) -> Terrain:
        """The ground of a run."""
        return _terrain(self.conditions, self.seed, run)

    def weight_n(self, run: int) -> float:
        """The weight of the body of a run."""
        return float(self.body(run).mass_kg[0].sum() * GRAVITY_MPS2)

    def on_one_thread(self) -> "Experiment":
        """The same for one of several processes of a machine; no result depends on it."""
        return self.with_settings(threads=1)

    def with_settings(self, **changed: Any) -> "Experiment":
        """The same with some settings of the simulation changed."""
        settings = replace(self.conditions.settings, **changed)
        return replace(self, conditions=replace(self.conditions, settings=settings))

    def require_run(self, run: int) -> None:
        """Refuse a run that the experiment does not have.

        Raises:
            InputError: naming the run.
        """
        if not 0 <= run < self.runs:
            raise InputError(
                "run", run, f"0 to {self.runs - 1}, the runs of {self.name}"
            )


@lru_cache(maxsize=1024)  # 50 kB each
def _terrain(conditions: Conditions, seed: int, run: int) -> Terrain:
    return conditions.ground.draw(stream(seed, Purpose.TERRAIN, run))


def search_space(parameters: Iterable[Parameter]) -> dict[str, FloatDistribution]:
    """Parameters within their bounds, as Optuna has them."""
    return {p.name: FloatDistribution(float(p.low), float(p.high)) for p in parameters}


def study_name(experiment: str, arm: str, run: int) -> str:
    """The name of an arm's study in a run, live or exported."""
    return f"{experiment}/{arm}/run-{run:03d}"


def read_experiment(
    path: str | Path, arch: str | None = None, seed: int | None = None
) -> Experiment:
    """Read and check an experiment's TOML; `arch` and `seed` override the file's.

    Which arms there are, and what their stores hold, is checked by
    `study.experiment.arms`.

    Raises:
        InputError: an unknown key, a wrong type, or a value out of range.
    """
    name = Path(path).stem
    return read_whole(
        read_toml(path), lambda table: experiment_of(table, name, arch, seed)
    )


def experiment_of(
    table: Table, name: str, arch: str | None = None, seed: int | None = None
) -> Experiment:
    """The experiment of a configuration's tables; `name` is used where they have none."""
    objective, stores = table.table("objective"), table.table("stores")
    configured = table.integer("seed")
    experiment = Experiment(
        name=read_name(table, name),
        seed=configured if seed is None else Table({"seed": seed}).integer("seed"),
        fixed=read_fixed(table),
        searched=table.texts("searched", ("theta_ref", *ADDED)),
        objective=read_objective(objective, PAID),
        conditions=read_conditions(table, arch),
        until_walker=table.boolean("until_walker", False),
        runs=table.integer("runs", 50, 1, MOST_RUNS),
        trials=table.integer("trials", 100, 1, MOST_TRIALS),
        arms=table.texts("arms"),
        stores={key: Path(stores.text(key)) for key in stores.unread},
    )
    objective.done()
    table.done()
    if experiment.until_walker and experiment.objective.goals:
        raise InputError(
            "until_walker", "true", "false with two goals: one walker is no front"
        )
    return experiment


def read_name(table: Table, name: str) -> str:
    """The name of an experiment, which becomes a part of studies' and folders' names."""
    name = table.text("name", name)
    if not re.fullmatch(NAME_PATTERN, name):
        raise InputError("name", name, NAME_WORDS)
    return name


def as_written(experiment: Experiment) -> dict[str, Any]:
    """All that decides trials, as the tables of a configuration; `experiment_of` reads it back."""
    # A switch that is off changes no digest of before there was one.
    switches: dict[str, Any] = {"until_walker": True} if experiment.until_walker else {}
    switches |= {"fixed_gains": experiment.fixed_by_name} if experiment.fixed else {}
    return {
        "name": experiment.name,
        "seed": experiment.seed,
        "searched": list(experiment.searched),
        "objective": experiment.objective.document(),
        **experiment.conditions.as_written(),
        **switches,
    }


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
        path, written_ns, feature, experiment.parameters, experiment.objective
    )


@lru_cache(maxsize=16)
def _candidates(
    path: Path,
    _written_ns: int,
    feature: str,
    parameters: tuple[Parameter, ...],
    objective: Objective,
) -> FeatureTable:
    return feature_table(open_store(path), feature, search_space(parameters), objective)


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

    Its rows may lack a device and asymmetries: they are then walkers without.

    Raises:
        InputError: no such store, not a finished store, or other parameters or bounds.
    """
    opened = open_store(store_path(experiment, store))
    searched = tuple(opened.specification["gains"])
    more = [name for name in searched if name not in experiment.names]
    less = [name for name in experiment.names if name not in (*searched, *ADDED)]
    if more or less:
        found = f"{opened.path} {'with' if more else 'without'} {(more or less)[0]}"
        allowed = f"a store of {' and '.join(('the 16 gains', *experiment.searched))}"
        raise InputError(f"stores.{store}", found, allowed)
    opened.require_bounds()
    if opened.specification.get("fixed_gains", {}) != experiment.fixed_by_name:
        raise InputError(
            f"stores.{store}", str(opened.path), "a store of the same fixed gains"
        )
    return opened


def store_digest(path: Path) -> str:
    """SHA-256 of a store's content: of its manifest's hashes, or of the one file that it is."""
    if not path.is_dir():
        return file_hash(path)
    hashes = Manifest.read(path).hashes
    return hashlib.sha256("\n".join(hashes.values()).encode()).hexdigest()
