"""An experiment on the walker: bodies and grounds, its gains, and what a walk is.

This is the one reader of its configurations: one study, many, and a single walk all
take the same file.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from optuna.distributions import BaseDistribution, FloatDistribution

import taichi_nmm
from storage.inputs.config import Table, read_toml, read_whole
from storage.inputs.errors import InputError
from storage.simulator import SURVIVED
from storage.store import Store
from study.experiment.experiment import (
    MOST_RUNS,
    MOST_TRIALS,
    WALKED,
    Experiment,
    Floats,
    Rows,
    Space,
    read_name,
    read_seed,
)
from study.experiment.objective import read_objective
from study.sampler.draws import Purpose, stream
from taichi_nmm.body import GRAVITY_MPS2, Bodies
from taichi_nmm.conditions import Conditions, read_conditions
from taichi_nmm.kernel_cache import COMPILER
from taichi_nmm.parameters import (
    ASYMMETRIES,
    DEVICE,
    GAIN_NAMES,
    LOW_LEVEL_GAINS,
    Parameter,
    read_fixed,
    searched_parameters,
    split_points,
)
from taichi_nmm.result import COMPLETED, END_REASONS, RESULT_DTYPE, SCORE_FIELDS
from taichi_nmm.settings import OWN_ENGINE
from taichi_nmm.terrain import Terrain
from taichi_nmm.walker_simulator import Walker, terrain_document
from taichi_nmm.world import Worlds

# slower, a walker that lasted to the end has stood rather than walked
WALKING_SPEED_MPS = 0.3
MEASURES = ("duration_s", "distance_m", "mean_speed_mps")  # named in words about a walk

# Columns kept of a trial beside its cost: how it ended, and the components of the
# score.
OUTCOMES = (*MEASURES, "cost_of_transport_jpkgpm")
KEPT = (*OUTCOMES, *(name for name, _ in SCORE_FIELDS))
END_REASON = "end_reason"
ATTRIBUTES = (
    *MEASURES,
    END_REASON,
    WALKED,
    "phi_printed",
    "phi_corrected",
    "survived_fraction",
)
# none, unless they are searched
ADDED = tuple(each.name for each in (*DEVICE, *ASYMMETRIES))
PAID = tuple(
    name for name in RESULT_DTYPE.names or () if name not in (END_REASON, SURVIVED)
)
THETA_REF = next(each for each in LOW_LEVEL_GAINS if each.name == "theta_ref")
PACKAGES = (COMPILER, "optuna", "cma", "cmaes", "numpy", "scipy")


@dataclass(frozen=True, kw_only=True)
class WalkerExperiment(Experiment):
    """Run r has a body, a ground and a world of its own, drawn from the conditions.

    Attributes:
        searched: names of the low-level gains that are searched beside the 16 gains.
        conditions: of every trial: its length, the simulation, and what bodies, grounds
            and worlds are drawn from.
        fixed: the 16 gains, where none of them is searched; () where they are.
    """

    searched: tuple[str, ...]
    conditions: Conditions
    fixed: tuple[float, ...] = ()

    @property
    def robot(self) -> Walker:
        """The walker."""
        settings = self.conditions.settings
        return Walker(settings, searched_parameters(self.searched), self.fixed)

    @property
    def trial_s(self) -> float:
        """How long it may walk, in s."""
        return self.conditions.duration_s

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The searched parameters: the 16 gains, if not fixed, and the low-level ones asked for."""
        return self.robot.parameters

    @cached_property
    def fixed_by_name(self) -> dict[str, float]:
        """The gains that are fixed."""
        return dict(zip(GAIN_NAMES, self.fixed, strict=True)) if self.fixed else {}

    @cached_property
    def space(self) -> Space:
        """The search space as Optuna has it."""
        return {
            each.name: FloatDistribution(float(each.low), float(each.high))
            for each in self.parameters
        }

    @property
    def columns_of_store(self) -> tuple[tuple[str, BaseDistribution], ...]:
        """The searched parameters, also where a store lacks them."""
        return tuple(self.space.items())

    @property
    def packages(self) -> tuple[str, ...]:
        """Packages whose versions decide the trials."""
        engine = self.conditions.settings.engine
        return PACKAGES if engine == OWN_ENGINE else (*PACKAGES, engine)

    kept = KEPT
    attributes = ATTRIBUTES
    measures = (*MEASURES, END_REASON)
    row_type = RESULT_DTYPE

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

    def on_one_thread(self) -> Self:
        """The same for one of several processes of a machine; no result depends on it."""
        return self.with_settings(threads=1)

    def with_settings(self, **changed: Any) -> Self:
        """The same with some settings of the simulation changed."""
        settings = replace(self.conditions.settings, **changed)
        return replace(self, conditions=replace(self.conditions, settings=settings))

    def document(self) -> dict[str, Any]:
        """All that decides trials; the ground of run 0 by its digest."""
        tables = as_written(self)
        ground = tables.pop("terrain")
        terrain = terrain_document((self.terrain(0),))
        return {**tables, "terrain": terrain, "ground": ground}

    def require_store(self, key: str, store: Store) -> None:
        """Refuse a store of other parameters, or of other fixed gains.

        Its rows may lack a device and asymmetries: they are then walkers without.
        """
        searched = tuple(store.bounds)
        more = [name for name in searched if name not in self.names]
        less = [name for name in self.names if name not in (*searched, *ADDED)]
        if more or less:
            found = f"{store.path} {'with' if more else 'without'} {(more or less)[0]}"
            allowed = f"a store of {' and '.join(('the 16 gains', *self.searched))}"
            raise InputError(f"stores.{key}", found, allowed)
        if store.specification.get("fixed_gains", {}) != self.fixed_by_name:
            allowed = "a store of the same fixed gains"
            raise InputError(f"stores.{key}", str(store.path), allowed)

    def simulate(self, runs: ArrayLike, points: Floats) -> Rows:
        """Rows of n trials, [n], walked as one batch; as `finite` gives them."""
        numbers, index = np.unique(
            np.asarray(runs, dtype=np.int64), return_inverse=True
        )
        different = numbers.tolist()
        searched = searched_parameters(self.searched)
        gains, low_level = split_points(points, searched, self.fixed)
        bodies = Bodies.stacked(self.body(run) for run in different)
        worlds = Worlds.stacked(self.world(run) for run in different)
        walks = taichi_nmm.simulate(
            gains,
            duration_s=self.trial_s,
            bodies=bodies.take(index),
            worlds=worlds.take(index),
            terrains=[self.terrain(run) for run in different],
            terrain_index=index.astype(np.int32),
            low_level_gains=low_level if self.searched else None,
            settings=self.conditions.settings,
        )
        return finite(walks.rows)

    def fell(self, rows: Rows) -> Any:
        """Which walks did not last to the end (fallen or diverged), bool [n]."""
        return fell(rows)

    def walked(self, rows: Rows) -> Any:
        """Which walks lasted to the end and got somewhere, bool [n]."""
        return walked(rows)

    def words(self, rows: Rows) -> dict[str, Any]:
        """How each walk ended; and gains that are not searched, for tables of the 16 gains."""
        fixed = {THETA_REF.name: THETA_REF.default, **self.fixed_by_name}
        return {
            **{name: np.full(len(rows), gain) for name, gain in fixed.items()},
            END_REASON: np.array(END_REASONS)[rows[END_REASON]],
        }

    def rows_of(self, table: Any) -> Rows:
        """As of any experiment."""
        rows = super().rows_of(table)
        rows[END_REASON] = [
            END_REASONS.index(reason) for reason in table[END_REASON].to_pylist()
        ]
        return rows

    def outcome_text(self, shown: Mapping[str, Any]) -> str:
        """How a walk ended, in words."""
        return outcome_text(shown)


