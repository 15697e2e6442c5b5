"""The survival of a store's rows as features: columns, their means, and a covering order.

Gaits are alike that survive the same grounds. Their survival was computed beforehand, on several
families of disturbed bodies and uneven grounds (`store-diverse`); docs/comparison.md explains the
choices.
"""

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from optuna.distributions import BaseDistribution

from storage.simulator import WALKER
from storage.store import ORIGIN, SOBOL_ROW, Store, evaluated_name, open_store
from study.sampler.columns import store_parameters
from study.sampler.sampler import FeatureKernelSampler
from study.sampler.table import FeatureTable
from taichi_nmm import checks
from taichi_nmm.errors import InputError
from taichi_nmm.result import RESULT_DTYPE, smooth_cost

Floats = NDArray[np.float64]

COLUMN_END = "_survived_fraction_mean"
RELIABILITY = 0.7  # chance that the best of a ground walks on its like elsewhere
SHARPNESS = 3.0  # a candidate that survives half as long as the best has an eighth of its chance
TRIAL_S = 100.0  # of the walker's experiments
COVERING = 128  # candidates that are placed by the rule; the others follow by their mean chance


@dataclass(frozen=True)
class Survival:
    """The mean share of the time that a row survives in the settings of a store's families."""

    families: tuple[str, ...] = ()  # of settings; () are all that the store has
    name: str = "survival"  # of the feature
    survivors: bool = False  # rows that no family ran (they fell on level ground) are left out
    grid_only: bool = False  # rows that a search bred are left out

    def families_of(self, store: Store) -> tuple[str, ...]:
        """The families that are averaged, or an InputError: the store lacks one, or has none."""
        ends = (name for name in store.columns if name.endswith(COLUMN_END))
        known = tuple(name.removesuffix(COLUMN_END) for name in ends)
        for family in self.families or known or ("robust",):
            if family not in known:
                allowed = f"a store with the column {family}{COLUMN_END}"
                raise InputError("store", str(store.path), allowed)
        return self.families or known


@dataclass(frozen=True)
class Coverage:
    """How early a row comes in the order that covers several grounds (`covering_order`)."""

    plainest: Survival  # of the ground that the first row is for; rows that it leaves out are
    grounds: tuple[Survival, ...]  # survival of each ground that is to be covered
    name: str = "coverage"

    @property
    def parts(self) -> tuple[Survival, ...]:
        """All the survivals."""
        return (self.plainest, *self.grounds)


@dataclass(frozen=True)
class InWorlds:
    """What a trial costs in each world of a store, or minus its mean over the worlds."""

    mean: bool = False

    @property
    def name(self) -> str:
        """In tables."""
        return "mean_over_worlds" if self.mean else "worlds"


Feature = str | Survival | Coverage | InWorlds
"""A column's name, or what is computed of several."""


def survivals(features: Iterable[Feature]) -> list[Survival]:
    """Every survival that some features are made of."""
    found: list[Survival] = []
    for feature in features:
        if isinstance(feature, Coverage):
            found.extend(feature.parts)
        elif isinstance(feature, Survival):
            found.append(feature)
        elif isinstance(feature, InWorlds):
            found.append(Survival())
    return found


def name_of(feature: Feature) -> str:
    """The name of a feature in tables and in `prior`."""
    return feature if isinstance(feature, str) else feature.name


def definition_of(feature: Feature) -> Any:
    """The definition of a feature as JSON values."""
    if isinstance(feature, str):
        return feature
    if isinstance(feature, Coverage):
        return [feature.name, *map(definition_of, feature.parts)]
    if isinstance(feature, InWorlds):
        return [feature.name, f"smooth cost of {TRIAL_S:g} s"]
    families = feature.families or ("all families",)
    left_out = {"survivors only": feature.survivors, "grid only": feature.grid_only}
    return [feature.name, *families, *(words for words, is_so in left_out.items() if is_so)]


