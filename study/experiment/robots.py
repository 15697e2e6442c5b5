"""An experiment on robots of any simulator: worlds that its store has not seen.

A configuration names a simulator, a store of it, and the ranges from which the robots'
worlds are drawn. A trial is one long run.
"""

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from storage.cautions import cautions
from storage.inputs.config import Table, read_toml, read_whole
from storage.inputs.errors import InputError
from storage.simulator import Simulator, WorldRule, run_points
from storage.specification import read_simulator, require_parameters, run_lengths_s
from storage.store import Store, open_store
from study.experiment.arms import lacks
from study.experiment.experiment import (
    MOST_RUNS,
    MOST_TRIALS,
    WALKED,
    Experiment,
    Floats,
    Rows,
    Space,
    candidates,
    read_name,
    read_seed,
)
from study.experiment.features import WORLDS
from study.experiment.objective import read_objective
from study.experiment.walker import read_experiment
from study.sampler.draws import Purpose, stream

STORE = "worlds"  # by which arms know the one store
ARMS = (
    "worlds",
    "ranking",
    "hill-ranking",
    "residual",
    "bo-ranking",
    "gp-ranking",
    "tpe-ranking",
    "tpe",
    "random",
)
PACKAGES = ("optuna", "cmaes", "numpy", "scipy")


@dataclass(frozen=True, kw_only=True)
class RobotExperiment(Experiment):
    """Run r has a world of its own, drawn by a rule of the simulator.

    Attributes:
        simulator: that runs the trials, with its settings.
        rule: by which the robots' worlds are drawn.
        duration_s: of a trial.
    """

    simulator: Simulator = field(hash=False)
    rule: WorldRule = field(hash=False)
    duration_s: float

    columns_of_store = None

    @property
    def robot(self) -> Simulator:
        """The simulator."""
        return self.simulator

    @property
    def trial_s(self) -> float:
        """How long a run may last, in s."""
        return self.duration_s

    @cached_property
    def space(self) -> Space:
        """The parameters as the store has them."""
        return candidates(self, STORE, WORLDS).rows.space.as_dict()

    @property
    def packages(self) -> tuple[str, ...]:
        """Packages whose versions decide the trials."""
        return (*PACKAGES, *self.simulator.packages)

    @property
    def kept(self) -> tuple[str, ...]:
        """The simulator's numbers, but for those whose names a table of trials needs itself."""
        return tuple(name for name in self.simulator.scores if name not in TAKEN)

    @property
    def attributes(self) -> tuple[str, ...]:
        """Of a trial in a study database."""
        return (*self.kept, WALKED)

    @property
    def measures(self) -> tuple[str, ...]:
        """How far a run came."""
        return (self.simulator.survived,)

    @property
    def row_type(self) -> np.dtype[np.void]:
        """What the simulator gives."""
        return self.simulator.columns

    def world(self, run: int) -> Any:
        """The one world of a run."""
        return self.rule.draw([stream(self.seed, Purpose.WORLD, run)])

    def sampler_seed(self, arm: str, run: int) -> int:
        """Of 32 bits: as robots' comparisons have had it from the first."""
        return super().sampler_seed(arm, run) & 0xFFFFFFFF

    def on_one_thread(self) -> Self:
        """The same for one of several processes of a machine; no result depends on it."""
        return replace(self, simulator=self.simulator.on_one_thread())

    def document(self) -> dict[str, Any]:
        """All that decides trials; the robot of run 0 as its rule writes it."""
        return {
            "name": self.name,
            "seed": self.seed,
            "objective": self.objective_document,
            "simulation": {"duration_s": self.duration_s},
            "simulator": self.simulator.name,
            "code_version": self.simulator.code_version,
            "settings": self.simulator.document(),
            "first_robot": self.rule.document(self.world(0)),
            "columns": list(self.kept),
            **({"until_walker": True} if self.until_walker else {}),
        }

    def require_store(self, key: str, store: Store) -> None:
        """Refuse a store whose points mean something else to the simulator."""
        require_parameters(store, self.simulator)

    def simulate(self, runs: ArrayLike, points: Floats) -> Rows:
        """Rows of n trials, [n]: the points of a run in its world."""
        rows, of = np.empty(len(points), self.row_type), np.asarray(runs)
        for run in np.unique(of).tolist():
            own = of == run
            found, _ = run_points(
                self.simulator, points[own], self.world(run), 1, self.duration_s
            )
            rows[own] = found[:, 0]
        return rows

    def fell(self, rows: Rows) -> NDArray[np.bool_]:
        """Which runs did not last to the end, bool [n]."""
        return np.asarray(rows[self.simulator.survived] < 1.0)

    def outcome_text(self, shown: Mapping[str, Any]) -> str:
        """How far a run came, in words."""
        return f"lasted {100.0 * shown[self.simulator.survived]:.0f} %"


