"""The second stage of a store: candidates that the grid does not have, found by a search.

The table [repertoire] of a store. For each family of settings the search evolves gaits that survive
it (`storage.evolution`), spread over how they walk; what it chose becomes rows after the grid's.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from typing import Any
from zlib import crc32

import numpy as np

from storage.evolution import GENERATION
from storage.families import LARGEST_SETTING_COUNT, Family
from storage.schema import ORIGIN
from storage.seeds import EVOLUTION, TRIAL_SETTINGS, seed_sequence
from taichi_nmm.config import Table
from taichi_nmm.errors import InputError

LIBRARY = "ribs"  # of quality-diversity optimisation
SETTINGS = 8  # of a family, that a candidate is tried on: fewer find gaits of these bodies alone
STARTS = 2 * GENERATION  # points of the grid that a search may begin with
LARGEST_NUMBER = 2**30  # of walks, or of candidates


@dataclass(frozen=True, eq=False)
class Repertoire:
    """A search around what survives in the grid, and how much of what it finds the store keeps.

    Attributes:
        evaluations: walks of the whole search: so many candidates times `settings`.
        candidates: rows that the store gets.
        seed: of the search, and of the settings that candidates are tried on.
        settings: that a candidate is tried on, of the one family that it is bred for.
        families: that candidates are bred for; none of them comes after another.
    """

    evaluations: int
    candidates: int
    seed: int
    settings: int
    families: tuple[Family, ...]

    @cached_property
    def trials(self) -> tuple[Family, ...]:
        """The families with settings of the search's own, [f].

        A candidate was chosen for what it did on these; on the family's own it is measured.
        """
        return tuple(
            replace(family, settings=self.settings, seed=self._seed(family.name))
            for family in self.families
        )

    @property
    def generations(self) -> int:
        """Of all families, after those that are the grid's."""
        points = self.evaluations // self.settings
        return (points - STARTS * len(self.families)) // GENERATION

    @property
    def walks(self) -> int:
        """Of the whole search; fewer than were asked for: generations are whole."""
        return (STARTS * len(self.families) + self.generations * GENERATION) * self.settings

    def stream(self, family: str) -> np.random.SeedSequence:
        """Of the search for a family."""
        return seed_sequence(self.seed, EVOLUTION, crc32(family.encode()))

    @property
    def document(self) -> dict[str, Any]:
        """All of it as JSON values."""
        return {
            "evaluations": self.evaluations,
            "candidates": self.candidates,
            "seed": self.seed,
            "settings": self.settings,
            "families": {family.name: family.document for family in self.trials},
            "library": f"{LIBRARY} {library_version()}",  # another one evolves others
        }

    def _seed(self, name: str) -> int:
        """The seed of a family's trials: another family of the store changes it not."""
        sequence = seed_sequence(self.seed, TRIAL_SETTINGS, crc32(name.encode()))
        return int(sequence.generate_state(1, np.uint64)[0])


def library_version() -> str:
    """The version of the library that searches.

    Raises:
        InputError: it is not installed.
    """
    try:
        return version(LIBRARY)
    except PackageNotFoundError:
        allowed = f"an environment with {LIBRARY}: pip install 'taichi-nmm[repertoire]'"
        raise InputError(LIBRARY, "missing", allowed) from None


def read_repertoire(table: Table, families: tuple[Family, ...]) -> Repertoire | None:
    """The table [repertoire] of a store, or None where there is none. Reads every key.

    Args:
        table: the store's top table.
        families: of the store.

    Raises:
        InputError: a value out of range, no family to breed for, one that there is not, or fewer
            evaluations than the candidates take.
    """
    own = table.table("repertoire")
    if not own.unread:
        return None
    first = {family.name: family for family in families if not family.after}
    names = own.texts("families") or tuple(first)
    for name in names:
        if name not in first:
            allowed = f"families that come after none: {', '.join(first) or 'there is none'}"
            raise InputError(own.path("families"), name, allowed)
    if not first:
        raise InputError("repertoire", "no family", "a store with [families.<name>] or [robust]")
    if any(f"{ORIGIN}_".startswith(f"{family.name}_") for family in families):
        raise InputError("families", ORIGIN, "another name; it is a column of this store")
    repertoire = Repertoire(
        evaluations=own.integer("evaluations", 100_000, 1, LARGEST_NUMBER),
        candidates=own.integer("candidates", 2000, 1, LARGEST_NUMBER),
        seed=own.integer("seed", 0),
        settings=own.integer("settings", SETTINGS, 1, LARGEST_SETTING_COUNT),
        families=tuple(first[name] for name in sorted(names)),
    )
    own.done()
    _check_evaluations(repertoire)
    return repertoire


def _check_evaluations(repertoire: Repertoire) -> None:
    """Refuse a search that would have to keep more than half of what it tries."""
    families = len(repertoire.families)
    if repertoire.candidates < families:
        allowed = f"at least {families}, one a family"
        raise InputError("repertoire.candidates", repertoire.candidates, allowed)
    generations = max(families, -(-2 * repertoire.candidates // GENERATION))
    least = (STARTS * families + generations * GENERATION) * repertoire.settings
    if repertoire.evaluations < least:
        allowed = f"at least {least} for {repertoire.candidates} candidates"
        raise InputError("repertoire.evaluations", repertoire.evaluations, allowed)
