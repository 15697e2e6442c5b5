"""A comparison on robots of any simulator: worlds that its store has not seen, arms side by side.

A configuration names a simulator, a store of it, and the ranges from which the robots'
worlds are drawn. Every arm has the same trials on the same robots: a trial is one long
run, and a robot's run of the same parameters is the same for all arms. Beside our
sampler stand the ranking alone, and Optuna's samplers, which begin with nothing or with
the ranking's first rows.
"""

import sys
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import optuna
import pyarrow as pa
from numpy.typing import NDArray
from optuna.samplers import (
    BaseSampler,
    CmaEsSampler,
    GPSampler,
    RandomSampler,
    TPESampler,
)
from optuna.storages import BaseStorage
from optuna.trial import FrozenTrial, TrialState

from storage.cautions import cautions
from storage.folder import Folder
from storage.inputs.config import Table, read_toml, read_whole
from storage.inputs.errors import InputError, listed
from storage.pool import Pool
from storage.simulator import Simulator, WorldRule, run_points
from storage.specification import read_simulator, require_parameters, run_lengths_s
from storage.store import open_store
from storage.tables import difference
from study.experiment.block import quiet
from study.experiment.compare import work_through
from study.experiment.experiment import (
    MOST_RUNS,
    MOST_TRIALS,
    read_name,
    store_digest,
    study_name,
)
from study.experiment.features import table_of_worlds
from study.experiment.folder import (
    LIVE_ATTRIBUTE,
    ROBOTS_NAME,
    by_study,
    in_order,
    versions,
)
from study.experiment.objective import Objective, read_objective
from study.experiment.samplers import FIRST_ROWS
from study.sampler.draws import Purpose, generator, name_key, seed_32bit, stream
from study.sampler.policy import one_thread
from study.sampler.sampler import FeatureKernelSampler
from study.sampler.table import FeatureTable

Floats = NDArray[np.float64]

TRIALS_NAME = "trials.parquet"
PACKAGES = ("optuna", "cmaes", "numpy", "scipy")


@dataclass(frozen=True)
class RobotArm:
    """A way of choosing trials.

    Attributes:
        label: in tables and figures.
        sees: what it knows of the store before the first trial, in words.
        new_sampler: makes the sampler of a table, a seed, and the cost of a success.
        first: rows of the ranking that come before its own trials; None: all trials are
            such rows.
    """

    label: str
    sees: str
    new_sampler: Callable[[FeatureTable, int, float], BaseSampler]
    first: int | None = 0


NOTHING = "nothing"
_RANKED = f"the ranking's first {FIRST_ROWS} rows"

ARMS: dict[str, RobotArm] = {
    "worlds": RobotArm(
        "worlds",
        "costs in each world",
        lambda t, s, lasts: FeatureKernelSampler(t, seed=s, success=lasts),
    ),
    "ranking": RobotArm(
        "ranking", "the ranking", lambda t, s, lasts: RandomSampler(seed=s), None
    ),
    "gp-ranking": RobotArm(
        "GPSampler after 3",
        _RANKED,
        lambda t, s, lasts: GPSampler(seed=s, n_startup_trials=FIRST_ROWS),
        FIRST_ROWS,
    ),
    "tpe-ranking": RobotArm(
        "TPE after 3",
        _RANKED,
        lambda t, s, lasts: TPESampler(seed=s, n_startup_trials=FIRST_ROWS),
        FIRST_ROWS,
    ),
    "gp": RobotArm("GPSampler", NOTHING, lambda t, s, lasts: GPSampler(seed=s)),
    "tpe": RobotArm("TPE", NOTHING, lambda t, s, lasts: TPESampler(seed=s)),
    "cmaes": RobotArm("CMA-ES", NOTHING, lambda t, s, lasts: CmaEsSampler(seed=s)),
    "random": RobotArm("random", NOTHING, lambda t, s, lasts: RandomSampler(seed=s)),
}
NEED_TORCH = ("gp-ranking", "gp")


