"""Features of a store's rows: its columns, and what is computed of several of them."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from storage.schema import ORIGIN, SOBOL_ROW, evaluated_name
from storage.store import Store
from study.features.coverage import earliness
from study.features.feature_table import FeatureTable
from taichi_nmm.errors import InputError

Floats = NDArray[np.float64]

COLUMN_END = "_survived_fraction_mean"


@dataclass(frozen=True)
class Survival:
    """The share of the time that a row survives in the settings of a store's families, on average.

    Attributes:
        families: names of families of settings; () are all that the store has.
        name: of the feature.
        survivors: rows that no family ran (they fell on level ground) are left out.
        grid_only: rows that a search bred are left out.
    """

    families: tuple[str, ...] = ()
    name: str = "survival"
    survivors: bool = False
    grid_only: bool = False

    def families_of(self, store: Store) -> tuple[str, ...]:
        """Families that are averaged.

        Raises:
            InputError: the store has no such family, or none at all.
        """
        ends = (name for name in store.columns if name.endswith(COLUMN_END))
        known = tuple(name.removesuffix(COLUMN_END) for name in ends)
        for family in self.families or known or ("robust",):
            if family not in known:
                allowed = f"a store with the column {family}{COLUMN_END}"
                raise InputError("store", str(store.path), allowed)
        return self.families or known


@dataclass(frozen=True)
class Coverage:
    """How early a row comes in the order that covers several grounds (`covering_order`).

    Attributes:
        plainest: survival of the ground that the first row is for; rows that it leaves out are.
        grounds: survival of each ground that is to be covered.
        name: of the feature.
    """

    plainest: Survival
    grounds: tuple[Survival, ...]
    name: str = "coverage"

    @property
    def parts(self) -> tuple[Survival, ...]:
        """What it is made of."""
        return (self.plainest, *self.grounds)


Feature = str | Survival | Coverage
"""A column's name, or what is computed of several."""


def survivals(features: Iterable[Feature]) -> list[Survival]:
    """Every survival that some features are made of."""
    found = []
    for feature in features:
        if isinstance(feature, Survival):
            found.append(feature)
        elif isinstance(feature, Coverage):
            found.extend(feature.parts)
    return found


def name_of(feature: Feature) -> str:
    """What a feature is called in tables and in `prior`."""
    return feature if isinstance(feature, str) else feature.name


def definition_of(feature: Feature) -> Any:
    """What a feature is, as JSON values."""
    if isinstance(feature, str):
        return feature
    if isinstance(feature, Coverage):
        return [feature.name, *map(definition_of, feature.parts)]
    families = feature.families or ("all families",)
    left_out = {"survivors only": feature.survivors, "grid only": feature.grid_only}
    return [feature.name, *families, *(words for words, is_so in left_out.items() if is_so)]


def check_feature(feature: Feature, store: Store) -> None:
    """Refuse a store that does not have what a feature is made of.

    Raises:
        InputError: naming the store and the column.
    """
    if isinstance(feature, Survival):
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
    store: Store, features: Sequence[Feature], parameters: Sequence[str], **ranges: Any
) -> FeatureTable:
    """The rows of a store as candidates; those that a feature leaves out are not proposed.

    Args:
        store: whose rows.
        features: to compare them by.
        parameters: columns that studies suggest.
        **ranges: `bounds` or `space` of `FeatureTable.from_arrays`.
    """
    columns = store.table(parameters)
    with warnings.catch_warnings():
        # Rows are left out on purpose; stores themselves have no gaps.
        warnings.filterwarnings("ignore", ".* are not proposed", UserWarning)
        return FeatureTable.from_arrays(
            {name: columns[name].to_numpy() for name in parameters},
            np.column_stack([feature_values(feature, store) for feature in features]),
            [name_of(feature) for feature in features],
            **ranges,
        )


def _columns(store: Store, names: list[str]) -> Floats:
    """Columns as rows of numbers, [k, n]."""
    table = store.table(names)
    return np.array([table[name].to_numpy() for name in names], dtype=np.float64)
