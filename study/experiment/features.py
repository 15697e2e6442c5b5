"""What a store knows of its rows: columns, and what a trial costs in each world."""

import json
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution

from storage.cautions import cautions
from storage.inputs import checks
from storage.inputs.config import read_toml, read_whole
from storage.inputs.errors import InputError, listed, shortened
from storage.precompute import score_rows
from storage.simulator import WALKER
from storage.specification import Specification, read_specification
from storage.store import Store, evaluated_name, open_store
from study.experiment.objective import Objective
from study.sampler.columns import store_parameters
from study.sampler.table import FeatureTable
from taichi_nmm.parameters import LOW_LEVEL_GAINS
from taichi_nmm.walker_simulator import KEPT

Floats = NDArray[np.float64]


# Features that are no columns: what a trial costs in each world, and minus its mean
# over them.
WORLDS, RANKING = "worlds", "mean_over_worlds"
IN_WORLDS = (WORLDS, RANKING)
# Keys of a specification that tell which rows a store has, not what becomes of them.
OF_ROWS = {"samples", "shard_rows", "repertoire", "columns"}
# What stands in a configuration, or in its simulator, for keys of a specification.
WRITTEN = {"drawn": "seed", "code_version": "code of the simulator"}


def feature_table(
    store: Store,
    feature: str,
    space: Mapping[str, BaseDistribution] | None,
    objective: Objective,
) -> FeatureTable:
    """The rows of a store as candidates; those that no world ran are not proposed.

    `space` has the columns that studies suggest, with distributions; low-level gains
    that the store lacks have their defaults. None: the store's own parameters.

    Raises:
        InputError: the store has no such feature.
    """
    costs = [one.in_worlds for one in objective.each]
    if feature == WORLDS:
        return table_of_worlds(store, costs, space)
    if feature == RANKING:
        rows = table_of_worlds(store, costs).rows
        values = np.full(len(rows), np.nan)
        values[rows.numbers] = -rows.ensemble(np.ones(1)).mean
    elif feature not in store.columns:
        raise InputError("store", str(store.path), f"a store with the column {feature}")
    else:
        values = store.table([feature])[feature].to_numpy().astype(np.float64)
    return _table(store, space, features=values[:, None], feature_names=[feature])


def _table(
    store: Store, space: Mapping[str, BaseDistribution] | None, **known: Any
) -> FeatureTable:
    """A table of the rows of a store, with what is known of them."""
    columns, bounds, own = store_parameters(store.bounds, store.points())
    if space is not None:
        defaults = {
            each.name: np.full(len(store), each.default) for each in LOW_LEVEL_GAINS
        }
        columns, bounds, own = (
            {name: (defaults | columns)[name] for name in space},
            {},
            dict(space),
        )
    with warnings.catch_warnings():
        # Rows are left out on purpose; stores themselves have no gaps.
        warnings.filterwarnings("ignore", ".* are not proposed", UserWarning)
        return FeatureTable.from_arrays(columns, bounds=bounds, space=own, **known)


Cost = Callable[[Mapping[str, Floats], float], Floats]
"""Costs [n, w] of a trial, from what a run gave, by column [n, w], and its horizon in s.

Columns are NaN for the rows that did not run, whose costs do not count, and for runs
that failed.
"""


class Given(Mapping[str, Floats]):
    """What the worlds of a family gave, by column [n, w], and the parameters of the rows, likewise.

    A column is read when it is asked for. NaN: a row that did not run, or a number that
    a failed run did not give.

    Raises:
        InputError: the worlds have not kept the column.
    """

    def __init__(
        self, store: Store, family: str, read: Callable[[str], dict[str, Floats]]
    ) -> None:
        self._store, self._family, self._read = store, family, read
        self._known: dict[str, Floats] = {}

    def __getitem__(self, column: str) -> Floats:
        if column not in self._known:
            self._known[column] = self._read(column)[self._family].copy()
        return self._known[column]

    def __iter__(self) -> Iterator[str]:
        return iter((*self._store.kept(self._family), *self._store.parameter_names))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, column: object) -> bool:
        return column in tuple(self)