@dataclass(frozen=True)
class RobotExperiment:
    """All that the studies of such a comparison share. It pickles.

    Attributes:
        name: a study is called name/arm/run-NNN.
        seed: of robots, noise and samplers.
        simulator: that runs the trials, with its settings.
        rule: by which the robots' worlds are drawn.
        store: folder of the scores that arms see.
        duration_s: of a trial.
        objective: what a trial costs.
        noise: of a measured cost, relative: standard deviation of its logarithm, 0 to
            1.
        runs: robots.
        trials: of each arm on each robot.
        arms: that are compared, by name.
    """

    name: str
    seed: int
    simulator: Simulator
    rule: WorldRule
    store: Path
    duration_s: float
    objective: Objective
    noise: float
    runs: int
    trials: int
    arms: tuple[str, ...]

    @cached_property
    def document(self) -> dict[str, Any]:
        """All that decides a trial, as JSON values; robots, trials and arms may grow."""
        first = self.rule.draw([stream(self.seed, Purpose.WORLD, 0)])
        return {
            **{
                name: getattr(self, name)
                for name in ("name", "seed", "duration_s", "noise")
            },
            **self.objective.document(),
            "simulator": self.simulator.name,
            "code_version": self.simulator.code_version,
            "versions": versions(*PACKAGES, *self.simulator.packages),
            "settings": self.simulator.document(),
            "store": store_digest(self.store),
            "first_robot": self.rule.document(first),
        }

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return tuple(each.name for each in self.simulator.parameters)

    @property
    def schema(self) -> pa.Schema:
        """Of the finished trials; parameters as the simulator's numbers."""
        words = [("arm", pa.string()), ("run", pa.int32()), ("trial", pa.int32())]
        numbers = ("cost", "measured", "survived", *self.names)
        return pa.schema([*words, *((name, pa.float64()) for name in numbers)])


def is_of_robots(path: Path) -> bool:
    """Whether a configuration names a simulator of its own."""
    return isinstance(read_toml(path).unread.get("simulator"), str)


def refuse_walkers_options(args: Namespace) -> None:
    """Refuse options of commands that are of the walker's experiments alone."""
    for name in ("arch", "store"):
        if (given := getattr(args, name)) is not None:
            raise InputError(
                name, str(given), "none: the configuration names another simulator"
            )


def read_robots(
    path: Path,
    seed: int | None = None,
    arms: str | None = None,
    runs: int | None = None,
    trials: int | None = None,
) -> RobotExperiment:
    """Read and check the configuration of a comparison; the other arguments override the file's.

    Arms are names between commas. Those that need PyTorch are left out where it is
    missing, unless they are asked for by name.

    Raises:
        InputError: an unknown key, a wrong type, a value out of range, or no store.
    """

    def read(table: Table) -> RobotExperiment:
        simulator = read_simulator(table, None)
        simulation, objective = table.table("simulation"), table.table("objective")
        shortest_s, longest_s = run_lengths_s(simulator)
        paid = [name for name in simulator.scores if name != simulator.survived]

        def number(given: int | None, *configured: Any) -> int:
            own = table.integer(*configured)
            return own if given is None else given

        experiment = RobotExperiment(
            name=read_name(table, path.stem),
            seed=number(seed, "seed"),
            simulator=simulator,
            rule=simulator.read_worlds(table),
            store=Path(table.text("store")),
            duration_s=simulation.number("duration_s", low=shortest_s, high=longest_s),
            objective=read_objective(objective, paid, simulator.survived),
            noise=objective.number("noise", 0.0, 0.0, 1.0),
            runs=number(runs, "runs", 50, 1, MOST_RUNS),
            trials=number(trials, "trials", 30, 1, MOST_TRIALS),
            arms=_read_arms(table.texts("arms", tuple(ARMS)), arms),
        )
        for each in (simulation, objective, table):
            each.done()
        return experiment

    experiment = read_whole(read_toml(path), read)
    store = open_store(experiment.store)
    require_parameters(store, experiment.simulator)
    candidates(
        experiment.store, experiment.objective
    )  # a cost that the store lacks is refused
    for line in cautions(store, experiment.simulator.survived):
        print(f"warning: {line}", file=sys.stderr)
    return replace(
        experiment, simulator=experiment.simulator.lasting(experiment.duration_s)
    )


def _read_arms(configured: tuple[str, ...], asked: str | None) -> tuple[str, ...]:
    """The arms of a comparison, each once; all that can run, if none is named."""
    named = asked.split(",") if asked is not None else configured
    for name in named:
        if name not in ARMS:
            raise InputError("arm", name, f"one of {listed(ARMS, name)}")
    chosen = tuple(dict.fromkeys(named or ARMS))
    lacking = [
        name for name in chosen if name in NEED_TORCH and find_spec("torch") is None
    ]
    if not lacking:
        return chosen
    if asked is not None:
        raise InputError(
            "arm", lacking[0], "PyTorch installed (pip install torch), or another"
        )
    print(
        "GPSampler is left out: it needs PyTorch (pip install torch)", file=sys.stderr
    )
    return tuple(name for name in chosen if name not in lacking)