@lru_cache(maxsize=1024)  # 50 kB each
def _terrain(conditions: Conditions, seed: int, run: int) -> Terrain:
    return conditions.ground.draw(stream(seed, Purpose.TERRAIN, run))


def walked(rows: Rows) -> Any:
    """Which result rows lasted to the end and got somewhere, bool [n]."""
    return ~fell(rows) & (rows["mean_speed_mps"] >= WALKING_SPEED_MPS)


def fell(rows: Rows) -> Any:
    """Which result rows did not last to the end (fallen or diverged), bool [n]."""
    return rows[END_REASON] != COMPLETED


def finite(rows: Rows) -> Rows:
    """The rows with zero where a walker that diverged left no number, [n].

    Samplers never see a trial of no value, and a table of results has no gaps.
    """
    clean = rows.copy()
    for name in rows.dtype.names or ():
        if rows.dtype[name].kind == "f":
            clean[name] = np.nan_to_num(rows[name], nan=0.0, posinf=0.0, neginf=0.0)
    return clean


def row_text(row: np.void) -> str:
    """How the walk of a result row ended, in words."""
    shown = {name: row[name] for name in MEASURES}
    return outcome_text(shown | {END_REASON: END_REASONS[row[END_REASON]]})


def outcome_text(shown: Mapping[str, Any]) -> str:
    """How a walk ended, in words: from end_reason, duration_s, distance_m and mean_speed_mps."""
    reason = shown[END_REASON]
    how = "walked" if reason == END_REASONS[COMPLETED] else f"{reason} after"
    reached = f"{shown['duration_s']:.1f} s, {shown['distance_m']:.1f} m"
    return f"{how} {reached} at {shown['mean_speed_mps']:.2f} m/s"


