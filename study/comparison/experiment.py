"""An experiment: the bodies, the grounds and the cost that every arm of a comparison shares."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from optuna.distributions import FloatDistribution

from study.config import COSTS, LARGEST_DURATION_S, read_name
from study.draws import Purpose, stream
from taichi_nmm.body import Bodies
from taichi_nmm.config import Table, read_settings, read_terrain, read_toml
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


def read_experiment(
    path: str | Path, arch: str | None = None, seed: int | None = None
) -> Experiment:
    """Read and check an experiment's TOML; `arch` and `seed` override the file's.

    Which arms there are, and what their stores hold, is checked by `study.comparison.check`.

    Raises:
        InputError: an unknown key, a wrong type, or a value out of range.
    """
    table = read_toml(path)
    simulation, objective, body = (table.table(key) for key in ("simulation", "objective", "body"))
    stores = table.table("stores")
    configured = table.integer("seed")
    experiment = Experiment(
        name=read_name(table),
        seed=configured if seed is None else Table({"seed": seed}).integer("seed"),
        runs=table.integer("runs", 50, 1, MOST_RUNS),
        trials=table.integer("trials", 100, 1, MOST_TRIALS),
        arms=table.texts("arms"),
        searched=table.texts("searched", SEARCHABLE),
        cost=objective.text("cost", "smooth", COSTS),
        duration_s=simulation.number("duration_s", 100.0, 1.0, LARGEST_DURATION_S),
        settings=read_settings(simulation, arch),
        disturbance=body.number("disturbance", 0.0, 0.0, 0.9),
        ground=table.table("terrain").unread,
        stores={key: Path(stores.text(key)) for key in stores.unread},
    )
    for part in (objective, simulation, body, table):
        part.done()
    experiment.terrain(0)  # reads every key of [terrain]
    return experiment