def check_feature(feature: Feature, store: Store) -> None:
    """Refuse a store without a column of the feature by an InputError that names both."""
    if isinstance(feature, InWorlds):
        outcomes_of(store, walking_costs)
    elif isinstance(feature, Survival):
        feature.families_of(store)
    elif isinstance(feature, Coverage):
        for part in feature.parts:
            check_feature(part, store)
    elif feature not in store.columns:
        raise InputError("store", str(store.path), f"a store with the column {feature}")


def feature_values(feature: Feature, store: Store) -> Floats:
    """The feature of every row, NaN where the row is left out, [n]."""
    if isinstance(feature, str):
        return np.asarray(_columns(store, [feature])[0])
    if isinstance(feature, InWorlds):
        rows = table_of_worlds(store).rows
        values = np.full(len(rows), np.nan)
        values[rows.numbers] = -rows.ensemble(maximise=False).mean
        return values
    if isinstance(feature, Coverage):
        plainest, *grounds = (feature_values(part, store) for part in feature.parts)
        return earliness(plainest, np.column_stack(grounds))
    families = feature.families_of(store)
    values = _columns(store, [f"{family}{COLUMN_END}" for family in families]).mean(axis=0)
    if feature.survivors:
        ran = _columns(store, [evaluated_name(family) for family in families]).any(axis=0)
        values[~ran] = np.nan
    if feature.grid_only and ORIGIN in store.columns:
        values[store.table([ORIGIN])[ORIGIN].to_numpy() != SOBOL_ROW] = np.nan
    return np.asarray(values)


def feature_table(
    store: Store,
    features: Sequence[Feature],
    space: Mapping[str, BaseDistribution] | None = None,
) -> FeatureTable:
    """The rows of a store as candidates; those that a feature leaves out are not proposed.

    `space` has the columns that studies suggest, with distributions; None: the store's own.
    """
    if InWorlds() in features:
        return table_of_worlds(store, space=space)
    columns, bounds, own = store_parameters(store.specification["gains"], store.gains())
    if space is not None:
        columns, bounds, own = {name: columns[name] for name in space}, {}, dict(space)
    with warnings.catch_warnings():
        # Rows are left out on purpose; stores themselves have no gaps.
        warnings.filterwarnings("ignore", ".* are not proposed", UserWarning)
        return FeatureTable.from_arrays(
            columns,
            np.column_stack([feature_values(feature, store) for feature in features]),
            [name_of(feature) for feature in features],
            bounds=bounds,
            space=own,
        )


def _columns(store: Store, names: list[str]) -> Floats:
    """Columns as rows of numbers, [k, n]."""
    table = store.table(names)
    return np.array([table[name].to_numpy() for name in names], dtype=np.float64)


def chances(survival: Floats) -> Floats:
    """Chances to walk on similar grounds, [n, f], from survival of n candidates on f grounds."""
    best = survival.max(axis=0, initial=np.finfo(np.float64).tiny)
    return np.asarray(RELIABILITY * (survival / best) ** SHARPNESS)


def covering_order(plainest: Floats, survival: Floats) -> NDArray[np.int64]:
    """The order in which to try candidates, [n]: the first few cover several grounds.

    The first one survives the plainest ground best. The ground of a trial is like one of several,
    and it is not known which: each next candidate is the one that most raises the chance that at
    least one of those so far walks, the mean over the grounds of 1 - prod(1 - chance). That is the
    greedy rule, whose k candidates have at least 63 % of the chance of the best k (Nemhauser,
    Wolsey, Fisher 1978). It is Bayes's rule after each fall, too: grounds on which the fallen ones
    hardly ever fall lose weight.

    How steep a family's ramps are is its maker's choice, so that a candidate's chance on a ground
    is relative to the best one's there.

    Args:
        plainest: survival of the plainest ground, from 0 to 1, NaN: not to be tried, [n].
        survival: of each ground, from 0 to 1, [n, f].
    """
    free = ~np.isnan(plainest)
    chance = chances(survival)
    merit = np.where(free, chance.mean(axis=1), -1.0)
    order = np.argsort(-merit, kind="stable")
    best = int(np.argmax(np.where(free, plainest, -1.0)))
    unwalked = np.ones(survival.shape[1])
    first = []
    for _ in range(min(COVERING, int(free.sum()))):
        first.append(best)
        free[best] = False
        unwalked = unwalked * (1.0 - chance[best])
        best = int(np.argmax(np.where(free, chance @ unwalked, -1.0)))
    placed = np.array(first, dtype=np.int64)
    return np.concatenate([placed, order[~np.isin(order, placed)]])