def outcomes_of(store: Store, cost: Cost) -> dict[str, Floats]:
    """Costs [n, w] of the rows in the worlds of each family, by name; NaN: no family ran a row.

    A family that ran the best rows of another one alone has the other's mean (of the
    logarithms, if costs are positive) for the rest.
    """
    if not store.families:
        raise InputError("store", str(store.path), "a store with families of worlds")
    known = {family: store.settings_of(family) for family in store.families}
    ran = _ran(store)
    read = cache(partial(_in_families, store, ran))
    found: dict[str, Floats] = {}
    for family in sorted(store.families, key=lambda name: "after" in known[name]):
        settings = known[family]
        given, shape = (
            Given(store, family, read),
            (len(store), int(settings["settings"])),
        )
        costs = _costs(cost(given, float(settings["horizon_s"])), shape)
        missing = ~ran[family]
        costs[missing] = np.nan  # whatever the function makes of rows that did not run
        if "after" in settings:
            before = found[settings["after"]]
            mean = before[missing].mean(axis=1)
            if not (before <= 0).any():  # NaN is neither
                mean = np.exp(np.log(before[missing]).mean(axis=1))
            costs[missing] = mean[:, None]
        found[family] = costs
    return found


def told_of(store: Store, column: str, field: str) -> dict[str, Floats]:
    """A column [n, w] of the rows in the worlds of each family, by name, as `outcomes_of` has it.

    Raises:
        InputError: naming the field: the worlds have not kept it.
    """
    try:
        return outcomes_of(store, lambda given, horizon_s: given[column])
    except InputError as error:
        raise InputError(field, column, error.allowed) from None


def _costs(returned: Any, shape: tuple[int, int]) -> Floats:
    """What a cost function returned, as numbers [n, w] of its own.

    Raises:
        InputError: it returned anything else.
    """
    try:
        costs = np.array(returned, dtype=np.float64)
    except (TypeError, ValueError):
        allowed = "a function that returns numbers [n, w]"
        raise InputError("cost", type(returned).__name__, allowed) from None
    if costs.shape != shape:
        allowed = f"a function that returns {list(shape)}: a row a candidate, a column a world"
        raise InputError("cost.shape", costs.shape, allowed)
    return costs


def _in_families(
    store: Store, ran: Mapping[str, NDArray[np.bool_]], column: str
) -> dict[str, Floats]:
    """A column or a parameter [n, w] by family; NaN where a row did not run."""
    if column in store.parameter_names:
        worlds = {
            family: int(store.settings_of(family)["settings"])
            for family in store.families
        }
        values = store.numpy([column])[column].astype(np.float64)
        one = {
            family: np.where(ran[family], values, np.nan)[:, None] for family in worlds
        }
        return {family: np.tile(each, worlds[family]) for family, each in one.items()}
    for family in store.families:
        if column not in (kept := store.kept(family)):
            names = listed(kept, column) or "nothing, in a store older than 0.3.0"
            path = shortened(str(store.path))
            allowed = f"a parameter, or what the worlds of {path} keep: {names}"
            if _can_be_kept(store, column):
                allowed += (
                    f'; a store of a configuration with kept = ["{column}"] has it'
                )
            raise InputError("cost", column, allowed)
    found = store.all_outcomes(column, store.families)
    return {family: values.astype(np.float64) for family, values in found.items()}


def _can_be_kept(store: Store, column: str) -> bool:
    """Whether it is a number of a run: a column of the base setting, or another of the walker's."""
    if store.simulator == WALKER:
        return column in KEPT
    first = store.columns.index(evaluated_name(store.families[0]))
    is_word = f"{column}: string" in store.specification["columns"]
    return column in store.columns[1:first] and not is_word


def _ran(store: Store) -> dict[str, NDArray[np.bool_]]:
    """Which rows each family ran, [n] by family."""
    names = {family: evaluated_name(family) for family in store.families}
    flags = store.numpy(names.values())
    return {family: flags[name] for family, name in names.items()}


@checks.checked(path=checks.path, cost=checks.optional(checks.function))
def world_table(
    path: str | Path, cost: Cost | None = None, *others: Cost
) -> FeatureTable:
    """The rows of a store as candidates, with what a trial costs in each of its worlds.

    Args:
        path: of a store with families; rows that no family ran are not proposed.
        cost: of a trial, `cost(given, horizon_s)`, [n, w]. `given` has columns by name,
            [n, w]: what each world keeps (`Store.kept`), and the parameters. They are
            NaN for rows that did not run: these are not proposed, whatever the function
            returns for them. None is the walker's smooth cost.
        others: in a study of several goals, the cost by each further one.

    Raises:
        InputError: no store, or one without families or with other bounds; a cost of a
            column that the worlds do not keep, or of another shape.
    """
    store = open_store(path)
    store.require_bounds()
    for line in cautions_of(store):
        # of the caller, beyond the check of arguments
        warnings.warn(line, stacklevel=3)
    return table_of_worlds(store, (cost or Objective().in_worlds, *others))


def cautions_of(store: Store) -> list[str]:
    """A line for each family in which no row came to the end; none of a store before 0.3.0."""
    kept = [name for family in store.families for name in store.kept(family)[:1]]
    return cautions(store, kept[0]) if kept else []


