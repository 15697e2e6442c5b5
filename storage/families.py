"""Families of settings: other bodies, grounds and worlds that the surviving points also walk."""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from storage.digests import body_document, terrain_document, world_document
from storage.schema import arrow_schema
from storage.seeds import ROBUST_BODY, ROBUST_TERRAIN, ROBUST_WORLD, seed_sequence
from taichi_nmm.body import Bodies
from taichi_nmm.conditions import read_disturbance
from taichi_nmm.config import Table
from taichi_nmm.errors import InputError
from taichi_nmm.parameters import LOW_LEVEL_NAMES
from taichi_nmm.terrain import Ground, Terrain, read_ground
from taichi_nmm.world import WorldRanges, Worlds, read_world

ROBUST = "robust"  # the family that has a table of its own
NAME_PATTERN = r"[a-z][a-z0-9_]*"
LARGEST_SETTING_COUNT = 64
SHORTEST_DURATION_S, LONGEST_DURATION_S = 0.1, 1000.0


@dataclass(frozen=True, eq=False)
class Family:
    """Settings that every point alive at `min_survival_s` is run on, for `horizon_s`.

    A family that comes after another one is for the few that survive that: more settings, longer.
    Setting k is body k on terrain k in world k; all points share the settings.

    Attributes:
        name: what its columns begin with.
        settings: how many.
        min_survival_s: how long a point must live on the base setting.
        after: another family that a point must have survived; "": none.
        min_survived_fraction: how much of that family's horizon, on average over its settings.
        horizon_s: of every setting.
        seed: of the bodies, and of the terrains where they are drawn.
        disturbance: largest relative disturbance of the bodies.
        ground: that the terrains are drawn from.
        world_ranges: that the worlds are drawn from.
    """

    name: str
    settings: int
    min_survival_s: float
    after: str
    min_survived_fraction: float
    horizon_s: float
    seed: int
    disturbance: float
    ground: Ground
    world_ranges: WorldRanges

    @cached_property
    def bodies(self) -> Bodies:
        """One a setting."""
        return Bodies.disturbed(self._seeds(ROBUST_BODY), self.disturbance)

    @cached_property
    def terrains(self) -> tuple[Terrain, ...]:
        """One a setting."""
        return tuple(self.ground.draw(seed) for seed in self._seeds(ROBUST_TERRAIN))

    @cached_property
    def worlds(self) -> Worlds:
        """One a setting."""
        return self.world_ranges.draw(self._seeds(ROBUST_WORLD))

    @property
    def walk_s(self) -> float:
        """Seconds that a point walks on all settings, if it never falls."""
        return self.settings * self.horizon_s

    @property
    def document(self) -> dict[str, Any]:
        """All of it but the name as JSON values."""
        return {
            "settings": self.settings,
            "min_survival_s": self.min_survival_s,
            **self._stage_document(),
            "horizon_s": self.horizon_s,
            "seed": self.seed,
            "terrain": terrain_document(self.terrains),
            "body": body_document(self.disturbance, self.bodies),
            **world_document(self.world_ranges, self.worlds),
        }

    def _stage_document(self) -> dict[str, Any]:
        """These keys are newer than many stores, so they appear only where they are needed."""
        if not self.after:
            return {}
        return {"after": self.after, "min_survived_fraction": self.min_survived_fraction}

    def _seeds(self, purpose: int) -> list[np.random.SeedSequence]:
        return [seed_sequence(self.seed, purpose, index) for index in range(self.settings)]


def read_families(table: Table, duration_s: float) -> tuple[Family, ...]:
    """The tables [robust] and [families.<name>] of a store: robust first, the others by name.

    Those that come after another one are last.

    Args:
        table: the store's top table.
        duration_s: horizon of the base setting.

    Raises:
        InputError: a name that cannot begin columns, a setting out of range, or a family after one
            that there is not.
    """
    robust = table.table(ROBUST)
    count = robust.integer("settings", 0, 0, LARGEST_SETTING_COUNT)
    families = [_read_family(ROBUST, robust, count, duration_s)] if count else []
    robust.done()
    others = table.table("families")
    for name in sorted(others.unread):
        _check_name(name)
        family = others.table(name)
        count = family.integer("settings", low=1, high=LARGEST_SETTING_COUNT)
        families.append(_read_family(name, family, count, duration_s))
        family.done()
    first = [member.name for member in families if not member.after]
    later = [member for member in families if member.after]
    for member in later:
        if member.after not in first:
            allowed = f"a family that comes after none: {', '.join(first) or 'there is none'}"
            raise InputError(f"families.{member.name}.after", member.after, allowed)
    return (*(member for member in families if not member.after), *later)


def _check_name(name: str) -> None:
    """Refuse a name whose columns could be taken for others."""
    allowed = "lower-case letters, digits and '_', first a letter"
    if not re.fullmatch(NAME_PATTERN, name):
        raise InputError("families", name, allowed)
    if name == ROBUST:
        raise InputError("families", name, "another name; this family is the table [robust]")
    for column in (*arrow_schema().names, *LOW_LEVEL_NAMES):
        if f"{column}_".startswith(f"{name}_"):
            raise InputError("families", name, f"a name that does not begin a column's ({column})")


def _read_family(name: str, table: Table, count: int, duration_s: float) -> Family:
    after = table.text("after", "") if name != ROBUST else ""
    fraction = table.number("min_survived_fraction", low=0.0, high=1.0) if after else 0.0
    return Family(
        name=name,
        settings=count,
        min_survival_s=table.number("min_survival_s", 3.0, 0.0, duration_s),
        after=after,
        min_survived_fraction=fraction,
        horizon_s=table.number("horizon_s", 8.0, SHORTEST_DURATION_S, LONGEST_DURATION_S),
        seed=table.integer("seed", 0),
        disturbance=read_disturbance(table.table("body")),
        ground=read_ground(table.table("terrain")),
        world_ranges=read_world(table.table("world")),
    )
