"""An experiment: the bodies, the grounds and the cost that every arm of a comparison shares."""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from optuna.distributions import FloatDistribution

from study.config import COSTS, LARGEST_DURATION_S, NAME_PATTERN
from study.draws import Purpose, stream
from taichi_nmm.body import Bodies
from taichi_nmm.config import Table, read_settings, read_terrain, read_toml
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import GAINS, LOW_LEVEL_GAINS, Parameter
from taichi_nmm.settings import Settings
from taichi_nmm.terrain import Terrain

MOST_RUNS = 10_000
MOST_TRIALS = 100_000
SEARCHABLE = ("theta_ref",)  # low-level gains that have a column in the results


@dataclass(frozen=True, eq=False)
class Experiment:
    """What is compared on what. It pickles: processes make bodies and grounds where they need them.

    Attributes:
        name: of the experiment; a study is called name/arm/run-NNN.
        seed: of bodies, grounds and samplers: run r draws from (seed, purpose, r).
        runs: how many, each a body and a ground.
        trials: of each arm in each run.
        arms: names of `study.comparison.arms`.
        searched: low-level gains that are searched beside the 16 gains.
        cost: "smooth" or "walking", the paper's two.
        duration_s: of a trial.
        settings: of the simulation.
        disturbance: largest relative disturbance of a body.
        ground: the configuration's table [terrain].
        stores: folders of scores, by the name that arms know them by.
    """

    name: str
    seed: int
    runs: int
    trials: int
    arms: tuple[str, ...]
    searched: tuple[str, ...]
    cost: str
    duration_s: float
    settings: Settings
    disturbance: float
    ground: Mapping[str, Any]
    stores: Mapping[str, Path]

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is searched: the 16 gains, and the low-level ones asked for."""
        low_level = {parameter.name: parameter for parameter in LOW_LEVEL_GAINS}
        return (*GAINS, *(low_level[name] for name in self.searched))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the searched parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def space(self) -> dict[str, FloatDistribution]:
        """The search space as Optuna has it."""
        return {p.name: FloatDistribution(float(p.low), float(p.high)) for p in self.parameters}

    def body(self, run: int) -> Bodies:
        """The one body of a run."""
        return _body(self, run)

    def terrain(self, run: int) -> Terrain:
        """The ground of a run."""
        return _terrain(self, run)


@lru_cache(maxsize=4096)
def _body(experiment: Experiment, run: int) -> Bodies:
    return Bodies.disturbed([stream(experiment.seed, Purpose.BODY, run)], experiment.disturbance)


@lru_cache(maxsize=1024)  # 50 kB each
def _terrain(experiment: Experiment, run: int) -> Terrain:
    table = Table(dict(experiment.ground), "terrain")
    return read_terrain(table, stream(experiment.seed, Purpose.TERRAIN, run))


def read_experiment(path: str | Path, arch: str | None = None) -> Experiment:
    """Read and check an experiment's TOML; `arch` overrides the file's.

    Which arms there are, and what their stores hold, is checked by `study.comparison.check`.

    Raises:
        InputError: an unknown key, a wrong type, or a value out of range.
    """
    read_toml(path)  # refuses what cannot be read
    data = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    arms = _names(data, "arms", None)
    searched = _names(data, "searched", SEARCHABLE)
    ground, stores = _ground(data), _stores(data)
    table = Table(data)
    simulation, objective, body = (table.table(key) for key in ("simulation", "objective", "body"))
    experiment = Experiment(
        name=_name(table),
        seed=table.integer("seed"),
        runs=table.integer("runs", 50, 1, MOST_RUNS),
        trials=table.integer("trials", 100, 1, MOST_TRIALS),
        arms=arms,
        searched=searched,
        cost=objective.text("cost", "smooth", COSTS),
        duration_s=simulation.number("duration_s", 100.0, 1.0, LARGEST_DURATION_S),
        settings=read_settings(simulation, arch),
        disturbance=body.number("disturbance", 0.0, 0.0, 0.9),
        ground=ground,
        stores=stores,
    )
    for part in (objective, simulation, body, table):
        part.done()
    experiment.terrain(0)  # reads every key of [terrain]
    return experiment


def _name(table: Table) -> str:
    name = table.text("name")
    if not re.fullmatch(NAME_PATTERN, name):
        raise InputError("name", name, "letters, digits, '.', '_' and '-', first a letter or digit")
    return name


def _names(data: dict[str, Any], key: str, known: tuple[str, ...] | None) -> tuple[str, ...]:
    """A list of different words; those of `known`, where it is given."""
    words = data.pop(key, [])
    allowed = f"a list of {'names' if known is None else ', '.join(known)}, each once"
    if not isinstance(words, list) or len({str(word) for word in words}) != len(words):
        raise InputError(key, words, allowed)
    for word in words:
        if not isinstance(word, str) or (known is not None and word not in known):
            raise InputError(key, word, allowed)
    return tuple(words)


def _ground(data: dict[str, Any]) -> dict[str, Any]:
    """The table [terrain], as it is written."""
    ground = data.pop("terrain", {})
    if not isinstance(ground, dict):
        raise InputError("terrain", ground, "a table")
    return ground


def _stores(data: dict[str, Any]) -> dict[str, Path]:
    """The table [stores]: a folder by name."""
    stores = data.pop("stores", {})
    if not isinstance(stores, dict):
        raise InputError("stores", stores, "a table of folders by name")
    table = Table(stores, "stores")
    return {key: Path(table.text(key)) for key in stores}