def earliness(plainest: Floats, survival: Floats) -> Floats:
    """n less the place in `covering_order`, NaN where a candidate is not to be tried, [n]."""
    order = covering_order(plainest, survival)
    values = np.empty(len(order))
    values[order] = np.arange(len(order), 0, -1)
    return np.where(np.isnan(plainest), np.nan, values)


# Without stairs, which a gait survives that hardly moves.
FAMILIES = ("rough", "blocks", "up", "down")
SPEED = "mean_speed_mps"  # on the base setting
MEAN = Survival().name  # the feature that is also the prior
OPTIONS: dict[str, Any] = {"prior": MEAN}
COVERED_OPTIONS: dict[str, Any] = {"prior": Coverage.name}
# Of a store of worlds: the ground that the first row is for, on contacts soft and stiff, and those
# that the next rows cover. Each has a family of longer walks.
PLAINEST = ("rough", "rough_stiff")
GROUNDS = ("blocks", "up", "down")
LONGER = "_long"


def survival_features(families: tuple[str, ...] = FAMILIES) -> tuple[Feature, ...]:
    """Mean survival of these families, survival of each, and the speed on the base setting.

    Rows that fell on the base setting have no survival, and are not proposed.
    """
    each = (Survival((family,), family, survivors=True) for family in families)
    return (Survival(families, survivors=True), *each, SPEED)


def covered_features(
    plainest: tuple[str, ...] = PLAINEST,
    grounds: tuple[str, ...] = GROUNDS,
    grid_only: bool = False,
) -> tuple[Feature, ...]:
    """Place in the order that covers these grounds, survival of each of them all, and the speed.

    The survival of a ground is that of its two families on average: few walks, and many long ones.
    To cover it counts the long ones alone. With `grid_only` rows that a search bred are left out.
    """

    def survival(grounds: tuple[str, ...], name: str) -> Survival:
        families = tuple(family for ground in grounds for family in (ground, f"{ground}{LONGER}"))
        return Survival(families, name, survivors=True, grid_only=grid_only)

    longer = tuple(Survival((f"{ground}{LONGER}",)) for ground in grounds)
    each = (survival((ground,), ground) for ground in dict.fromkeys((*plainest, *grounds)))
    return (Coverage(survival(plainest, "plainest"), longer), *each, SPEED)


@checks.checked(
    path=checks.path,
    plainest=checks.each(checks.text, least=1),
    grounds=checks.each(checks.text, least=1),
)
def covered_table(
    path: str | Path, plainest: tuple[str, ...] = PLAINEST, grounds: tuple[str, ...] = GROUNDS
) -> FeatureTable:
    """The rows of a store of worlds, with features of how they survive these grounds.

    Args:
        path: of a store with a family of each ground, and one of longer walks after it; rows that
            fell on its base setting are not proposed.
        plainest: families that the first row is to survive, on average.
        grounds: families that the rows after it cover.

    Raises:
        InputError: no store, or one without these families or with other bounds.
    """
    return _table(path, covered_features(plainest, grounds))


@checks.checked(path=checks.path, families=checks.each(checks.text))
def survival_table(path: str | Path, families: tuple[str, ...] = FAMILIES) -> FeatureTable:
    """The rows of a store, with the features that `SurvivalSampler` compares.

    Args:
        path: of a store with these families; rows that fell on its base setting are not proposed.
        families: names of families of settings.

    Raises:
        InputError: no store, or one without these families or with other bounds.
    """
    return _table(path, survival_features(families))


def _table(path: str | Path, features: tuple[Feature, ...]) -> FeatureTable:
    store = open_store(path)
    store.require_bounds()
    if store.simulator != WALKER and SPEED not in store.columns:
        features = tuple(feature for feature in features if feature != SPEED)
    for feature in features:
        check_feature(feature, store)
    return feature_table(store, features)