def is_of_robots(path: Path) -> bool:
    """Whether a configuration names a simulator of its own."""
    return isinstance(read_toml(path).unread.get("simulator"), str)


def read_any(
    path: Path,
    arch: str | None,
    seed: int | None,
    over: Mapping[str, Any] | None = None,
    store: Path | None = None,
) -> Experiment:
    """The experiment of a configuration: on the walker, or on the simulator that it names.

    `store` takes the place of the one that a configuration of a simulator names. Those
    of the walker name several: see `arms.with_store`.

    Raises:
        InputError: as `read_experiment` and `read_robots`.
    """
    if is_of_robots(path):
        if store is not None:
            over = {**(over or {}), "store": str(store)}
        return read_robots(path, arch, seed, over)
    return read_experiment(path, arch, seed, over)


def read_robots(
    path: Path,
    arch: str | None = None,
    seed: int | None = None,
    over: Mapping[str, Any] | None = None,
) -> RobotExperiment:
    """Read and check the configuration of a comparison; see `read_experiment`.

    Raises:
        InputError: an unknown key, a wrong type, a value out of range, or no store.
    """

    def read(table: Table) -> RobotExperiment:
        simulator = read_simulator(table, arch)
        simulation, costs = table.table("simulation"), table.table("objective")
        shortest_s, longest_s = run_lengths_s(simulator)
        known = [name for name in simulator.scores if name != simulator.survived]
        experiment = RobotExperiment(
            name=read_name(table, path.stem),
            seed=read_seed(table, seed),
            simulator=simulator,
            rule=simulator.read_worlds(table),
            stores={STORE: Path(table.text("store"))},
            duration_s=simulation.number("duration_s", low=shortest_s, high=longest_s),
            objective=read_objective(costs, known, simulator.survived),
            noise=costs.number("noise", 0.0, 0.0, 1.0),
            until_walker=table.boolean("until_walker", False),
            runs=table.integer("runs", 50, 1, MOST_RUNS),
            trials=table.integer("trials", 30, 1, MOST_TRIALS),
            arms=table.texts("arms") or able_arms(),
        )
        for each in (simulation, costs, table):
            each.done()
        return experiment

    experiment = read_whole(read_toml(path, over), read)
    store = open_store(experiment.stores[STORE])
    experiment.require_store(STORE, store)
    simulator = experiment.simulator
    for name in (simulator.survived, *experiment.space):
        if name in TAKEN:
            allowed = "a parameter of another name: a table of trials has such a column"
            raise InputError("simulator", name, allowed)
    for line in cautions(store, simulator.survived):
        print(f"warning: {line}", file=sys.stderr)
    return replace(experiment, simulator=simulator.lasting(experiment.duration_s))


def able_arms() -> tuple[str, ...]:
    """Those of `ARMS` that can run here, which are compared where a file names none."""
    return tuple(name for name in ARMS if not lacks(name))


def unable_arms() -> Iterator[str]:
    """The others of `ARMS`, a line each that says why."""
    for name in ARMS:
        if lacking := lacks(name):
            yield f"{name} is left out: {lacking}"


TAKEN = (
    "experiment",
    "arm",
    "run",
    "trial",
    "row",
    "cost",
    "measured",
    "best_cost",
    WALKED,
    "proposal_s",
    "notes",
)
