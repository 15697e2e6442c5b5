"""The sampler that did best in the comparisons: gaits are alike that survive the same grounds.

What a gait survives was computed beforehand, on several families of disturbed bodies and uneven
grounds (`store-diverse`); docs/comparison.md says how all of this was chosen.
"""

from pathlib import Path
from typing import Any

from storage.store import open_store
from study.features.feature_table import FeatureTable
from study.features.store_features import Coverage, Feature, Survival, check_feature, feature_table
from study.sampler.candidate_table import CandidateTable
from study.sampler.feature_sampler import FeatureKernelSampler
from taichi_nmm import checks

# Of the families that a store may have: what nearly stands survives stairs, which says little.
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
    path: str | Path,
    plainest: tuple[str, ...] = PLAINEST,
    grounds: tuple[str, ...] = GROUNDS,
) -> FeatureTable:
    """The rows of a store of worlds with what tells them apart on these grounds.

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
    """The rows of a store with what `SurvivalSampler` compares them by.

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
    for feature in features:
        check_feature(feature, store)
    ranges = store.specification["gains"]
    bounds = {name: (ends["low"], ends["high"]) for name, ends in ranges.items()}
    return feature_table(store, features, store.gain_names, bounds=bounds)


class SurvivalSampler(FeatureKernelSampler):
    """Survival of each family as features; their mean, or what covers them, ranks the first trials.

    Args:
        table: of `covered_table` or `survival_table`, or any with a feature "coverage" or
            "survival" whose high values are good.
        seed: of all draws; None takes one from the machine's entropy.
        **options: of `FeatureKernelSampler`, for what is to differ.
    """

    @checks.checked(table=checks.instance(CandidateTable))
    def __init__(self, table: FeatureTable, *, seed: int | None = None, **options: Any) -> None:
        """As `FeatureKernelSampler`, with other defaults."""
        covered = COVERED_OPTIONS["prior"] in table.rows.feature_names
        super().__init__(table, seed=seed, **(COVERED_OPTIONS if covered else OPTIONS) | options)
