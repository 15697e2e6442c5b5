"""What a store knows of its rows: columns, and what a trial costs in each world."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution

from storage.store import Store, evaluated_name, open_store, outcome_name
from study.experiment.objective import Objective
from study.sampler.columns import store_parameters
from study.sampler.table import FeatureTable
from taichi_nmm import checks
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import LOW_LEVEL_GAINS

Floats = NDArray[np.float64]


# Features that are no columns: what a trial costs in each world, and minus its mean over them.
WORLDS, RANKING = "worlds", "mean_over_worlds"
IN_WORLDS = (WORLDS, RANKING)


def feature_table(
    store: Store, feature: str, space: Mapping[str, BaseDistribution], objective: Objective
) -> FeatureTable:
    """The rows of a store as candidates; those that no world ran are not proposed.

    `space` has the columns that studies suggest, with distributions; low-level gains that the store
    lacks have their defaults.

    Raises:
        InputError: the store has no such feature.
    """
    costs = [one.in_worlds for one in objective.each]
    if feature == WORLDS:
        return table_of_worlds(store, costs, space)
    if feature == RANKING:
        rows = table_of_worlds(store, costs).rows
        values = np.full(len(rows), np.nan)
        values[rows.numbers] = -rows.ensemble(np.ones(1)).columns[:, -1]
    elif feature not in store.columns:
        raise InputError("store", str(store.path), f"a store with the column {feature}")
    else:
        values = store.table([feature])[feature].to_numpy().astype(np.float64)
    return _table(store, space, features=values[:, None], feature_names=[feature])


def _table(
    store: Store, space: Mapping[str, BaseDistribution] | None, **known: Any
) -> FeatureTable:
    """A table of the rows of a store, with what is known of them."""
    columns, bounds, own = store_parameters(store.specification["gains"], store.gains())
    if space is not None:
        defaults = {each.name: np.full(len(store), each.default) for each in LOW_LEVEL_GAINS}
        columns, bounds, own = {name: (defaults | columns)[name] for name in space}, {}, dict(space)
    with warnings.catch_warnings():
        # Rows are left out on purpose; stores themselves have no gaps.
        warnings.filterwarnings("ignore", ".* are not proposed", UserWarning)
        return FeatureTable.from_arrays(columns, bounds=bounds, space=own, **known)


Cost = Callable[[Mapping[str, Floats], float], Floats]
"""Costs [n, w] of a trial, from what a run gave, by column [n, w], and its horizon in s."""


class Given(dict[str, Floats]):
    """What the worlds of a family gave, by column [n, w], read when it is asked for.

    Raises:
        InputError: the store has not kept the column in each world.
    """

    def __init__(self, family: str, read: Callable[[str], Mapping[str, Any]]) -> None:
        self._family, self._read = family, read

    def __missing__(self, column: str) -> Floats:
        self[column] = self._read(column)[self._family].astype(np.float64)
        return self[column]


def outcomes_of(store: Store, cost: Cost) -> dict[str, Floats]:
    """Costs [n, w] of the rows in the worlds of each family, by name; NaN: no family ran a row.

    A family that ran the best rows of another one alone has the other's mean (of the logarithms,
    if costs are positive) for the rest.
    """
    if not store.families:
        raise InputError("store", str(store.path), "a store with families of worlds")
    known = {family: store.settings_of(family) for family in store.families}
    read = cache(partial(_in_families, store))
    found: dict[str, Floats] = {}
    for family in sorted(store.families, key=lambda name: "after" in known[name]):
        settings = known[family]
        costs = cost(Given(family, read), float(settings["horizon_s"]))
        if "after" in settings:
            missing, before = np.isnan(costs).any(axis=1), found[settings["after"]]
            mean = before[missing].mean(axis=1)
            if np.nanmin(before) > 0:
                mean = np.exp(np.log(before[missing]).mean(axis=1))
            costs[missing] = mean[:, None]
        found[family] = costs
    return found


def _in_families(store: Store, column: str) -> dict[str, NDArray[Any]]:
    """A column [n, w] by family; where no world has kept it, as it was in the base setting."""
    if any(outcome_name(family, column) in store.columns for family in store.families):
        return store.all_outcomes(column, store.families)
    ran = {family: evaluated_name(family) for family in store.families}
    rows = store.numpy([column, *ran.values()])
    return {name: np.where(rows[flag], rows[column], np.nan)[:, None] for name, flag in ran.items()}


@checks.checked(path=checks.path, cost=checks.optional(checks.function))
def world_table(path: str | Path, cost: Cost | None = None, *others: Cost) -> FeatureTable:
    """The rows of a store as candidates, with what a trial costs in each of its worlds.

    Args:
        path: of a store with families; rows that no family ran are not proposed.
        cost: of a trial; None is the walker's smooth cost.
        others: in a study of several goals, the cost by each further one.

    Raises:
        InputError: no store, or one without families or with other bounds, or a column is missing.
    """
    store = open_store(path)
    store.require_bounds()
    return table_of_worlds(store, (cost or Objective().in_worlds, *others))


def table_of_worlds(
    store: Store, costs: Sequence[Cost], space: Mapping[str, BaseDistribution] | None = None
) -> FeatureTable:
    """`world_table` of an opened store; `space` as for `feature_table`, None: the store's own."""
    goals = [outcomes_of(store, cost) for cost in costs]
    outcomes = goals[0]
    if len(goals) > 1:
        outcomes = {name: np.stack([goal[name] for goal in goals], axis=-1) for name in outcomes}
    return _table(store, space, outcomes=outcomes)


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
