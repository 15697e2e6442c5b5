"""The search of a repertoire: for each family, generation after generation, on any executor.

The families' searches know nothing of each other, so one goes on while another waits.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from storage.evolution import Evolution
from storage.families import Family
from storage.gait_measures import measures, objective
from storage.generation_files import Generation, GenerationFiles
from storage.pool import Pool
from storage.repertoire import Repertoire
from storage.scoring import walk_family
from storage.specification import Specification
from taichi_nmm.parameters import lower_bounds, upper_bounds


@dataclass(frozen=True, eq=False)
class Start:
    """Where the search for a family begins, and how long it is.

    Attributes:
        points: of the grid, [n, 16 + k]: the first generation.
        generations: after that one.
    """

    points: NDArray[np.float64]
    generations: int


Walked = Callable[[int, bool], None]
"""Called with the walks of a generation, and whether this run did them or an earlier one."""


@dataclass(frozen=True, eq=False)
class Unit:
    """Some points of a generation, to be walked: a unit of work.

    Attributes:
        specification: of the store.
        family: the settings to walk them on.
        part: which of the generation's units it is.
        points: [n, 16 + k].
    """

    specification: Specification
    family: Family
    part: int
    points: NDArray[np.float64]


def try_points(unit: Unit) -> Generation:
    """The points with what came of them."""
    rows = walk_family(unit.specification, unit.family, unit.points, lambda part: None)
    return Generation(unit.points, objective(rows, unit.family.horizon_s), measures(rows))


def search(
    specification: Specification,
    repertoire: Repertoire,
    starts: dict[str, Start],
    files: GenerationFiles,
    pool: Pool,
    walked: Walked,
) -> dict[str, list[Generation]]:
    """All generations of all families, those of earlier runs included.

    Args:
        specification: of the store, as units are to be run.
        repertoire: what to search for.
        starts: of each family.
        files: where generations are kept.
        pool: what walks them.
        walked: called for every generation.
    """
    parts = -(-pool.slots // len(repertoire.trials))
    lines = {
        family.name: Line(
            specification,
            family,
            repertoire.stream(family.name),
            starts[family.name],
            files,
            walked,
        )
        for family in repertoire.trials
    }
    units: deque[Unit] = deque()
    for line in lines.values():
        units.extend(line.next_units(parts))
    for unit, tried in pool.results(try_points, units):
        line = lines[unit.family.name]
        if line.take(unit.part, tried):
            units.extend(line.next_units(parts))
    return {name: line.generations for name, line in lines.items()}


@dataclass(eq=False)
class Line:
    """The search for one family, as far as it has come.

    Attributes:
        specification: of the store, as units are to be run.
        family: settings of the search's own.
        seed: of its evolution.
        start: where it begins.
        files: where generations are kept.
        walked: called for every generation.
        generations: that are done.
    """

    specification: Specification
    family: Family
    seed: np.random.SeedSequence
    start: Start
    files: GenerationFiles
    walked: Walked
    generations: list[Generation] = field(default_factory=list)

    def __post_init__(self) -> None:
        parameters = self.specification.parameters
        self._low, self._high = lower_bounds(parameters), upper_bounds(parameters)
        self._evolution = Evolution(len(parameters), self.seed)
        self._done: dict[int, Generation] = {}
        self._parts = 0

    def next_units(self, parts: int) -> list[Unit]:
        """What has to be walked next, in so many units; nothing when the search is over.

        Generations that are kept in files are taken from there.
        """
        while len(self.generations) <= self.start.generations:
            points = self._asked()
            kept = self.files.read(self.family.name, len(self.generations), points)
            if kept is None:
                stretches = np.array_split(points, parts)
                self._done, self._parts = {}, len(stretches)
                return [
                    Unit(self.specification, self.family, part, stretch)
                    for part, stretch in enumerate(stretches)
                ]
            self._tell(kept, now=False)
        return []

    def take(self, part: int, tried: Generation) -> bool:
        """What came of a unit; whether it was the generation's last one, which is then kept."""
        self._done[part] = tried
        if len(self._done) < self._parts:
            return False
        whole = joined([self._done[part] for part in range(self._parts)])
        self.files.write(self.family.name, len(self.generations), whole)
        self._tell(whole, now=True)
        return True

    def _asked(self) -> NDArray[np.float64]:
        if not self.generations:
            return self.start.points
        points: NDArray[np.float64] = self._low + self._evolution.ask() * (self._high - self._low)
        return points

    def _tell(self, tried: Generation, now: bool) -> None:
        unit = (tried.points - self._low) / (self._high - self._low)
        tell = self._evolution.tell if self.generations else self._evolution.begin
        tell(unit, tried.objective, tried.measures)
        self.generations.append(tried)
        self.walked(len(tried.points) * self.family.settings, now)


def joined(stretches: list[Generation]) -> Generation:
    """One generation of several."""
    return Generation(
        np.concatenate([stretch.points for stretch in stretches]),
        np.concatenate([stretch.objective for stretch in stretches]),
        np.concatenate([stretch.measures for stretch in stretches]),
    )