class RobotsFolder(Folder):
    """The folder of such a comparison: a document, and the finished trials."""

    KIND: ClassVar[str] = "a comparison on robots"
    FIRST: ClassVar[str] = ROBOTS_NAME
    FILES: ClassVar[tuple[str, ...]] = (TRIALS_NAME, "report.md")


Unit = tuple[RobotExperiment, int]
"""Of work: a robot, by its run, and the arms of the experiment whose trials it lacks."""


def compare_robots(
    experiment: RobotExperiment,
    out: Path,
    pool: Pool,
    report: Callable[[int, int], None],
) -> pa.Table:
    """Finish a comparison, or go on with it: all its trials, in the order of arm, run, trial.

    A robot's trials are committed together; `report` is called with studies that have
    all trials, and with how many there are to be.

    Raises:
        InputError: a folder of another comparison, or what a sampler or the simulator
            refuses.
    """
    with RobotsFolder.claim(out, experiment.document) as folder:
        pool.agree(out)
        kept = [folder.read_state(TRIALS_NAME, experiment.schema, "trials")]
        known = by_study(kept[0])
        done = {
            (arm, run) for arm, run, trials in known if len(trials) >= experiment.trials
        }
        wanted = {
            (arm, run) for arm in experiment.arms for run in range(experiment.runs)
        }
        there, units = replace(experiment, store=pool.there(experiment.store)), []
        for run in range(experiment.runs):
            if missing := tuple(
                arm for arm in experiment.arms if (arm, run) not in done
            ):
                units.append((replace(there, arms=missing), run))
        report(len(wanted & done), len(wanted))

        def take(unit: Unit, found: pa.Table) -> tuple[()]:
            alone, run = unit
            kept.append(found)
            done.update((arm, run) for arm in alone.arms)
            report(len(wanted & done), len(wanted))
            return ()

        def commit(goes_on: bool) -> None:
            folder.write_state(TRIALS_NAME, _in_order(kept))

        if units:
            work_through(pool, try_robot, units, take, commit)
        return _in_order(kept)


class Runs:
    """Runs of a robot: of the same parameters there is one, whoever proposes them."""

    def __init__(self, experiment: RobotExperiment, run: int) -> None:
        self._experiment = experiment
        self._world = experiment.rule.draw(
            [stream(experiment.seed, Purpose.WORLD, run)]
        )
        errors = generator(experiment.seed, Purpose.COST_NOISE, run)
        self.factors = np.exp(
            experiment.noise * errors.standard_normal(experiment.trials)
        )
        table = candidates(experiment.store, experiment.objective)
        self._space = table.rows.space.as_dict()
        self._known: dict[bytes, np.void] = {}

    def ask(self, studies: Iterable[optuna.Study]) -> tuple[list[optuna.Trial], Floats]:
        """The next trial of each study, and its parameters as the simulator's numbers, [n, p]."""
        asked = [study.ask(self._space) for study in studies]
        names, space = self._experiment.names, self._space
        return asked, np.array(
            [
                [space[name].to_internal_repr(trial.params[name]) for name in names]
                for trial in asked
            ]
        )

    def rows(self, points: Floats) -> NDArray[np.void]:
        """The simulator's rows of points, [n]."""
        known, keys = self._known, [point.tobytes() for point in points]
        new = [
            k for k, key in enumerate(keys) if key not in known and key not in keys[:k]
        ]
        if new:
            simulator, duration_s = (
                self._experiment.simulator,
                self._experiment.duration_s,
            )
            found, _ = run_points(simulator, points[new], self._world, 1, duration_s)
            known |= {
                keys[k]: row.copy() for k, row in zip(new, found[:, 0], strict=True)
            }
        return np.array([known[key] for key in keys])


def try_robot(unit: Unit) -> pa.Table:
    """All trials of a robot's arms: all propose, the robot runs, all are told, and again."""
    experiment, run = unit
    survived = experiment.simulator.survived
    columns: dict[str, list[Any]] = {name: [] for name in experiment.schema.names}
    with _ready(experiment.arms):
        runs = Runs(experiment, run)
        studies = {arm: _study(experiment, arm, run) for arm in experiment.arms}
        for trial in range(experiment.trials):
            asked, points = runs.ask(studies.values())
            rows = runs.rows(points)
            costs = experiment.objective.costs(rows)
            measured = costs * runs.factors[trial]
            for place, (arm, study) in enumerate(studies.items()):
                study.tell(asked[place], float(measured[place]))
                told = (
                    costs[place],
                    measured[place],
                    rows[place][survived],
                    *points[place],
                )
                values = (arm, run, trial, *map(float, told))
                for column, value in zip(columns.values(), values, strict=True):
                    column.append(value)
    return pa.table(columns, experiment.schema)