Cost = Callable[[Mapping[str, Floats], float], Floats]
"""Costs [n, w] of a trial, from what a run gave, by column [n, w], and its horizon in s."""


class Given(dict[str, Floats]):
    """What the worlds of a family gave, by column [n, w], read when it is asked for.

    Raises:
        InputError: the store has not kept the column in each world.
    """

    def __init__(self, store: Store, family: str) -> None:
        self._store, self._family = store, family

    def __missing__(self, column: str) -> Floats:
        self[column] = self._store.outcomes(self._family, column).astype(np.float64)
        return self[column]


def walking_costs(given: Mapping[str, Floats], horizon_s: float) -> Floats:
    """The walker's smooth cost of a trial of 100 s: who lasts to the horizon is taken to go on."""
    lasted, speed = given["survived_fraction"], given["mean_speed_mps"]
    seconds = np.where(lasted >= 1.0, TRIAL_S, lasted * horizon_s)
    rows = np.zeros(lasted.shape, RESULT_DTYPE)
    rows["duration_s"], rows["distance_m"] = seconds, speed * seconds
    rows["mean_speed_mps"] = speed
    return smooth_cost(rows)


def outcomes_of(store: Store, cost: Cost) -> dict[str, Floats]:
    """Costs [n, w] of the rows in the worlds of each family, by name; NaN: no family ran a row.

    A family that ran the best rows of another one alone has the other's mean (of the logarithms,
    if costs are positive) for the rest.
    """
    if not store.families:
        raise InputError("store", str(store.path), "a store with families of worlds")
    known = store.specification.get("families", {})
    found: dict[str, Floats] = {}
    for family in sorted(store.families, key=lambda name: "after" in known.get(name, {})):
        settings = store.specification["robust"] if family == "robust" else known[family]
        costs = cost(Given(store, family), float(settings["horizon_s"]))
        if "after" in settings:
            missing, before = np.isnan(costs).any(axis=1), found[settings["after"]]
            mean = before[missing].mean(axis=1)
            if np.nanmin(before) > 0:
                mean = np.exp(np.log(before[missing]).mean(axis=1))
            costs[missing] = mean[:, None]
        found[family] = costs
    return found


@checks.checked(path=checks.path, cost=checks.function)
def world_table(path: str | Path, cost: Cost = walking_costs) -> FeatureTable:
    """The rows of a store as candidates, with what a trial costs in each of its worlds.

    Args:
        path: of a store with families; rows that no family ran are not proposed.
        cost: of a trial; by default the walker's smooth cost.

    Raises:
        InputError: no store, or one without families or with other bounds, or a column is missing.
    """
    store = open_store(path)
    store.require_bounds()
    return table_of_worlds(store, cost)


def table_of_worlds(
    store: Store, cost: Cost = walking_costs, space: Mapping[str, BaseDistribution] | None = None
) -> FeatureTable:
    """`world_table` of an opened store; `space` as for `feature_table`."""
    columns, bounds, own = store_parameters(store.specification["gains"], store.gains())
    if space is not None:
        columns, bounds, own = {name: columns[name] for name in space}, {}, dict(space)
    outcomes = outcomes_of(store, cost)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* are not proposed", UserWarning)  # on purpose
        return FeatureTable.from_arrays(columns, outcomes=outcomes, bounds=bounds, space=own)


class SurvivalSampler(FeatureKernelSampler):
    """Survival of each family as features; their mean, or their coverage, ranks the first trials.

    Args:
        table: of `covered_table` or `survival_table`, or any with a feature "coverage" or
            "survival" whose high values are good.
        seed: of all draws; None takes one from the machine's entropy.
        **options: of `FeatureKernelSampler`, for what is to differ.
    """

    @checks.checked(table=checks.instance(FeatureTable))
    def __init__(self, table: FeatureTable, *, seed: int | None = None, **options: Any) -> None:
        covered = COVERED_OPTIONS["prior"] in table.rows.feature_names
        super().__init__(table, seed=seed, **(COVERED_OPTIONS if covered else OPTIONS) | options)