def read_experiment(
    path: str | Path,
    arch: str | None = None,
    seed: int | None = None,
    over: Mapping[str, Any] | None = None,
) -> WalkerExperiment:
    """Read and check an experiment's TOML; `arch`, `seed` and the tables `over` override it.

    Which arms there are, and what their stores hold, is checked by
    `study.experiment.arms`.

    Raises:
        InputError: an unknown key, a wrong type, or a value out of range.
    """
    name = Path(path).stem
    return read_whole(
        read_toml(path, over), lambda table: experiment_of(table, name, arch, seed)
    )


def experiment_of(
    table: Table, name: str, arch: str | None = None, seed: int | None = None
) -> WalkerExperiment:
    """The experiment of a configuration's tables; `name` is used where they have none."""
    paid, stores = table.table("objective"), table.table("stores")
    experiment = WalkerExperiment(
        name=read_name(table, name),
        seed=read_seed(table, seed),
        fixed=read_fixed(table),
        searched=table.texts("searched", ("theta_ref", *ADDED)),
        objective=read_objective(paid, PAID),
        noise=paid.number("noise", 0.0, 0.0, 1.0),
        conditions=read_conditions(table, arch),
        until_walker=table.boolean("until_walker", False),
        runs=table.integer("runs", 50, 1, MOST_RUNS),
        trials=table.integer("trials", 100, 1, MOST_TRIALS),
        arms=table.texts("arms"),
        stores={key: Path(stores.text(key)) for key in stores.unread},
    )
    paid.done()
    table.done()
    if experiment.noise and experiment.objective.goals:
        raise InputError("objective.noise", experiment.noise, "none with two goals")
    if experiment.until_walker and experiment.objective.goals:
        raise InputError(
            "until_walker", "true", "false with two goals: one walker is no front"
        )
    return experiment


def as_written(experiment: WalkerExperiment) -> dict[str, Any]:
    """All that decides trials, as the tables of a configuration; `experiment_of` reads it back."""
    # A switch that is off changes no digest of before there was one.
    switches: dict[str, Any] = {"until_walker": True} if experiment.until_walker else {}
    switches |= {"fixed_gains": experiment.fixed_by_name} if experiment.fixed else {}
    return {
        "name": experiment.name,
        "seed": experiment.seed,
        "searched": list(experiment.searched),
        "objective": experiment.objective_document,
        **experiment.conditions.as_written(),
        **switches,
    }