def table_of_worlds(
    store: Store,
    costs: Sequence[Cost],
    space: Mapping[str, BaseDistribution] | None = None,
) -> FeatureTable:
    """`world_table` of an opened store; `space` as for `feature_table`, None: the store's own."""
    goals = [outcomes_of(store, cost) for cost in costs]
    outcomes = goals[0]
    if len(goals) > 1:
        outcomes = {
            name: np.stack([goal[name] for goal in goals], axis=-1) for name in outcomes
        }
    return _table(store, space, outcomes=outcomes)


@checks.checked(
    path=checks.path, config=checks.path, cost=checks.optional(checks.function)
)
def worlds_function(
    path: str | Path, config: str | Path, cost: Cost | None = None, *others: Cost
) -> "Simulated":
    """The simulator of a store, to be asked what other points would cost in its worlds.

    It is the `feature_function` of a sampler over `world_table` of the same store and
    costs: points [m, d] to costs [m, w], or [m, w, k] of k costs. A point that fell in
    the base setting, where no family tried it, has NaN.

    Args:
        path: of the store.
        config: file that the store was computed by. What it names is run; what the
            store names is not.
        cost: as for `world_table`.
        others: likewise.

    Raises:
        InputError: no store, no such configuration, or one of other worlds, parameters
            or versions.
    """
    store = open_store(path)
    specification = read_whole(read_toml(Path(config)), read_specification)
    own = json.loads(json.dumps(specification.document))
    for key in sorted((own.keys() | store.specification.keys()) - OF_ROWS):
        if own.get(key) != store.specification.get(key):
            what = WRITTEN.get(key, key)
            allowed = f"one with {what!r} as the store {shortened(str(path))} has it"
            raise InputError("config", shortened(str(config)), allowed)
    found = Simulated(store, specification, (cost or Objective().in_worlds, *others))
    # What a cost cannot price is refused now, not in the midst of a study.
    found.price(next(iter(store.tables())).slice(0, 1))
    return found


@dataclass(frozen=True, eq=False, repr=False)
class Simulated:
    """The simulator of a store as a function of points.

    Attributes:
        store: whose worlds they are run in.
        specification: that it was computed by.
        costs: of a run in a world, one or more.
    """

    store: Store
    specification: Specification
    costs: tuple[Cost, ...]

    def __repr__(self) -> str:
        return f"worlds_function({str(self.store.path)!r}, ...)"

    def __call__(self, points: Floats) -> Floats:
        """What points [m, d] cost in the worlds, [m, w], or [m, w, k] of k costs.

        Raises:
            InputError: no finite numbers [m, d].
        """
        points, d = checks.numbers("points", points), len(self.store.bounds)
        if points.ndim != 2 or points.shape[1] != d:
            raise InputError("points.shape", points.shape, f"[m, {d}]")
        if not np.isfinite(points).all():
            raise InputError("points", "NaN or infinity", "finite numbers")
        rows, _ = score_rows(self.specification, range(len(points)), _unseen, points)
        return self.price(rows)

    def price(self, rows: pa.Table) -> Floats:
        """The costs of rows, as a store has them."""
        tried = Tried(
            path=self.store.path,
            files=(),
            footers=({"rows": len(rows)},),
            columns=self.store.columns,
            specification=self.store.specification,
            rows=rows,
        )
        each = [np.hstack([*outcomes_of(tried, cost).values()]) for cost in self.costs]
        return each[0] if len(each) == 1 else np.stack(each, axis=-1)


@dataclass(frozen=True)
class Tried(Store):
    """Points that were run as those of a store, and are in no file.

    Attributes:
        rows: these points, as a store has its own.
    """

    rows: pa.Table

    def tables(self, columns: Iterable[str] | None = None) -> Iterator[pa.Table]:
        """See `Store.tables`."""
        return iter([self.rows.select(list(columns or self.columns))])


def _unseen(part: float) -> None:
    """No progress is shown."""


def front_of(table: FeatureTable) -> list[tuple[int, float, float]]:
    """Of a table of two costs, the rows that no other beats in both, in the mean over the worlds.

    Numbers with these two means, from the least of the first cost on.
    """
    rows = table.rows
    assert rows.worlds is not None and rows.worlds.goals == 2
    means = np.einsum("nwk,w->nk", rows.worlds.costs[rows.numbers], rows.worlds.weights)
    order = np.lexsort(means.T[::-1])
    before = np.minimum.accumulate(np.append(np.inf, means[order, 1]))[:-1]
    best = order[means[order, 1] < before]
    return list(zip(rows.numbers[best].tolist(), *means[best].T.tolist(), strict=True))
