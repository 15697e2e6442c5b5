"""Features of a store's rows: its columns, and what is computed of several of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from storage.schema import evaluated_name
from storage.store import Store
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
    """

    families: tuple[str, ...] = ()
    name: str = "survival"
    survivors: bool = False

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

    @property
    def definition(self) -> list[str]:
        """What it is, as JSON values."""
        remarks = ["survivors only"] if self.survivors else []
        return [self.name, *(self.families or ("all families",)), *remarks]

    def values(self, store: Store) -> Floats:
        """The feature of every row, NaN where the row is left out, [n]."""
        families = self.families_of(store)
        ran = _columns(store, [evaluated_name(family) for family in families]).any(axis=0)
        shares = _columns(store, [f"{family}{COLUMN_END}" for family in families])
        values = np.full(len(store), np.nan)
        kept = ran | (not self.survivors)
        values[kept] = self.combined(shares[:, kept])
        return values

    def combined(self, shares: Floats) -> Floats:
        """One number a row out of the shares in each family [k, n], [n]."""
        return np.asarray(shares.mean(axis=0))


@dataclass(frozen=True)
class Placing(Survival):
    """Where a row stands among a store's rows: minus the mean logarithm of its place by survival.

    A family counts by the order that it gives, so one that most rows survive weighs no more than
    one that few do; and for the logarithm the difference between the first and the tenth place is
    that between the hundredth and the thousandth. Places that are shared are averaged.
    """

    name: str = "placing"
    survivors: bool = True

    @property
    def definition(self) -> list[str]:
        """What it is, as JSON values."""
        return [*super().definition, "places"]

    def combined(self, shares: Floats) -> Floats:
        """Minus the mean logarithm of the places in each family [k, n], [n]."""
        places = rankdata(-shares, method="average", axis=1)
        return np.asarray(-np.log(places).mean(axis=0))


Feature = str | Survival
"""A column's name, or what is computed of several."""


def name_of(feature: Feature) -> str:
    """What a feature is called in tables and in `prior`."""
    return feature if isinstance(feature, str) else feature.name


def definition_of(feature: Feature) -> str | list[str]:
    """What a feature is, as JSON values."""
    return feature if isinstance(feature, str) else feature.definition


def check_feature(feature: Feature, store: Store) -> None:
    """Refuse a store that does not have what a feature is made of.

    Raises:
        InputError: naming the store and the column.
    """
    if not isinstance(feature, str):
        feature.families_of(store)
    elif feature not in store.columns:
        raise InputError("store", str(store.path), f"a store with the column {feature}")


def feature_values(feature: Feature, store: Store) -> Floats:
    """The feature of every row, NaN where the row is left out, [n]."""
    if isinstance(feature, str):
        return np.asarray(_columns(store, [feature])[0])
    return feature.values(store)


def _columns(store: Store, names: list[str]) -> Floats:
    """Columns as rows of numbers, [k, n]."""
    table = store.table(names)
    return np.array([table[name].to_numpy() for name in names], dtype=np.float64)