def live_study(
    experiment: RobotExperiment,
    arm: str,
    run: int,
    storage: BaseStorage,
    report: Callable[[optuna.Study, FrozenTrial], None],
) -> optuna.Study:
    """Run an arm on a robot as a study of a database, or go on with it, until it has its trials.

    `report` is called with each trial. One process at a time runs a study.

    Raises:
        InputError: an arm that keeps a state in its trials, a robot that the experiment
            does not have, or a study of another experiment.
    """
    if arm == "cmaes":
        raise InputError(
            "arm", arm, "another one: its state in a database would be unpickled"
        )
    if not 0 <= run < experiment.runs:
        raise InputError(
            "run", run, f"0 to {experiment.runs - 1}, the robots of {experiment.name}"
        )
    (arm,) = _read_arms((), arm)
    with _ready((arm,)):
        name = study_name(experiment.name, arm, run)
        study, runs = _study(experiment, arm, run, storage, name), Runs(experiment, run)
        known = study.user_attrs.get(LIVE_ATTRIBUTE)
        if known is None:
            study.set_user_attr(LIVE_ATTRIBUTE, experiment.document)
        elif found := difference(experiment.document, known):
            raise InputError(
                found[0], found[1], f"{found[2]!r}, as the study {name} was begun"
            )
        while (
            done := len(study.get_trials(False, (TrialState.COMPLETE,)))
        ) < experiment.trials:
            (asked,), points = runs.ask([study])
            row = runs.rows(points)
            for column in experiment.simulator.scores:
                asked.set_user_attr(column, float(row[column][0]))
            cost = float(experiment.objective.costs(row)[0] * runs.factors[done])
            report(study, study.tell(asked, cost))
        return study


def _study(
    experiment: RobotExperiment,
    arm: str,
    run: int,
    storage: BaseStorage | None = None,
    name: str | None = None,
) -> optuna.Study:
    """The study of an arm on a robot, which begins with the rows that the arm is given."""
    table = candidates(experiment.store, experiment.objective)
    chosen, seed = (
        ARMS[arm],
        seed_32bit(experiment.seed, Purpose.SAMPLER, name_key(arm), run),
    )
    sampler = chosen.new_sampler(table, seed, experiment.objective.fell_cost)
    study = optuna.create_study(
        storage=storage, sampler=sampler, study_name=name, load_if_exists=True
    )
    for left in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(left.number, state=TrialState.FAIL)  # of a process that was killed
        study.enqueue_trial(left.params)
    begun = len(study.get_trials(False, (TrialState.COMPLETE, TrialState.WAITING)))
    first = experiment.trials if chosen.first is None else chosen.first
    mean = table.rows.ensemble(np.ones(1)).columns[:, -1]  # over the worlds
    ranking = table.rows.numbers[np.argsort(mean, kind="stable")]  # the best first, [m]
    for row in ranking[begun:first].tolist():
        study.enqueue_trial(table.rows.as_parameters(row))
    return study


@contextmanager
def _ready(arms: Iterable[str]) -> Iterator[None]:
    """Samplers on one thread, which keep silent."""
    if set(arms) & set(NEED_TORCH):
        import torch

        torch.set_num_threads(1)  # its bits depend on them
    with quiet(), one_thread():
        yield


@lru_cache(maxsize=4)
def candidates(store: Path, objective: Objective) -> FeatureTable:
    """The rows of a store, with what a trial costs in each of its worlds.

    Raises:
        InputError: a store without families, or that has not kept the cost in each
            world.
    """
    return table_of_worlds(open_store(store), [objective.in_worlds])


def _in_order(kept: list[pa.Table]) -> pa.Table:
    """Each study's newest trials; a study that was made longer has replaced its shorter self."""
    tables: dict[tuple[str, int], pa.Table] = {}
    for table in kept:
        tables |= {(arm, run): trials for arm, run, trials in by_study(table)}
    return in_order([kept[0].slice(0, 0), *tables.values()])
